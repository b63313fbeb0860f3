"""Damaged and forged files: one typed error each, in no time, and never a silent load."""

import hashlib
import json
import random
import resource
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from reliability.processes import require
from upslope import storage
from upslope.errors import UpslopeError
from upslope.learners.learner import AbstractLearner
from upslope.networks.dueling import DuelingQ
from upslope.priors.prior import Prior, trained_on
from upslope.run.checkpoints import Checkpoints
from upslope.run.loop import broadcast, run
from upslope.run.session import Session
from upslope.tasks import cartpoles

Load = Callable[[Path], object]


class Counting(AbstractLearner):
    """A learner that compiles in no time."""

    @property
    def engine(self) -> str:
        return "compiled"

    @property
    def takes_turns(self) -> bool:
        return False

    def init(self, key: jax.Array) -> Any:
        return {"key": key, "place": jax.random.normal(key, (40,))}

    def step(self, state: Any) -> tuple[Any, dict[str, jax.Array]]:
        return {**state, "place": state["place"] + 1}, {"step": state["place"][0]}

    def report(self, state: Any) -> dict[str, Any]:
        return {"return": state["place"][0]}


def originals(folder: Path) -> dict[str, tuple[bytes, Load]]:
    """A good prior and a good checkpoint, and how each is loaded."""
    family = cartpoles()
    network = DuelingQ(jax.random.key(0), 4, 2)
    prior = folder / "prior.safetensors"
    Prior(network, trained_on(family, network, 0, {})).save(prior)
    keys = jax.random.split(jax.random.key(0), 2)

    def go(resume: bool | Path = False) -> object:
        session = Session((), Checkpoints(folder / "run", resume=resume))
        return run(broadcast(Counting(), (2,)), keys, updates=4, every=2, session=session)

    go()
    (checkpoint,) = (folder / "run").rglob("*.safetensors")
    return {"prior": (prior.read_bytes(), Prior.load), "checkpoint": (checkpoint.read_bytes(), go)}


def mutants(data: bytes, count: int, generator: random.Random) -> Iterator[tuple[str, bytes]]:
    """Every way of forging a header, cuts at every byte of it, and random damage to make up the count."""
    length = int.from_bytes(data[:8], "little")
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
    made = 0
    for name, forged in _forgeries(header, body, generator):
        made += 1
        yield name, forged
    for end in range(0, 8 + length, max(1, (8 + length) // max(count // 4, 1))):
        made += 1
        yield "cut in the header", data[:end]
    while made < count:
        made += 1
        place, kind = generator.randrange(len(data)), generator.randrange(4)
        changed = bytearray(data)
        if kind == 0:
            changed[place] ^= 1 << generator.randrange(8)
            yield "one bit", bytes(changed)
        elif kind == 1:
            width = generator.randrange(1, 64)
            replaced = generator.randbytes(width)
            if replaced != data[place : place + width]:
                yield "some bytes", data[:place] + replaced + data[place + width :]
        elif kind == 2:
            yield "cut", data[:place]
        else:
            yield "more bytes", data + generator.randbytes(generator.randrange(1, 64))


def _forgeries(header: dict[str, Any], body: bytes, generator: random.Random) -> Iterator[tuple[str, bytes]]:
    def packed(header: object, body: bytes = body) -> bytes:
        text = json.dumps(header).encode()
        return len(text).to_bytes(8, "little") + text + body

    names = [name for name in header if name != "__metadata__"]
    sizes = [0, 1, 7, 2**20 + 1, 2**31, 2**32, 2**48, 2**63, 2**64 - 1]
    for size in sizes + [generator.getrandbits(64) for _ in range(20)]:
        yield "length of the header", size.to_bytes(8, "little") + packed(header)[8:]
    wrong = {
        "data_offsets": ([0, 2**62], [2**62, 0], [-1, 4], [0, 0], ["0", "4"], [0], None),
        "shape": ([2**40, 2**40], [2**63], [-1], [0], [1.5], "3", [1] * 100_000),
        "dtype": ("F64", "I8", "BF16", "F8_E4M3", "object", "", 4),
    }
    for name in names:
        entry = header[name]
        for what, values in wrong.items():
            for value in values:
                if value != entry[what]:
                    yield what, packed({**header, name: {**entry, what: value}})
        yield "missing array", packed({key: value for key, value in header.items() if key != name})
        yield "another name", packed({(key if key != name else "../" + name): value for key, value in header.items()})
        text = json.dumps(header)[:-1] + f", {json.dumps(name)}: {json.dumps(entry)}}}"
        yield "an array twice", len(text).to_bytes(8, "little") + text.encode() + body
    metadata = header["__metadata__"]
    for name in metadata:
        for value in ("", "0", "1", "2", "[" * 50_000, "NaN", "{}", "\x00", None, 3, []):
            if value != metadata[name]:
                yield "metadata", packed({**header, "__metadata__": {**metadata, name: value}})
        yield (
            "metadata missing",
            packed({**header, "__metadata__": {key: value for key, value in metadata.items() if key != name}}),
        )
    for foreign in ({}, [], 3, None, "x", {"__metadata__": []}, {"__metadata__": {}}):
        yield "a foreign header", packed(foreign)


def with_honest_checksums(data: bytes, folder: Path) -> Iterator[tuple[str, bytes]]:
    """Files whose checksums are right, and whose contents are not: numbers that are not finite."""
    path = folder / "forged.safetensors"
    path.write_bytes(data)
    length = int.from_bytes(data[:8], "little")
    metadata = json.loads(data[8 : 8 + length])["__metadata__"]
    header, arrays, _ = storage.read(path, metadata["format"], int(metadata["format_version"]))
    for name, array in arrays.items():
        if np.issubdtype(array.dtype, np.floating) and array.size and not name.startswith("times"):
            for value in (np.nan, np.inf, -np.inf):
                forged = array.copy()
                forged.reshape(-1)[0] = value
                changed = {**arrays, name: forged}
                storage.write(path, metadata["format"], int(metadata["format_version"]), header, changed)
                yield "not finite", path.read_bytes()


def mutated(folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Loads ``count`` mutants, half of them priors, half checkpoints."""
    generator = random.Random(seed)
    kinds: dict[str, int] = {}
    slowest, total = 0.0, 0
    for name, (data, load) in originals(folder).items():
        path = folder / f"mutant-{name}.safetensors"
        path.write_bytes(data)
        load(path)  # the good one loads, and what is imported on the way is
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        seen = {hashlib.sha256(data).digest()}
        forged = list(with_honest_checksums(data, folder))
        # A few of them come out alike, and count once.
        for kind, mutant in [*forged, *mutants(data, count // 2 + count // 100, generator)]:
            digest = hashlib.sha256(mutant).digest()
            if digest in seen and kind not in ("cut", "cut in the header"):
                continue
            seen.add(digest)
            path.write_bytes(mutant)
            began = time.perf_counter()
            try:
                load(path)
            except UpslopeError:
                pass
            else:
                require(False, f"a {name} with {kind} was loaded in silence")
            slowest = max(slowest, time.perf_counter() - began)
            kinds[kind] = kinds.get(kind, 0) + 1
            total += 1
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
        require(grown < 2 * len(data) + 64 * 2**20, f"loading {name}s took {grown / 2**20:.0f} MiB")
    require(slowest < 1, f"a load took {slowest:.2f} seconds")
    return {"files": total, "typed_errors": total, "slowest_in_seconds": round(slowest, 3), "by_kind": kinds}
