"""Families of Gymnasium environments: a sampler of tasks, and a factory that makes an environment from a task."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal

import equinox as eqx
import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from upslope.errors import UpslopeError
from upslope.rollouts import ROLLOUTS, AbstractRollouts, EnvironmentFactory, Trajectories
from upslope.rollouts.task_slot import fit_spaces, make_environment
from upslope.tasks.abstract_evaluation import under_abstract_evaluation
from upslope.tasks.actions import Actions, ContinuousActions, DiscreteActions
from upslope.tasks.family import AbstractFamily, Network, as_key, recipe_of
from upslope.tasks.host_policy import host_policy, reset_and_act_keys, seed_of
from upslope.tasks.observation_scale import scale_of
from upslope.tasks.task_protocol import task_functions
from upslope.types import Key, Policy, Task, Transition


class RunningHost(eqx.Module):
    """Running host environments, as the number of their group in the family's rollouts."""

    number: Int[Array, ""]


class GymnasiumTasks(AbstractFamily):
    """A family of Gymnasium environments, for the same learners as compiled families.

    Internally a task is the two words of the random key with which it was drawn, so tasks can be stacked, repeated and
    saved like those of any family. The sampler is called again whenever an environment is needed, and must return the
    same task for the same ``rng``.

    Box observations with three axes are images ``[height, width, channels]`` for a convolutional network. All other
    observations in Box, Discrete, Dict or Tuple spaces become one vector of numbers. Actions are Discrete, or a Box
    with one axis and finite bounds, scaled to [−1, 1].

    Attributes:
        sample_task: draws one task with a NumPy generator.
        rollouts: runs policies in the environments; `close` closes them.
    """

    engine: ClassVar[Literal["compiled", "host"]] = "host"

    name: str = eqx.field(static=True)
    gamma: float = eqx.field(static=True)
    observation_shape: tuple[int, ...] = eqx.field(static=True)
    observation_scale: tuple[float, ...] = eqx.field(static=True)
    actions: Actions = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    recipe: str = eqx.field(static=True)
    sample_task: Callable[[np.random.Generator], Any] = eqx.field(static=True)
    rollouts: AbstractRollouts = eqx.field(static=True)

    def __init__(
        self,
        sample: Callable[[np.random.Generator], Any],
        make_env: Callable[[Any], gym.Env],
        gamma: float,
        *,
        name: str | None = None,
        observation_scale: Sequence[float] | None = None,
        max_steps: int | None = None,
        set_task: Callable[[gym.Env, Any], None] | None = None,
        mode: str = "sync",
    ):
        """Makes the family, and one environment to read its spaces.

        Args:
            sample: ``sample(rng) -> task``; a task is any value that ``make_env`` accepts.
            make_env: ``make_env(task) -> gymnasium.Env``.
            gamma: γ of every task and of every potential learned here.
            name: the name of the state space; the environment's id by default.
            observation_scale: factors that scale observations to the order of one; by default from the bounds of the
                space if they are finite and small. For images, one for each channel.
            max_steps: the length of the longest episode; the environment's own limit by default.
            set_task: ``set_task(env, task)`` gives a new task to an environment that ``make_env`` returned, before its
                next reset. Without it every task needs a new environment, which for many simulators takes longer than
                an episode.
            mode: a name in `upslope.rollouts.ROLLOUTS`: "sync" runs the environments in this process, "async" runs each
                in its own process (a script then needs ``if __name__ == "__main__":``).

        Raises:
            UpslopeError: gamma is not a discount, the mode is unknown, the sampler or factory fails, a space is not
                supported, or there is no limit of steps.
        """
        if not (isinstance(gamma, int | float) and 0 < gamma <= 1):
            raise UpslopeError(f"gamma is {gamma!r}, but a discount lies in (0, 1]: give one such as 0.98.")
        if mode not in ROLLOUTS:
            raise UpslopeError(f"mode is {mode!r}: give {' or '.join(map(repr, ROLLOUTS))}.")
        self.sample_task, self.gamma = sample, float(gamma)
        env = fit_spaces(make_environment(make_env, _draw(sample, np.zeros(2, np.uint32))))
        space: Any = env.observation_space
        actions: Any = env.action_space
        self.name = name or (env.spec.id if env.spec is not None else type(env.unwrapped).__name__)
        self.actions = _actions_of(actions)
        self.observation_shape = tuple(space.shape)
        self.recipe = recipe_of(self.observation_shape)
        self.observation_scale = scale_of(space.low, space.high, observation_scale)
        self.max_steps = _limit(env, max_steps)
        env.close()
        float32 = gym.spaces.Box(-np.inf, np.inf, self.observation_shape, np.float32)
        self.rollouts = ROLLOUTS[mode](EnvironmentFactory(make_env, set_task), float32, actions)

    @classmethod
    def from_protocol(cls, make_env: Callable[[], Any], gamma: float, **settings: Any) -> "GymnasiumTasks":
        """A family of environments with the older protocol: ``sample_tasks(n)`` and ``set_task(task)``.

        Args:
            make_env: makes an environment without arguments.
            gamma: γ.
            settings: see `GymnasiumTasks`.

        Raises:
            UpslopeError: the environment lacks these methods, or draws different tasks for the same seed.
        """
        sample, make, set_task = task_functions(make_env)
        return cls(sample, make, gamma, set_task=set_task, **settings)

    @property
    def lists_states(self) -> bool:
        return False

    @property
    def states(self) -> Any:
        raise UpslopeError("The states of Gymnasium environments can't be listed.")

    def acting_network(self, newest: Network, previous: Network) -> Network:
        del newest  # it is computed while the environments run
        return previous

    def sample(self, key: Key | int) -> Task:
        return jax.random.key_data(as_key(key))

    def task_of(self, task: Task) -> Any:
        """The value that the sampler returned for a task: the argument of the factory.

        Raises:
            UpslopeError: the sampler fails.
        """
        return _draw(self.sample_task, np.asarray(task))

    def sample_many(self, key: Key, count: int) -> Task:
        return _words(key, count)  # one call; mapping over keys takes a dozen

    def reset(self, key: Key, tasks: Task) -> RunningHost:
        if under_abstract_evaluation(key, tasks):
            return RunningHost(jnp.zeros((), jnp.int32))
        number = self.rollouts.start(self._tasks(tasks), seed_of(jax.random.key_data(key)))
        return RunningHost(jnp.asarray(number, jnp.int32))

    def collect(
        self, key: Key, tasks: Task, running: RunningHost, policy: Policy, steps: int
    ) -> tuple[RunningHost, Transition]:
        if under_abstract_evaluation(key, tasks):
            return running, self._zeros(len(tasks), steps)
        number = int(running.number)
        if not self.rollouts.knows(number, len(tasks)):  # from a checkpoint: episodes can't be restored
            number = int(self.reset(key, tasks).number)
        act = host_policy(policy, key, len(tasks), steps)
        trajectories = self.rollouts.collect(number, act(), steps)
        return RunningHost(jnp.asarray(number, jnp.int32)), self._transitions(trajectories)

    def rollout(self, key: Key, tasks: Task, policy: Policy, steps: int) -> Transition:
        return self.rollout_later(key, tasks, policy, steps)()

    def rollout_later(self, key: Key, tasks: Task, policy: Policy, steps: int) -> Callable[[], Transition]:
        if under_abstract_evaluation(key, tasks):
            return lambda: self._zeros(len(tasks), steps)
        reset_words, act_key = reset_and_act_keys(key)
        act = host_policy(policy, act_key, len(tasks), steps)

        def play() -> Transition:
            return self._transitions(self.rollouts.rollout(self._tasks(tasks), seed_of(reset_words), act(), steps))

        return play

    def returns(self, key: Key, tasks: Task, policy: Policy) -> Float[Array, "n"]:
        if under_abstract_evaluation(key, tasks):
            return jnp.zeros(len(tasks))
        reset_words, act_key = reset_and_act_keys(key)
        act = host_policy(policy, act_key, len(tasks), self.max_steps)
        return jnp.asarray(self.rollouts.returns(self._tasks(tasks), seed_of(reset_words), act(), self.max_steps))

    def close(self) -> None:
        """Closes all environments; later calls make new ones."""
        self.rollouts.close()

    def _transitions(self, trajectories: Trajectories) -> Transition:
        obs, action, reward, terminated, next_obs = trajectories
        # Truncation keeps the discount at γ: only termination cuts off the future.
        discount = (self.gamma * ~terminated).astype(np.float32)
        return Transition(*jax.device_put((obs, action, reward, discount, next_obs)))

    def _zeros(self, count: int, steps: int) -> Transition:
        """Transitions of zeros ``[count, steps, ...]``."""
        numbers = jnp.zeros((count, steps))
        obs = jnp.zeros((count, steps, *self.observation_shape))
        return Transition(obs, self.actions.zeros(count, steps, xp=jnp), numbers, numbers, obs)

    def _tasks(self, tasks: Task) -> list[Any]:
        words = np.asarray(tasks)
        if words.dtype != np.uint32 or words.ndim != 2:
            raise UpslopeError(
                "A task of a host family is what family.sample(key) returns, not a setting of the simulator: for your "
                "own task, make a family whose sample(rng) returns it."
            )
        sample = self.sample_task  # once: reading a module's attribute takes longer than a draw
        return [_draw(sample, row) for row in words]


def _actions_of(space: Any) -> Actions:
    """The actions of a space from `fit_spaces`: a box with one axis, or a discrete space."""
    return ContinuousActions(space.shape[0]) if space.shape else DiscreteActions(int(space.n))


def _draw(sample: Callable[[np.random.Generator], Any], words: np.ndarray) -> Any:
    try:
        return sample(np.random.default_rng([int(word) for word in words]))
    except Exception as error:
        raise UpslopeError(
            f"The sampler of tasks failed ({type(error).__name__}: {error}): fix sample(rng)."
        ) from error


_words = jax.jit(lambda key, count: jax.random.key_data(jax.random.split(key, count)), static_argnums=1)


def _limit(env: gym.Env, given: int | None) -> int:
    limit = given or (env.spec.max_episode_steps if env.spec is not None else None)
    if limit is None or limit < 1:
        raise UpslopeError(
            "The environment has no limit of steps: give max_steps, or wrap it in gymnasium.wrappers.TimeLimit."
        )
    return int(limit)
