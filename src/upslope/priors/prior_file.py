"""The file of a prior: one safetensors file, its JSON header, and the checks when it is read. Needs no JAX."""

import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from upslope import storage
from upslope.errors import DamagedFileError, NotSavedError, UpslopeError
from upslope.networks.numpy_torsos import NUMPY_TORSOS, numpy_torso_for

FORMAT = "upslope-prior"
#: Format 2 names the advantage head and can hold a scaling; files of format 1 have the discrete head and no scaling.
FORMAT_VERSION = 2
READABLE_VERSIONS = (1, 2)
ACTIVATIONS = ("relu", "tanh")


@dataclass(frozen=True)
class TrainedOn:
    """What a prior was trained on; the JSON header of its file.

    Attributes:
        family: the name of the state space.
        gamma: γ of the tasks, and so of the potential.
        observation_shape: the shape of one observation.
        observation_scale: factors by which the network multiplies observations.
        actions: the number of discrete actions, or of components of a continuous action.
        hidden: widths of the hidden layers.
        activation: the activation of the hidden layers.
        seed: the seed of the meta-training.
        settings: the settings of the meta-training, and the measurements at its end.
        version: the version of upslope.
        head: the name of the advantage head.
        scaled: whether the file has the tensors of a `Scaling`.
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
    head: str = "discrete"
    scaled: bool = False


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
    """Reads a file that `write_prior_file` wrote, bit for bit.

    Raises:
        DamagedFileError: a missing, damaged, foreign or newer file, or one with non-finite parameters.
    """
    if not path.is_file():
        raise DamagedFileError(f"There is no prior at {path}: give the file that `upslope meta-train` wrote.")
    header, tensors, _ = storage.read(path, FORMAT, *READABLE_VERSIONS)
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
    """Raises ValueError if the header's entries do not describe a network, or γ is not a discount."""
    shape, scale, gamma = trained_on.observation_shape, trained_on.observation_scale, trained_on.gamma
    sizes = (*shape, *trained_on.hidden, trained_on.actions)
    if not (
        len(shape) in NUMPY_TORSOS and trained_on.hidden and all(isinstance(size, int) and size > 0 for size in sizes)
    ):
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
    """Checks that torso and V head match the header, that all else is the A head's, and that all numbers are finite."""
    announced = potential_shapes(trained_on)
    foreign = [name for name in tensors if name not in announced and not name.startswith("advantage_head.")]
    if foreign or not announced.keys() <= tensors.keys():
        raise DamagedFileError(f"{path} holds other tensors than its header announces: make the prior again.")
    for name, tensor in tensors.items():
        shape = announced.get(name, tensor.shape)
        if tensor.shape != shape or tensor.dtype != np.float32:
            raise DamagedFileError(
                f"{path}: {name} is {tensor.dtype}{list(tensor.shape)}, but the header announces "
                f"float32{list(shape)}: make the prior again."
            )
        if not np.isfinite(tensor).all():
            raise DamagedFileError(f"{path}: {name} holds numbers that are not finite: make the prior again.")


def potential_shapes(trained_on: TrainedOn) -> dict[str, tuple[int, ...]]:
    """The names and shapes of the tensors of Φ: those of the torso and the V head."""
    torso = numpy_torso_for(trained_on.observation_shape)
    head = {"value_head.weight": (1, trained_on.hidden[-1]), "value_head.bias": (1,)}
    shapes = torso.tensor_shapes(trained_on.observation_shape, trained_on.hidden) | head
    if not trained_on.scaled:
        return shapes
    inputs = trained_on.observation_shape[-1]
    return shapes | {"scaling.mean": (inputs,), "scaling.deviation": (inputs,), "scaling.unit": (), "scaling.level": ()}
