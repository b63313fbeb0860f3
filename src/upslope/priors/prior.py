"""A prior: the meta-learned network and a record of its training, saved as one safetensors file."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.errors import DamagedFileError, UpslopeError
from upslope.learners.agent import act, is_batch
from upslope.learners.curve import LearningCurve
from upslope.networks.dueling import DuelingQ
from upslope.networks.heads import HEADS
from upslope.networks.scaling import no_scaling
from upslope.networks.tensors import from_tensors, to_tensors
from upslope.priors.numpy_potential import NumpyPotential
from upslope.priors.prior_file import TrainedOn, read_prior_file, write_prior_file
from upslope.tasks.family import AbstractFamily


@dataclass(frozen=True, eq=False, repr=False)
class Prior:
    """θ and its provenance. Call it on observations for Φ(s) = V_θ(s). It can also act, with its A head.

    Attributes:
        network: θ.
        trained_on: what it was trained on.
        curve: the learning curve of meta-training, with returns on extra training tasks; None in a loaded prior.
    """

    network: DuelingQ
    trained_on: TrainedOn
    curve: LearningCurve | None = None

    @property
    def gamma(self) -> float:
        """The γ with which the potential was learned, and which shaping with it requires."""
        return self.trained_on.gamma

    def __call__(self, obs: Any) -> Float[Array, "*n"]:
        """Φ(s) = V_θ(s) of one observation ``[*obs]``, or of each in a batch ``[n, *obs]``. JAX can trace it.

        Raises:
            UpslopeError: the observation has another shape.
        """
        obs = jnp.asarray(obs)
        if is_batch(obs.shape, self.trained_on.observation_shape):
            return self.values(obs)
        return self.network.value(obs)

    def values(self, obs: Float[Array, "n *obs"]) -> Float[Array, "n"]:
        """Φ of a batch of observations."""
        return jax.vmap(self.network.value)(jnp.asarray(obs))

    def act(self, obs: Any) -> Any:
        """The greedy action for one observation ``[*obs]``, or the actions for a batch ``[n, *obs]``, in NumPy.

        Raises:
            UpslopeError: the observation has another shape.
        """
        return act(self._best, self.trained_on.observation_shape, obs)

    @cached_property
    def _best(self) -> Callable[[np.ndarray], np.ndarray]:
        return self.network.numpy_best()

    def __getstate__(self) -> dict[str, Any]:
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}  # a cached function can't be pickled

    def __repr__(self) -> str:
        about, settings = self.trained_on, self.trained_on.settings
        measured = ""
        if "return_on_training_tasks" in settings:
            measured = f", return {settings['return_on_training_tasks']:.4g} on extra training tasks"
        return (
            f"Prior(of {about.family!r}, observations {list(about.observation_shape)}, {about.actions} actions, "
            f"gamma={about.gamma}, seed={about.seed}{measured})"
        )

    def check(self, family: AbstractFamily, *, acting: bool = False) -> None:
        """Checks that the prior belongs to a family's tasks.

        Args:
            family: the family on which the prior will be used.
            acting: whether the A head will be used too; then the actions must be the same.

        Raises:
            UpslopeError: the family, γ, the observation shape or (if acting) the actions differ.
        """
        trained = self.trained_on
        pairs = [
            ("the family", trained.family, family.name),
            ("gamma", trained.gamma, family.gamma),
            ("the observation shape", trained.observation_shape, family.observation_shape),
        ]
        if acting:
            pairs.append(
                (
                    "the number of actions",
                    trained.actions,
                    {"discrete": family.actions.count, "continuous": 0}[family.actions.kind],
                )
            )
        for what, ours, theirs in pairs:
            if ours != theirs:
                raise UpslopeError(
                    f"The prior does not fit the tasks: {what} is {ours} in the prior and {theirs} in the tasks. "
                    "Use a prior that was trained on these tasks, or make the tasks with the prior's settings; "
                    "families of one state space share a name, which GymnasiumTasks and gymnax_tasks take as name=."
                )

    def to_numpy(self) -> NumpyPotential:
        """Φ = V_θ in NumPy, for host processes. It takes a few microseconds per call and needs no JAX."""
        return NumpyPotential(self.trained_on, to_tensors(self.network))

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Writes one safetensors file: the parameters, and `TrainedOn` as its JSON header.

        Raises:
            UpslopeError: the file exists already or can't be written.
        """
        write_prior_file(Path(path), self.trained_on, to_tensors(self.network), overwrite=overwrite)

    @classmethod
    def load(cls, path: str | Path) -> "Prior":
        """Reads a file that `save` wrote, bit for bit.

        Raises:
            UpslopeError: a missing, damaged, foreign or newer file, or one with non-finite parameters.
        """
        trained_on, tensors = read_prior_file(Path(path))
        try:
            return cls(from_tensors(_skeleton(trained_on), tensors), trained_on)
        except ValueError as error:
            raise DamagedFileError(f"{path} is damaged ({error}): make the prior again.") from error


def trained_on(family: AbstractFamily, network: DuelingQ, seed: int, settings: dict[str, Any]) -> TrainedOn:
    """The provenance of a prior meta-trained on a family."""
    return TrainedOn(
        family=family.name,
        gamma=family.gamma,
        observation_shape=family.observation_shape,
        observation_scale=tuple(np.broadcast_to(network.torso.scale, family.observation_shape[-1:]).tolist()),
        scaled=network.scaling is not None,
        actions=family.actions.count,
        hidden=network.torso.hidden,
        head=network.advantage_head.name,
        activation=network.torso.activation,
        seed=seed,
        settings=settings,
        version=version("upslope"),
    )


def _skeleton(trained_on: TrainedOn) -> DuelingQ:
    """The shapes of the network that the header describes.

    Raises:
        ValueError: this version does not know the head.
    """
    if trained_on.head not in HEADS:
        raise ValueError(f"its advantage head {trained_on.head!r} is unknown")
    return eqx.filter_eval_shape(
        DuelingQ,
        jax.random.key(0),
        trained_on.observation_shape,
        trained_on.actions,
        trained_on.hidden,
        trained_on.observation_scale,
        trained_on.activation,
        HEADS[trained_on.head],
        no_scaling(trained_on.observation_shape[-1]) if trained_on.scaled else None,
    )
