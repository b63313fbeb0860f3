"""Families of environments written in JAX. Collection is compiled into the learner's own program."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.errors import UpslopeError
from upslope.tasks.actions import Actions
from upslope.tasks.family import AbstractFamily, Network, as_key
from upslope.types import Key, Keys, Policy, Task, Transition


class RunningEnvironments(eqx.Module):
    """Running environments: the observations to act on, and the states, ``[n, ...]``."""

    obs: Float[Array, "n *obs"]
    state: Any


class Always(eqx.Module):
    """A sampler that always draws the same task, for `JaxTasks.only`."""

    task: Task

    def __call__(self, key: Key) -> Task:
        del key
        return self.task


def _as_pytree(sampler: Callable[[Key], Task]) -> Callable[[Key], Task]:
    return sampler if isinstance(sampler, eqx.Module) else jax.tree_util.Partial(sampler)


class JaxTasks(AbstractFamily):
    """A family of tasks in any environment with gymnax's signature (≥ 1.0). A task is the environment's parameters.

    Attributes:
        env: has ``reset(key, params)`` and the six-value ``step(key, state, action, params)`` with
            ``info["final_observation"]``. It is compared by value, so that equal families share compiled programs.
        sample_params: draws one task; a plain function, or a module with array leaves.
    """

    engine: ClassVar[Literal["compiled", "host"]] = "compiled"

    name: str = eqx.field(static=True)
    env: Any = eqx.field(static=True)
    sample_params: Callable[[Key], Task] = eqx.field(converter=_as_pytree)
    gamma: float = eqx.field(static=True)
    observation_shape: tuple[int, ...] = eqx.field(static=True)
    observation_scale: tuple[float, ...] = eqx.field(static=True)
    actions: Actions = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    recipe: str = eqx.field(static=True)

    @property
    def lists_states(self) -> bool:
        return hasattr(self.env, "observe_all")

    @property
    def states(self) -> Any:
        if not self.lists_states:
            raise UpslopeError(f"The states of {self.name} tasks can't be listed: env has no observe_all.")
        return self.env

    def acting_network(self, newest: Network, previous: Network) -> Network:
        del previous
        return newest

    def sample(self, key: Key | int) -> Task:
        return self.sample_params(as_key(key))

    def only(self, task: Task) -> "JaxTasks":
        """The same family with only this task. Stacked tasks make a stack of families, in one program."""
        return replace(self, sample_params=Always(task))

    def reset(self, key: Key, tasks: Task) -> RunningEnvironments:
        return RunningEnvironments(*jax.vmap(self.env.reset)(jax.random.split(key, _count(tasks)), tasks))

    def collect(
        self, key: Key, tasks: Task, running: RunningEnvironments, policy: Policy, steps: int
    ) -> tuple[RunningEnvironments, Transition]:
        draws, act = _ahead(jax.random.split(key, steps), policy, running.obs)

        def one_step(running: RunningEnvironments, drawn: Any) -> tuple[RunningEnvironments, Transition]:
            noise, keys = drawn
            action = act(noise, running.obs)
            obs, state, reward, terminated, _, info = self._step(keys, running.state, action, tasks)
            # Truncation keeps the discount at γ: only termination cuts off the future.
            discount = self.gamma * (1.0 - terminated)
            transition = Transition(running.obs, action, reward, discount, info["final_observation"])
            return RunningEnvironments(obs, state), transition

        running, transitions = jax.lax.scan(one_step, running, draws)
        return running, jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), transitions)

    def rollout(self, key: Key, tasks: Task, policy: Policy, steps: int) -> Transition:
        reset_key, act_key = jax.random.split(key)
        return self.collect(act_key, tasks, self.reset(reset_key, tasks), policy, steps)[1]

    def returns(self, key: Key, tasks: Task, policy: Policy) -> Float[Array, "n"]:
        reset_key, episode_key = jax.random.split(key)
        running = self.reset(reset_key, tasks)
        count = _count(tasks)
        draws, act = _ahead(jax.random.split(episode_key, self.max_steps), policy, running.obs)

        def one_step(carry: tuple, drawn: Any) -> tuple[tuple, None]:
            running, alive, total = carry
            noise, keys = drawn
            action = act(noise, running.obs)
            obs, state, reward, terminated, truncated, _ = self._step(keys, running.state, action, tasks)
            total = total + alive * reward
            return (RunningEnvironments(obs, state), alive & ~(terminated | truncated), total), None

        start = (running, jnp.ones(count, bool), jnp.zeros(count))
        (_, _, total), _ = jax.lax.scan(one_step, start, draws)
        return total

    def _step(self, keys: Keys, state: Any, action: Any, tasks: Task) -> tuple:
        return jax.vmap(self.env.step)(keys, state, action, tasks)


def _ahead(keys: Keys, policy: Policy, obs: Float[Array, "n *obs"]) -> tuple[tuple[Any, Keys], Callable[..., Any]]:
    """Draws the policy's noise and the environments' keys ``[steps, n]`` of all steps, before the first step.

    Returns:
        The draws, and the policy as a function of one step's noise. Policies that are plain functions draw their own.
    """
    act_keys, step_keys = jax.vmap(jax.random.split, out_axes=1)(keys)
    step_keys = jax.vmap(lambda key: jax.random.split(key, obs.shape[0]))(step_keys)
    noise, act = policy.ahead(act_keys, obs) if hasattr(policy, "ahead") else (act_keys, policy)
    return (noise, step_keys), act


def _count(tasks: Task) -> int:
    return jax.tree.leaves(tasks)[0].shape[0]
