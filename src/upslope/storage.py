"""Named arrays and a header in one safetensors file: written whole or not at all, every byte checked when read.

Nothing here can run code from a file: headers are JSON, arrays are plain numbers, and names are never paths.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from upslope.errors import DamagedFileError, NotSavedError

#: Longest header that is read. Ours are a few kilobytes; JSON takes up to forty times its length in memory.
LONGEST_HEADER = 2**20

_BLOCK = 2**20


class Stored(NamedTuple):
    """The content of a file.

    Attributes:
        header: what `write` was given.
        arrays: by name.
        checksums: SHA-256 of each array's bytes, in hexadecimal.
    """

    header: dict[str, Any]
    arrays: dict[str, np.ndarray]
    checksums: dict[str, str]


def milestone(name: str) -> None:
    """A named point inside a save. Does nothing; tests interrupt saves here."""


def write(path: Path, kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Writes a file atomically: readers see the old file or the new one, whatever happens in between.

    Args:
        path: of the file; an older one is replaced.
        kind: of the file, for example ``upslope-prior``.
        version: of the kind's format.
        header: any JSON value.
        arrays: numbers and Booleans of any shape, by name.

    Raises:
        NotSavedError: the disk is full, or the folder is gone or read-only. An older file is intact.
    """
    arrays = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    metadata = {
        "format": kind,
        "format_version": str(version),
        "header": json.dumps(header, sort_keys=True),
        "checksums": json.dumps({name: _checksum(array) for name, array in arrays.items()}, sort_keys=True),
    }
    metadata["digest"] = _digest(metadata)
    write_atomically(path, save(dict(arrays), metadata))


def write_atomically(path: Path, data: bytes) -> None:
    """Temporary file, fsync, rename, fsync of the folder.

    Raises:
        NotSavedError: as for `write`.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        milestone("before the temporary file")
        with temporary.open("wb") as file:
            for begin in range(0, len(data), _BLOCK):
                file.write(data[begin : begin + _BLOCK])
                milestone("inside the temporary file")
            file.flush()
            milestone("before the file's fsync")
            os.fsync(file.fileno())
        milestone("before the rename")
        temporary.replace(path)
        milestone("before the folder's fsync")
        _sync_folder(path.parent)
        milestone("after the folder's fsync")
    except OSError as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise NotSavedError(
            f"{path} can't be written ({error.strerror or error}): free some space, or give a folder that can be "
            "written to. Earlier saves are intact."
        ) from error


def read(path: Path, kind: str, *versions: int) -> Stored:
    """Reads what `write` wrote, and checks every byte of it.

    Raises:
        DamagedFileError: a file that is missing, damaged, truncated, of another kind or of another format.
    """
    try:
        metadata = _metadata(path)
        _check_kind(path, metadata, kind, versions)
        if metadata.get("digest") != _digest(metadata):
            raise DamagedFileError(f"{path} is damaged: its header does not match the header's own checksum.")
        checksums = json.loads(metadata["checksums"])
        with safe_open(path, framework="numpy") as file:
            names = list(file.keys())
            if sorted(names) != sorted(checksums):
                raise DamagedFileError(f"{path} is damaged: it holds other arrays than its header lists.")
            arrays = {name: file.get_tensor(name) for name in names}
    except FileNotFoundError as error:
        raise DamagedFileError(f"There is no file {path}: give the path of a file that upslope wrote.") from error
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RecursionError, OverflowError) as error:
        if isinstance(error, DamagedFileError):
            raise
        raise DamagedFileError(f"{path} is damaged, or not a file of upslope ({_summary(error)}).") from error
    for name, array in arrays.items():
        if _checksum(array) != checksums[name]:
            raise DamagedFileError(f"{path} is damaged: {name} does not match its checksum.")
    return Stored(json.loads(metadata["header"]), arrays, checksums)


def content_digest(checksums: Mapping[str, str]) -> str:
    """One SHA-256 for all arrays, whatever their order."""
    return hashlib.sha256(json.dumps(dict(checksums), sort_keys=True).encode()).hexdigest()


def _metadata(path: Path) -> dict[str, str]:
    """The safetensors header's ``__metadata__``, its length bounded before anything is read."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        length = int.from_bytes(file.read(8), "little")
        if size < 8 or length > min(size - 8, LONGEST_HEADER):
            raise DamagedFileError(f"{path} is damaged, or not a file of upslope (its header can't be that long).")
        text = file.read(length).decode("utf-8")
    header = json.loads(text, object_pairs_hook=_without_duplicates)
    metadata = header["__metadata__"] if isinstance(header, dict) else None
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise ValueError("it has another header")
    return metadata


def _check_kind(path: Path, metadata: dict[str, str], kind: str, versions: tuple[int, ...]) -> None:
    if metadata.get("format") != kind:
        found = metadata.get("format", "unknown")
        raise DamagedFileError(f"{path} is not an {kind} file: its format is {found!r:.60}.")
    if metadata.get("format_version") not in [str(version) for version in versions]:
        raise DamagedFileError(
            f"{path} has format {metadata.get('format_version')!r:.20}, but this upslope reads format {versions[-1]}: "
            "install the version of upslope that wrote it."
        )


def _digest(metadata: Mapping[str, str]) -> str:
    """The digest of all other metadata. The arrays are covered by their checksums."""
    covered = sorted((name, text) for name, text in metadata.items() if name != "digest")
    return hashlib.sha256(json.dumps(covered).encode()).hexdigest()


def _checksum(array: np.ndarray) -> str:
    """The checksum of an array's type, shape and bytes."""
    digest = hashlib.sha256(f"{array.dtype.str}{list(array.shape)}".encode())
    digest.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return digest.hexdigest()


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) != len(pairs):
        raise ValueError("its header lists a name twice")
    return entries


def _summary(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error)[:100]}"


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
