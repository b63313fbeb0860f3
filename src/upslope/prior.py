"""A prior: the meta-learned network together with what it was trained on; saved as one safetensors file."""

import json
import math
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from upslope.errors import UpslopeError
from upslope.networks import ACTIVATIONS, Activation, DuelingQ
from upslope.tasks.family import AbstractFamily
from upslope.types import Observation, Scalar

FORMAT = "upslope-prior"
FORMAT_VERSION = 1


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
    activation: Activation
    seed: int
    settings: dict[str, Any] = field(default_factory=dict)
    version: str = ""


@dataclass(frozen=True)
class Prior:
    """θ and its provenance. Call it on an observation for Φ(s) = V_θ(s)."""

    network: DuelingQ
    trained_on: TrainedOn

    @property
    def gamma(self) -> float:
        """γ that the potential was learned with, and that shaping by it needs."""
        return self.trained_on.gamma

    def __call__(self, obs: Observation) -> Scalar:
        """Φ(s) = V_θ(s) of one observation."""
        return self.network.value(jnp.asarray(obs))

    def values(self, obs: Float[Array, "n *obs"]) -> Float[Array, "n"]:
        """Φ of a batch of observations."""
        return jax.vmap(self.network.value)(jnp.asarray(obs))

    def check(self, family: AbstractFamily, *, acting: bool = False) -> None:
        """Whether the prior belongs to a family's tasks.

        Args:
            family: where it is to be used.
            acting: the A head is to be used too, so that the actions must be the same.

        Raises:
            UpslopeError: another family, γ, observation shape, or (if acting) other actions.
        """
        trained = self.trained_on
        pairs = [
            ("the family", trained.family, family.name),
            ("gamma", trained.gamma, family.gamma),
            ("the observation shape", trained.observation_shape, family.observation_shape),
        ]
        if acting:
            pairs.append(("the number of actions", trained.actions, 0 if family.continuous else family.actions))
        for what, ours, theirs in pairs:
            if ours != theirs:
                raise UpslopeError(
                    f"The prior does not fit the tasks: {what} is {ours} in the prior and {theirs} in the tasks. "
                    "Use a prior that was trained on these tasks, or make the tasks with the prior's settings."
                )

    def save(self, path: str | Path) -> None:
        """Writes one safetensors file: the parameters, and `TrainedOn` as its JSON header.

        Raises:
            UpslopeError: the file exists already or can't be written.
        """
        path = Path(path)
        if path.exists():
            raise UpslopeError(f"{path} exists already, and nothing is overwritten: give another file name.")
        header = {
            "format": FORMAT,
            "format_version": str(FORMAT_VERSION),
            "trained_on": json.dumps(asdict(self.trained_on)),
        }
        tensors = {name: np.asarray(leaf) for name, leaf in _named_leaves(self.network)}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            save_file(tensors, path, metadata=header)
        except OSError as error:
            raise UpslopeError(f"{path} can't be written ({error}): give another file name.") from error

    @classmethod
    def load(cls, path: str | Path) -> "Prior":
        """Reads what `save` wrote, bit for bit.

        Raises:
            UpslopeError: a missing, damaged, foreign or newer file, or one with non-finite parameters.
        """
        path = Path(path)
        if not path.is_file():
            raise UpslopeError(f"There is no prior at {path}: give the file that `upslope meta-train` wrote.")
        try:
            with safe_open(path, framework="numpy") as file:
                trained_on = _read_header(path, file.metadata() or {})
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no mapping)
        except (SafetensorError, OSError) as error:
            raise UpslopeError(f"{path} is damaged or no safetensors file ({error}): make the prior again.") from error
        return cls(_fill(path, trained_on, tensors), trained_on)


def trained_on(family: AbstractFamily, network: DuelingQ, seed: int, settings: dict[str, Any]) -> TrainedOn:
    """The provenance of a prior meta-trained on a family."""
    return TrainedOn(
        family=family.name,
        gamma=family.gamma,
        observation_shape=family.observation_shape,
        observation_scale=family.observation_scale,
        actions=family.actions,
        hidden=network.torso.hidden,
        activation=network.torso.activation,
        seed=seed,
        settings=settings,
        version=version("upslope"),
    )


def _read_header(path: Path, metadata: dict[str, str]) -> TrainedOn:
    if metadata.get("format") != FORMAT:
        raise UpslopeError(f"{path} is a safetensors file, but no upslope prior: give one that `Prior.save` wrote.")
    if metadata.get("format_version") != str(FORMAT_VERSION):
        raise UpslopeError(
            f"{path} has format {metadata.get('format_version')}, but this upslope reads format {FORMAT_VERSION}: "
            "install the version of upslope that wrote it."
        )
    try:
        entries = json.loads(metadata["trained_on"])
        for name in ("observation_shape", "observation_scale", "hidden"):
            entries[name] = tuple(entries[name])
        trained_on = TrainedOn(**entries)
        _check_header(trained_on)
        return trained_on
    except (KeyError, TypeError, ValueError) as error:
        raise UpslopeError(f"{path} has a damaged header ({error}): make the prior again.") from error


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


def _fill(path: Path, trained_on: TrainedOn, tensors: dict[str, np.ndarray]) -> DuelingQ:
    """A network of the header's sizes with the file's parameters."""
    skeleton = eqx.filter_eval_shape(
        DuelingQ,
        jax.random.key(0),
        trained_on.observation_shape,
        trained_on.actions,
        trained_on.hidden,
        trained_on.observation_scale,
        trained_on.activation,
    )
    names = [name for name, _ in _named_leaves(skeleton)]
    if sorted(names) != sorted(tensors):
        raise UpslopeError(f"{path} holds other tensors than its header announces: make the prior again.")
    leaves = []
    for name, shape in _named_leaves(skeleton):
        tensor = tensors[name]
        if tensor.shape != shape.shape or tensor.dtype != shape.dtype:
            raise UpslopeError(
                f"{path}: {name} is {tensor.dtype}{list(tensor.shape)}, but the header announces "
                f"{shape.dtype}{list(shape.shape)}: make the prior again."
            )
        if not np.isfinite(tensor).all():
            raise UpslopeError(f"{path}: {name} holds numbers that are not finite: make the prior again.")
        leaves.append(jnp.asarray(tensor))
    return jax.tree.unflatten(jax.tree.structure(skeleton), leaves)


def _named_leaves(network: Any) -> list[tuple[str, Any]]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(network)
    return [(jax.tree_util.keystr(path, simple=True, separator="."), leaf) for path, leaf in leaves]
