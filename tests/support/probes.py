"""Probe environments: tiny tasks whose values are known by hand, as tables in the task.

All discrete probes share one environment, so one compiled program learns all of them at once.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from upslope.tasks import JaxTasks
from upslope.tasks.actions import ContinuousActions, DiscreteActions

PLACES, ACTIONS = 2, 2
GAMMA = 0.8


class Place(eqx.Module):
    """The current place in a probe, and the number of steps so far."""

    place: Int[Array, ""]
    time: Int[Array, ""]


def observe(place) -> Float[Array, "places"]:
    """Places are observed one-hot."""
    return jax.nn.one_hot(place, PLACES)


class ProbeTask(eqx.Module):
    """What each action does at each place ``[places, actions]``, where episodes start, and when they are truncated."""

    successor: Int[Array, "places actions"]
    reward: Float[Array, "places actions"]
    terminal: Bool[Array, "places actions"]
    starts: Float[Array, "places"]
    time_limit: Int[Array, ""]


@dataclass(frozen=True)
class Probe:
    """The environment of every `ProbeTask`."""

    def reset(self, key, params):
        place = jax.random.choice(key, PLACES, p=params.starts)
        return observe(place), Place(place, jnp.zeros((), jnp.int32))

    def step(self, key, state, action, params):
        at = (state.place, action)
        terminated = params.terminal[at]
        following = Place(params.successor[at], state.time + 1)
        truncated = (following.time >= params.time_limit) & ~terminated
        return _with_reset(self, key, params, following, params.reward[at], terminated, truncated)


class TargetTask(eqx.Module):
    """One step for −(action − target)², with its own target at each place; the next place is the other one."""

    targets: Float[Array, "places"]


@dataclass(frozen=True)
class Target:
    """The environment of every `TargetTask`."""

    def reset(self, key, params):
        place = jax.random.randint(key, (), 0, PLACES)
        return observe(place), Place(place, jnp.zeros((), jnp.int32))

    def step(self, key, state, action, params):
        reward = -jnp.sum((action - params.targets[state.place]) ** 2)
        other = Place(1 - state.place, state.time + 1)
        return _with_reset(self, key, params, other, reward, jnp.asarray(True), jnp.asarray(False))


def _with_reset(env, key, params, following, reward, terminated, truncated):
    fresh_obs, fresh = env.reset(key, params)
    done = terminated | truncated
    obs = jnp.where(done, fresh_obs, observe(following.place))
    state = jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, following)
    return obs, state, reward, terminated, truncated, {"final_observation": observe(following.place)}


def _task(successor, reward, terminal, starts=(1.0, 0.0), time_limit=1000) -> ProbeTask:
    return ProbeTask(
        jnp.asarray(successor, jnp.int32),
        jnp.asarray(reward, jnp.float32),
        jnp.asarray(terminal, bool),
        jnp.asarray(starts, jnp.float32),
        jnp.asarray(time_limit, jnp.int32),
    )


UNREACHED = (0.0, 0.0)

ONE_STEP = [[1, 1], [0, 0]]
ENDS = [[True, True], [True, True]]


def constant_reward() -> ProbeTask:
    """One step, reward 1 for every action. Q = 1."""
    return _task(ONE_STEP, [[1, 1], UNREACHED], ENDS)


def two_steps() -> ProbeTask:
    """Reward 0, then 1. Q = γ, then 1."""
    return _task([[1, 1], [0, 0]], [[0, 0], [1, 1]], [[False, False], [True, True]])


def action_dependent() -> ProbeTask:
    """One step: −1 for the first action, 1 for the second."""
    return _task(ONE_STEP, [[-1, 1], UNREACHED], ENDS)


def observation_dependent() -> ProbeTask:
    """One step from either place: −1 from the first, 1 from the second."""
    return _task(ONE_STEP, [[-1, -1], [1, 1]], ENDS, starts=(0.5, 0.5))


def truncation_only() -> ProbeTask:
    """Reward 1 at every step, truncated after every third. Q = 1/(1 − γ), as without truncation."""
    return _task([[0, 0], [1, 1]], [[1, 1], UNREACHED], [[False, False], [False, False]], time_limit=3)


def choices() -> ProbeTask:
    """Stop with reward 0 or go on; then 1 for the first action, −1 for the second. Q = (0, γ), then (1, −1)."""
    return _task([[0, 1], [0, 0]], [[0, 0], [1, -1]], [[True, False], [True, True]])


#: Every probe, its Q* ``[places, actions]`` (NaN at places that episodes never visit), and its greedy return.
DISCRETE = {
    "constant reward": (constant_reward(), [[1, 1], [np.nan, np.nan]], 1),
    "two steps": (two_steps(), [[GAMMA, GAMMA], [1, 1]], 1),
    "action-dependent": (action_dependent(), [[-1, 1], [np.nan, np.nan]], 1),
    "observation-dependent": (observation_dependent(), [[-1, -1], [1, 1]], None),
    "truncation only": (truncation_only(), [[1 / (1 - GAMMA)] * 2, [np.nan, np.nan]], 3),
    "choices": (choices(), [[0, GAMMA], [1, -1]], 1),
}


@dataclass(frozen=True)
class AlwaysChoices:
    """The sampler of a family of equal tasks."""

    def __call__(self, key) -> ProbeTask:
        del key
        return choices()


def discrete_family() -> JaxTasks:
    """A family of `ProbeTask`s; its sampler always draws `choices`."""
    return _family(Probe(), AlwaysChoices(), actions=DiscreteActions(ACTIONS))


@dataclass(frozen=True)
class RandomTargets:
    """Draws targets in the middle of the range of actions."""

    def __call__(self, key) -> TargetTask:
        return TargetTask(jax.random.uniform(key, (PLACES,), minval=-0.7, maxval=0.7))


def continuous_family() -> JaxTasks:
    """A family of `TargetTask`s."""
    return _family(Target(), RandomTargets(), actions=ContinuousActions(1))


def _family(env, sampler, *, actions) -> JaxTasks:
    return JaxTasks(
        name="probe",
        env=env,
        sample_params=sampler,
        gamma=GAMMA,
        observation_shape=(PLACES,),
        observation_scale=(1.0,) * PLACES,
        actions=actions,
        max_steps=4,
        recipe="vectors",
    )


class TablePotential(eqx.Module):
    """A potential by place; an array leaf, so that learners with different tables stack."""

    table: Float[Array, "places"]

    def __call__(self, obs: Float[Array, "places"]) -> Float[Array, ""]:
        return self.table @ obs


def table_potential(*values: float) -> TablePotential:
    return TablePotential(jnp.asarray(values, jnp.float32))
