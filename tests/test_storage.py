"""Files of arrays: written whole or not at all, every byte checked when read."""

import errno
import json
import os
import resource
import signal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from safetensors.numpy import save_file

from upslope import storage
from upslope.errors import DamagedFileError, NotSavedError

ARRAYS = {
    "floats": np.linspace(0, 1, 7, dtype=np.float32).reshape(7, 1),
    "scalar": np.float64(0.25),
    "words": np.array([1, 2**32 - 1], np.uint32),
    "flags": np.array([True, False]),
    "nothing": np.zeros((0, 3), np.int32),
}
HEADER = {"title": "a run, with ünïcode", "update": 3}


def write(path, arrays=None, header=None):
    storage.write(path, "test", 1, HEADER if header is None else header, ARRAYS if arrays is None else arrays)
    return path


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


class TestRoundTrip:
    def test_arrays_and_header_come_back(self, tmp_path):
        header, arrays, checksums = storage.read(write(tmp_path / "file"), "test", 1)
        assert header == HEADER
        assert arrays.keys() == checksums.keys() == ARRAYS.keys()
        for name, array in ARRAYS.items():
            np.testing.assert_array_equal(arrays[name], array)
            assert arrays[name].dtype == array.dtype
            assert arrays[name].shape == array.shape
        assert names_in(tmp_path) == ["file"]

    @given(
        hnp.arrays(
            st.sampled_from([np.float32, np.float64, np.int32, np.int64, np.uint8, np.uint32, np.bool_]),
            hnp.array_shapes(min_dims=0, min_side=0),
        )
    )
    def test_any_array(self, tmp_path_factory, array):
        path = write(tmp_path_factory.mktemp("any") / "file", {"a": array})
        back = storage.read(path, "test", 1).arrays["a"]
        assert back.tobytes() == array.tobytes()
        assert (back.dtype, back.shape) == (array.dtype, array.shape)

    def test_checksums_tell_values_types_and_shapes_apart(self, tmp_path):
        def digest(array):
            return storage.content_digest(storage.read(write(tmp_path / "file", {"a": array}), "test", 1).checksums)

        zeros = np.zeros(4, np.float32)
        others = [zeros.reshape(2, 2), zeros.astype(np.int32), zeros + 1, -zeros]
        assert digest(zeros) == digest(zeros.copy())
        assert len({digest(array) for array in [zeros, *others]}) == 5

    def test_an_older_file_is_replaced(self, tmp_path):
        write(tmp_path / "file", {"a": np.zeros(2)})
        write(tmp_path / "file", {"a": np.ones(2)})
        np.testing.assert_array_equal(storage.read(tmp_path / "file", "test", 1).arrays["a"], np.ones(2))


class TestWhatIsNotOurs:
    def refuses(self, path, words, kind="test", version=1):
        with pytest.raises(DamagedFileError, match=words) as caught:
            storage.read(path, kind, version)
        assert str(path) in str(caught.value)

    def test_missing(self, tmp_path):
        self.refuses(tmp_path / "nowhere", "There is no file")

    def test_a_folder(self, tmp_path):
        self.refuses(tmp_path, "not a file of upslope")

    def test_empty(self, tmp_path):
        (tmp_path / "file").touch()
        self.refuses(tmp_path / "file", "can't be that long")

    def test_another_kind(self, tmp_path):
        self.refuses(
            write(tmp_path / "file"), "is not an upslope-prior file: its format is 'test'", kind="upslope-prior"
        )

    def test_a_newer_format(self, tmp_path):
        path = tmp_path / "file"
        storage.write(path, "test", 2, {}, ARRAYS)
        self.refuses(path, "has format '2', but this upslope reads format 1: install the version")

    def test_a_foreign_safetensors_file(self, tmp_path):
        save_file({"a": np.zeros(3)}, tmp_path / "file", metadata={"by": "others"})
        self.refuses(tmp_path / "file", "its format is 'unknown'")

    def test_a_foreign_safetensors_file_without_metadata(self, tmp_path):
        save_file({"a": np.zeros(3)}, tmp_path / "file")
        self.refuses(tmp_path / "file", "not a file of upslope")

    def test_a_pickle(self, tmp_path):
        (tmp_path / "file").write_bytes(b"\x80\x04\x95\x0b\x00\x00\x00\x00\x00\x00\x00\x8c\x07os.exit\x94.")
        self.refuses(tmp_path / "file", "can't be that long")

    def test_a_header_that_claims_more_than_there_is(self, tmp_path):
        data = bytearray(write(tmp_path / "file").read_bytes())
        data[:8] = (2**62).to_bytes(8, "little")
        (tmp_path / "file").write_bytes(data)
        self.refuses(tmp_path / "file", "can't be that long")

    def test_a_header_nested_without_end(self, tmp_path):
        text = b"[" * 500_000
        (tmp_path / "file").write_bytes(len(text).to_bytes(8, "little") + text)
        self.refuses(tmp_path / "file", "RecursionError")

    def test_one_changed_number(self, tmp_path):
        path = write(tmp_path / "file")
        data = bytearray(path.read_bytes())
        data[-1] ^= 1
        path.write_bytes(data)
        self.refuses(path, "does not match its checksum")

    def test_a_changed_header(self, tmp_path):
        path = write(tmp_path / "file")
        path.write_bytes(path.read_bytes().replace(b'update\\": 3', b'update\\": 4'))
        self.refuses(path, "header's own checksum")

    def test_a_name_listed_twice(self, tmp_path):
        text = json.dumps({"__metadata__": {}})[:-1] + ', "a": 1, "a": 2}'
        (tmp_path / "file").write_bytes(len(text).to_bytes(8, "little") + text.encode())
        self.refuses(tmp_path / "file", "lists a name twice")


class Plug:
    """Pulls the plug at a milestone: raises, as a full disk or a kill would stop the save there."""

    def __init__(self, name):
        self.name = name

    def __call__(self, name):
        if name == self.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class TestTrouble:
    MILESTONES = (
        "before the temporary file",
        "inside the temporary file",
        "before the file's fsync",
        "before the rename",
    )

    @pytest.mark.parametrize("name", MILESTONES)
    def test_a_full_disk_leaves_the_old_file_and_no_litter(self, tmp_path, monkeypatch, name):
        before = write(tmp_path / "file").read_bytes()
        monkeypatch.setattr(storage, "milestone", Plug(name))
        with pytest.raises(NotSavedError, match="No space left"):
            write(tmp_path / "file", {"a": np.ones(3)})
        assert (tmp_path / "file").read_bytes() == before
        assert names_in(tmp_path) == ["file"]

    @pytest.mark.parametrize("name", [*MILESTONES, "before the folder's fsync", "after the folder's fsync"])
    def test_every_milestone_is_passed(self, tmp_path, monkeypatch, name):
        passed = []
        monkeypatch.setattr(storage, "milestone", passed.append)
        write(tmp_path / "file")
        assert name in passed

    def test_the_kernels_own_limit(self, tmp_path):
        before = write(tmp_path / "file").read_bytes()
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        previous = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2**16, hard))
        try:
            with pytest.raises(NotSavedError, match="File too large"):
                write(tmp_path / "file", {"a": np.zeros(2**17)})
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            signal.signal(signal.SIGXFSZ, previous)
        assert (tmp_path / "file").read_bytes() == before
        assert names_in(tmp_path) == ["file"]

    def test_a_vanished_folder(self, tmp_path):
        with pytest.raises(NotSavedError, match="can't be written"):
            write(tmp_path / "gone" / "file")
