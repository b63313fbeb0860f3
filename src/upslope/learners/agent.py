"""An agent: the network that acts and a record of its training, saved as one safetensors file."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from upslope import storage
from upslope.errors import DamagedFileError, NotSavedError, UpslopeError
from upslope.learners import LEARNERS, AbstractLearnerConfig
from upslope.networks.tensors import from_tensors, to_tensors
from upslope.tasks.family import AbstractFamily

FORMAT = "upslope-agent"
FORMAT_VERSION = 1


@dataclass(frozen=True)
class AgentRecord:
    """What an agent was trained on; the JSON header of its file.

    Attributes:
        learner: the learner's name in `upslope.learners.LEARNERS`.
        settings: the learner's settings.
        family: the name of the state space.
        gamma: γ of the task.
        observation_shape: the shape of one observation.
        observation_scale: factors by which the network multiplies observations.
        action_kind: "discrete" or "continuous".
        actions: the number of discrete actions, or of components of a continuous action.
        seed: the seed of the training.
        version: the version of upslope.
    """

    learner: str
    settings: dict[str, Any]
    family: str
    gamma: float
    observation_shape: tuple[int, ...]
    observation_scale: tuple[float, ...]
    action_kind: str
    actions: int
    seed: int
    version: str = field(default_factory=lambda: version("upslope"))


@dataclass(frozen=True, eq=False, repr=False)
class Agent:
    """A trained policy.

    Attributes:
        network: the network that acts; it takes one observation.
        trained_on: what it was trained on.
    """

    network: Any
    trained_on: AgentRecord

    def act(self, obs: Any) -> Any:
        """The greedy action for one observation ``[*obs]``, or the actions for a batch ``[n, *obs]``, in NumPy.

        Observations are as the family returns them. A discrete action is an int. A continuous one is an array
        ``[numbers]`` in [−1, 1], whatever the bounds of the environment.

        Raises:
            UpslopeError: the observation has another shape.
        """
        return act(self._best, self.trained_on.observation_shape, obs)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Writes one safetensors file: the parameters, and the `AgentRecord` as its JSON header.

        Raises:
            UpslopeError: the file exists already or can't be written.
        """
        path = Path(path)
        if path.exists() and not overwrite:
            raise UpslopeError(f"{path} exists already, and nothing is overwritten: give another file name.")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise NotSavedError(f"{path} can't be written ({error.strerror}): give another file name.") from error
        storage.write(path, FORMAT, FORMAT_VERSION, {"trained_on": asdict(self.trained_on)}, to_tensors(self.network))

    @classmethod
    def load(cls, path: str | Path) -> "Agent":
        """Reads a file that `save` wrote, bit for bit. Nothing in the file is executed.

        Raises:
            UpslopeError: a missing, damaged, foreign or newer file, or one with non-finite parameters.
        """
        path = Path(path)
        if not path.is_file():
            raise UpslopeError(f"There is no agent at {path}: give the file that `Agent.save` wrote.")
        header, tensors, _ = storage.read(path, FORMAT, FORMAT_VERSION)
        try:
            trained_on = _record(header)
            network = from_tensors(_skeleton(trained_on), tensors)
        except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise DamagedFileError(f"{path} has a damaged header ({error}): train the agent again.") from error
        for name, tensor in tensors.items():
            if not np.isfinite(tensor).all():
                raise DamagedFileError(f"{path}: {name} holds numbers that are not finite: train the agent again.")
        return cls(network, trained_on)

    @cached_property
    def _best(self) -> Callable[[np.ndarray], np.ndarray]:
        return self.network.numpy_best()

    def __getstate__(self) -> dict[str, Any]:
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}  # a cached function can't be pickled

    def __repr__(self) -> str:
        about = self.trained_on
        return (
            f"Agent({about.learner} on {about.family!r}, observations {list(about.observation_shape)}, "
            f"{about.actions} {about.action_kind} actions, gamma={about.gamma}, seed={about.seed})"
        )


def record(config: AbstractLearnerConfig, family: AbstractFamily, seed: int) -> AgentRecord:
    """The record of an agent that was trained on a task of a family."""
    settings: Any = config
    return AgentRecord(
        learner=config.name,
        settings=asdict(settings),
        family=family.name,
        gamma=family.gamma,
        observation_shape=family.observation_shape,
        observation_scale=family.observation_scale,
        action_kind=family.actions.kind,
        actions=family.actions.count,
        seed=seed,
    )


def act(best: Callable[[np.ndarray], np.ndarray], observation_shape: tuple[int, ...], obs: Any) -> Any:
    """Actions for one observation or a batch.

    Args:
        best: returns the actions for a batch ``[n, *obs]``.
        observation_shape: the shape of one observation.
        obs: ``[*obs]`` or ``[n, *obs]``.

    Raises:
        UpslopeError: the observations have another shape.
    """
    obs = np.asarray(obs, np.float32)
    if is_batch(obs.shape, observation_shape):
        return best(obs)
    action = best(obs[None])[0]
    return action.item() if action.ndim == 0 else action


def is_batch(shape: tuple[int, ...], observation_shape: tuple[int, ...]) -> bool:
    """Whether an array of this shape is a batch of observations; otherwise it is a single observation.

    Raises:
        UpslopeError: it is neither.
    """
    if shape == observation_shape:
        return False
    if shape[1:] == observation_shape and len(shape) == len(observation_shape) + 1:
        return True
    one = list(observation_shape)
    raise UpslopeError(
        f"The observations have shape {list(shape)}: give one of shape {one}, or a batch [n, {str(one)[1:]}."
    )


def _record(header: dict[str, Any]) -> AgentRecord:
    """The record in a header. Raises ValueError, KeyError or TypeError if its entries do not describe a network."""
    record = AgentRecord(**_tuples(header["trained_on"]))
    sizes = (*record.observation_shape, record.actions)
    if not (record.observation_shape and all(type(size) is int and size > 0 for size in sizes)):
        raise ValueError("its sizes make no network")
    if len(record.observation_scale) != record.observation_shape[-1] or not np.isfinite(record.observation_scale).all():
        raise ValueError("its scales do not fit the observations")
    if record.learner not in LEARNERS:
        raise ValueError(f"its learner {record.learner!r} is unknown")
    return record


def _skeleton(record: AgentRecord) -> Any:
    """The shapes of the network that a header describes."""
    config = LEARNERS[record.learner](**record.settings)
    return eqx.filter_eval_shape(
        config.policy_network,
        jax.random.key(0),
        record.observation_shape,
        record.actions,
        record.observation_scale,
    )


def _tuples(value: Any) -> Any:
    """A JSON value with tuples instead of lists."""
    match value:
        case dict():
            return {name: _tuples(entry) for name, entry in value.items()}
        case list():
            return tuple(_tuples(entry) for entry in value)
    return value
