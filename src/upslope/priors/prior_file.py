"""The file of a prior: one safetensors file, its JSON header, and what is checked when it is read. Needs no JAX."""

import math
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from upslope import storage
from upslope.errors import DamagedFileError, NotSavedError, UpslopeError
from upslope.networks.numpy_convolution import CHANNELS

FORMAT = "upslope-prior"
FORMAT_VERSION = 1
ACTIVATIONS = ("relu", "tanh")


@dataclass(frozen=True)
class TrainedOn:
    """What a prior was trained on; the JSON header of its file.

    Attributes:
        family: name of the state space.
        gamma: γ of the tasks, and so of the potential.
        observation_shape: of one observation.
        observation_scale: what the network multiplies observations with.
        actions: of the A head.
        hidden: widths of the hidden layers.
        activation: of the hidden layers.
        seed: of the meta-training.
        settings: of the meta-training, and what was measured at its end.
        version: of upslope.
    """

    family: str
    gamma: float
    observation_shape: tuple[int, ...]
    observation_scale: tuple[float, ...]
    actions: int
    hidden: tuple[int, ...]
    activation: Literal["relu", "tanh"]
    seed: int
    settings: dict[str, Any] = field(default_factory=dict)
    version: str = ""


def write_prior_file(
    path: Path, trained_on: TrainedOn, tensors: dict[str, np.ndarray], *, overwrite: bool = False
) -> None:
    """Writes one safetensors file: the parameters, and the provenance as its JSON header.

    Raises:
        UpslopeError: the file exists already.
        NotSavedError: it can't be written.
    """
    if path.exists() and not overwrite:
        raise UpslopeError(f"{path} exists already, and nothing is overwritten: give another file name.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NotSavedError(f"{path} can't be written ({error.strerror}): give another file name.") from error
    storage.write(path, FORMAT, FORMAT_VERSION, {"trained_on": asdict(trained_on)}, tensors)


def read_prior_file(path: Path) -> tuple[TrainedOn, dict[str, np.ndarray]]:
    """Reads what `write_prior_file` wrote, bit for bit.

    Raises:
        DamagedFileError: a missing, damaged, foreign or newer file, or one with non-finite parameters.
    """
    if not path.is_file():
        raise DamagedFileError(f"There is no prior at {path}: give the file that `upslope meta-train` wrote.")
    header, tensors, _ = storage.read(path, FORMAT, FORMAT_VERSION)
    try:
        entries = header["trained_on"]
        for name in ("observation_shape", "observation_scale", "hidden"):
            entries[name] = tuple(entries[name])
        trained_on = TrainedOn(**entries)
        _check_header(trained_on)
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(f"{path} has a damaged header ({error}): make the prior again.") from error
    _check_tensors(path, trained_on, tensors)
    return trained_on, tensors


def _check_header(trained_on: TrainedOn) -> None:
    """Raises ValueError where the header's entries make no network or no discount."""
    shape, scale, gamma = trained_on.observation_shape, trained_on.observation_scale, trained_on.gamma
    sizes = (*shape, *trained_on.hidden, trained_on.actions)
    if not (len(shape) in (1, 3) and trained_on.hidden and all(isinstance(size, int) and size > 0 for size in sizes)):
        raise ValueError("its sizes make no network")
    if len(scale) != shape[-1] or not all(
        isinstance(factor, int | float) and math.isfinite(factor) for factor in scale
    ):
        raise ValueError("its scales do not fit the observations")
    if trained_on.activation not in ACTIVATIONS:
        raise ValueError(f"activation {trained_on.activation!r} is unknown")
    if not (isinstance(gamma, int | float) and 0 < gamma <= 1):
        raise ValueError(f"gamma {gamma!r} is no discount")


def _check_tensors(path: Path, trained_on: TrainedOn, tensors: dict[str, np.ndarray]) -> None:
    """Whether the file holds exactly the tensors that its header announces, all of finite numbers."""
    announced = tensor_shapes(trained_on)
    if sorted(announced) != sorted(tensors):
        raise DamagedFileError(f"{path} holds other tensors than its header announces: make the prior again.")
    for name, shape in announced.items():
        tensor = tensors[name]
        if tensor.shape != shape or tensor.dtype != np.float32:
            raise DamagedFileError(
                f"{path}: {name} is {tensor.dtype}{list(tensor.shape)}, but the header announces "
                f"float32{list(shape)}: make the prior again."
            )
        if not np.isfinite(tensor).all():
            raise DamagedFileError(f"{path}: {name} holds numbers that are not finite: make the prior again.")


def tensor_shapes(trained_on: TrainedOn) -> dict[str, tuple[int, ...]]:
    """The names and shapes of the tensors of a dueling network: on vectors, or on maps with the paper's kernels."""
    shape = trained_on.observation_shape
    shapes: dict[str, tuple[int, ...]] = {}
    prefix, inputs = "torso.layers", shape[0]
    if len(shape) == 3:
        pairs = enumerate(pairwise((shape[-1], *CHANNELS)))
        shapes = {f"torso.kernels.{i}": (3, 3, n, m) for i, (n, m) in pairs}
        shapes |= {f"torso.biases.{i}": (m,) for i, m in enumerate(CHANNELS)}
        prefix, inputs = "torso.dense.layers", shape[0] * shape[1] * CHANNELS[-1]
    widths = (inputs, *trained_on.hidden)
    layers = {f"{prefix}.{i}": (m, n) for i, (n, m) in enumerate(pairwise(widths))}
    layers |= {"value_head": (1, widths[-1]), "advantage_head": (trained_on.actions, widths[-1])}
    return shapes | {
        f"{name}.{part}": size
        for name, size_of in layers.items()
        for part, size in (("weight", size_of), ("bias", size_of[:1]))
    }
