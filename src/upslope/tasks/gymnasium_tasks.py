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
from upslope.rollouts.host_environments import Episodes, HostEnvironments, Mode
from upslope.rollouts.task_slot import made
from upslope.tasks.abstract_evaluation import evaluated_abstractly
from upslope.tasks.actions import Actions, ContinuousActions, DiscreteActions
from upslope.tasks.family import AbstractFamily, Network, recipe_of
from upslope.tasks.host_acting import acting, reset_and_act, seed_of
from upslope.tasks.observation_scale import scale_of
from upslope.tasks.task_protocol import of_protocol
from upslope.types import Acting, Key, Policy, Task, Transition


class RunningHost(eqx.Module):
    """Host environments in the middle of their episodes, by the number that the family knows them by."""

    number: Int[Array, ""]


class GymnasiumTasks(AbstractFamily):
    """A family over Gymnasium environments, for the same learners as compiled families.

    Inside, a task is the two words of the random key that it was drawn with: tasks stack, repeat and are saved like
    those of any family, and the sampler is asked again whenever an environment is needed. So it must give the same
    task for the same ``rng``.

    Box observations of three axes are images ``[height, width, channels]``, and get a convolutional network; all
    others of Box, Discrete, Dict or Tuple spaces become one vector of numbers. Actions are Discrete, or a Box of one
    axis with finite bounds, brought to [−1, 1].

    Attributes:
        sample_task: draws one task with a NumPy generator.
        environments: made so far; `close` closes them.
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
    environments: HostEnvironments = eqx.field(static=True)

    def __init__(
        self,
        sample: Callable[[np.random.Generator], Any],
        make_env: Callable[[Any], gym.Env],
        gamma: float,
        *,
        name: str | None = None,
        observation_scale: Sequence[float] | None = None,
        max_steps: int | None = None,
        mode: Mode = "sync",
    ):
        """Makes the family, after one environment was made to see its spaces.

        Args:
            sample: ``sample(rng) -> task``; anything that ``make_env`` understands.
            make_env: ``make_env(task) -> gymnasium.Env``.
            gamma: γ, of every task and of every potential learned here.
            name: of the state space; the environment's id by default.
            observation_scale: brings each observation to the order of one; by default from the bounds of the space,
                where they are finite and small. Of images, one for each channel.
            max_steps: the longest episode; the environment's own limit by default.
            mode: "sync" runs the environments in this process, "async" each in a process of its own (a script then
                needs ``if __name__ == "__main__":``).

        Raises:
            UpslopeError: no discount, a sampler or factory that fails, an unsupported space, or no limit of steps.
        """
        if not (isinstance(gamma, int | float) and 0 < gamma <= 1):
            raise UpslopeError(f"gamma is {gamma!r}, but a discount lies in (0, 1]: give one such as 0.98.")
        if mode not in ("sync", "async"):
            raise UpslopeError(f'mode is {mode!r}: give "sync" or "async".')
        self.sample_task, self.gamma = sample, float(gamma)
        env = made(make_env, _drawn(sample, np.zeros(2, np.uint32)))
        space: Any = env.observation_space
        actions: Any = env.action_space
        self.name = name or (env.spec.id if env.spec is not None else type(env.unwrapped).__name__)
        self.actions = _kind(actions)
        self.observation_shape = tuple(space.shape)
        self.recipe = recipe_of(self.observation_shape)
        self.observation_scale = scale_of(space.low, space.high, observation_scale)
        self.max_steps = _limit(env, max_steps)
        env.close()
        float32 = gym.spaces.Box(-np.inf, np.inf, self.observation_shape, np.float32)
        self.environments = HostEnvironments(make_env, (float32, actions), mode)

    @classmethod
    def from_protocol(cls, make_env: Callable[[], Any], gamma: float, **settings: Any) -> "GymnasiumTasks":
        """A family from environments of the older protocol: ``sample_tasks(n)`` and ``set_task(task)``.

        Args:
            make_env: makes an environment without arguments.
            gamma: γ.
            settings: see `GymnasiumTasks`.

        Raises:
            UpslopeError: the environment has no such methods, or draws other tasks for the same seed.
        """
        return cls(*of_protocol(make_env), gamma, **settings)

    @property
    def lists_states(self) -> bool:
        return False

    @property
    def states(self) -> Any:
        raise UpslopeError("The states of Gymnasium environments can't be listed.")

    def acting_network(self, newest: Network, previous: Network) -> Network:
        del newest  # it is computed while the environments take their steps
        return previous

    def sample(self, key: Key) -> Task:
        return jax.random.key_data(key)

    def task_of(self, task: Task) -> Any:
        """What the sampler gives for a task: the argument of the factory.

        Raises:
            UpslopeError: the sampler fails.
        """
        return _drawn(self.sample_task, np.asarray(task))

    def sample_many(self, key: Key, count: int) -> Task:
        return _words(key, count)  # in one call, where mapping over keys takes a dozen

    def reset(self, key: Key, tasks: Task) -> RunningHost:
        if evaluated_abstractly(key, tasks):
            return RunningHost(jnp.zeros((), jnp.int32))
        number = self.environments.start(self._tasks(tasks), seed_of(jax.random.key_data(key)))
        return RunningHost(jnp.asarray(number, jnp.int32))

    def collect(
        self, key: Key, tasks: Task, running: RunningHost, policy: Policy, steps: int
    ) -> tuple[RunningHost, Transition]:
        if evaluated_abstractly(key, tasks):
            return running, self._shapes(len(tasks), steps)
        number = int(running.number)
        if not self.environments.knows(number, len(tasks)):  # from a checkpoint: episodes can't be restored
            running = self.reset(key, tasks)
            number = int(running.number)
        act = acting(policy, key, len(tasks), self.actions.count, steps)()
        transitions = self._play(self.environments.go_on(number), act, steps)
        return RunningHost(jnp.asarray(number, jnp.int32)), transitions

    def rollout(self, key: Key, tasks: Task, policy: Policy, steps: int) -> Transition:
        if evaluated_abstractly(key, tasks):
            return self._shapes(len(tasks), steps)
        return self.rollout_later(key, tasks, policy, steps)()

    def rollout_later(self, key: Key, tasks: Task, policy: Policy, steps: int) -> Callable[[], Transition]:
        reset_words, act_key = reset_and_act(key)
        act = acting(policy, act_key, len(tasks), self.actions.count, steps)

        def play() -> Transition:
            episodes = self.environments.fresh(self._tasks(tasks), seed_of(reset_words))
            return self._play(episodes, act(), steps)

        return play

    def returns(self, key: Key, tasks: Task, policy: Policy) -> Float[Array, "n"]:
        if evaluated_abstractly(key, tasks):
            return jnp.zeros(len(tasks))
        reset_words, act_key = reset_and_act(key)
        episodes = self.environments.fresh(self._tasks(tasks), seed_of(reset_words))
        act = acting(policy, act_key, len(tasks), self.actions.count, self.max_steps)()
        alive, total = np.ones(len(tasks), bool), np.zeros(len(tasks), np.float32)
        for step in range(self.max_steps):
            rewards, terminated, truncated, _ = episodes.step(act(step, episodes.obs))
            total += alive * rewards
            alive &= ~(terminated | truncated)
            if not alive.any():
                break
        return jnp.asarray(total)

    def close(self) -> None:
        """Closes all environments; they are made anew when needed."""
        self.environments.close()

    def _play(self, episodes: Episodes, act: Acting, steps: int) -> Transition:
        count = len(episodes.obs)
        # Steps come first here, so that each writes whole rows.
        played, terminated = self._shapes(steps, count, np), np.zeros((steps, count), bool)
        obs, action, reward, _, next_obs = played  # looked up once: a module's attributes cost more than a write
        for step in range(steps):
            obs[step] = shown = episodes.obs
            action[step] = chosen = act(step, shown)
            reward[step], terminated[step], _, next_obs[step] = episodes.step(chosen)
        # Truncation keeps the discount at γ: only a true end cuts the future off.
        played.discount[:] = self.gamma * ~terminated
        return jax.device_put(Transition(*(leaf.swapaxes(0, 1) for leaf in played)))

    def _shapes(self, rows: int, columns: int, xp: Any = jnp) -> Transition:
        """Transitions of zeros ``[rows, columns, ...]``."""
        numbers = xp.zeros((rows, columns), np.float32)
        obs = xp.zeros((rows, columns, *self.observation_shape), np.float32)
        action = self.actions.zeros(rows, columns, xp=xp)
        return Transition(obs, action, numbers, xp.zeros_like(numbers), xp.zeros_like(obs))

    def _tasks(self, tasks: Task) -> list[Any]:
        words = np.asarray(tasks)
        if words.dtype != np.uint32 or words.ndim != 2:
            raise UpslopeError(
                "A task of a host family is what family.sample(key) gives, not the simulator's own setting: for a task "
                "of your own, make a family whose sample(rng) returns it."
            )
        sample = self.sample_task  # looked up once: a module's attributes cost more than a draw
        return [_drawn(sample, row) for row in words]


def _kind(space: Any) -> Actions:
    """The kind of action of a fitted space: a box of one axis, or a discrete one."""
    return ContinuousActions(space.shape[0]) if space.shape else DiscreteActions(int(space.n))


def _drawn(sample: Callable[[np.random.Generator], Any], words: np.ndarray) -> Any:
    try:
        return sample(np.random.default_rng([int(word) for word in words]))
    except Exception as error:
        raise UpslopeError(
            f"The sampler of tasks failed ({type(error).__name__}: {error}): mend sample(rng)."
        ) from error


_words = jax.jit(lambda key, count: jax.random.key_data(jax.random.split(key, count)), static_argnums=1)


def _limit(env: gym.Env, given: int | None) -> int:
    limit = given or (env.spec.max_episode_steps if env.spec is not None else None)
    if limit is None or limit < 1:
        raise UpslopeError(
            "The environment does not say after how many steps it is truncated: give max_steps, "
            "or wrap it in gymnasium.wrappers.TimeLimit."
        )
    return int(limit)
