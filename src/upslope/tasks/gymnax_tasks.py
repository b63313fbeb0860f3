"""Families of JAX environments from other libraries, with the signature of gymnax ≥ 1.0."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from upslope.envs.fitted import FittedEnvironment
from upslope.errors import UpslopeError
from upslope.tasks.actions import Actions, ContinuousActions, DiscreteActions
from upslope.tasks.family import recipe_of
from upslope.tasks.jax_tasks import JaxTasks
from upslope.tasks.observation_scale import scale_of
from upslope.types import Key, Task


class AsArrays(eqx.Module):
    """Draws parameters and converts their numbers to arrays, so that tasks can be stacked."""

    sample_params: Callable[[Key], Any]

    def __call__(self, key: Key) -> Task:
        return jax.tree.map(jnp.asarray, self.sample_params(key))


def gymnax_tasks(
    env: Any,
    sample_params: Callable[[Key], Any],
    gamma: float,
    *,
    name: str | None = None,
    observation_scale: Sequence[float] | None = None,
    max_steps: int | None = None,
) -> JaxTasks:
    """A family of tasks in one environment. Tasks are its parameters, and learners compile it into their programs.

    Observations with three axes are images ``[height, width, channels]`` for a convolutional network. Numbers from a
    discrete space become one-hot vectors, and all other observations become one vector. The environment distinguishes
    terminations from truncations: gymnax ≥ 1.0 returns both, and a time limit is a truncation.

    If you draw a parameter, also set the parameters that depend on it: gymnax's ``CartPole`` with another ``length``
    keeps its old ``polemass_length`` unless that is set too. For environments with xminigrid's signature there is
    `upslope.envs.time_steps.TimeStepEnvironment`.

    Args:
        env: has ``reset(key, params)``, a six-value ``step(key, state, action, params)`` that resets automatically and
            returns the true successor in ``info["final_observation"]``, ``action_space(params)`` and
            ``observation_space(params)``. Families of the same ``env`` share compiled programs.
        sample_params: draws the parameters of one task: a function of a key that JAX can trace, or such a module.
        gamma: γ of every task and of every potential learned here.
        name: the name of the state space; the environment's own by default.
        observation_scale: factors that scale observations to the order of one; by default from the bounds of the space
            if they are finite and small. For images, one for each channel.
        max_steps: the length of the longest episode; by default ``max_steps_in_episode`` (or ``max_steps``) of the
            parameters.

    Raises:
        UpslopeError: gamma is not a discount, the sampler fails, the environment has another signature, the action
            space is not supported, or there is no limit of steps.
    """
    if not (isinstance(gamma, int | float) and 0 < gamma <= 1):
        raise UpslopeError(f"gamma is {gamma!r}, but a discount lies in (0, 1]: give one such as 0.98.")
    sampler = AsArrays(sample_params if isinstance(sample_params, eqx.Module) else jax.tree_util.Partial(sample_params))
    try:
        params = sampler(jax.random.key(0))
    except Exception as error:
        raise UpslopeError(
            f"The sampler of parameters failed ({type(error).__name__}: {error}): fix sample_params(key)."
        ) from error
    actions, action_shape = _actions(env, params)
    obs = _check_signature(env, params, action_shape)
    observations, shape = _observations(env.observation_space(params), obs)
    return JaxTasks(
        name=name or str(getattr(env, "name", type(env).__name__)),
        env=FittedEnvironment(env, observations, shape, action_shape),
        sample_params=sampler,
        gamma=float(gamma),
        observation_shape=shape,
        observation_scale=_scale(env.observation_space(params), shape, observation_scale),
        actions=actions,
        max_steps=_limit(params, max_steps),
        recipe=recipe_of(shape),
    )


def _actions(env: Any, params: Any) -> tuple[Actions, tuple[int, ...] | None]:
    """The actions, and the shape of a continuous action; None for discrete actions."""
    space = env.action_space(params)
    if hasattr(space, "n"):
        return DiscreteActions(int(space.n)), None
    bounds = [np.asarray(getattr(space, side, np.nan), np.float64) for side in ("low", "high")]
    if not all(np.isfinite(bound).all() for bound in bounds):
        raise UpslopeError(
            f"Actions of {space!r} are not supported: use a discrete space, or a box with finite bounds."
        )
    return ContinuousActions(math.prod(space.shape)), tuple(space.shape)


def _check_signature(env: Any, params: Any, action_shape: tuple[int, ...] | None) -> Any:
    """The shapes of an observation, after a check of the environment's signature.

    Raises:
        UpslopeError: the environment fails, or its step has another signature.
    """
    action = jnp.zeros((), jnp.int32) if action_shape is None else jnp.zeros(action_shape)

    def play(key: Key) -> tuple[Any, Any]:
        obs, state = env.reset(key, params)
        return obs, env.step(key, state, action, params)

    try:
        obs, step = jax.eval_shape(play, jax.random.key(0))
    except Exception as error:
        raise UpslopeError(
            f"{type(env).__name__} can't be traced ({type(error).__name__}: {error}): it needs reset(key, params) and "
            "step(key, state, action, params), as in gymnax."
        ) from error
    if len(step) != 6 or "final_observation" not in step[-1]:
        raise UpslopeError(
            f"{type(env).__name__}.step gives {len(step)} values: it must give observation, state, reward, terminated, "
            'truncated and info, with the true successor in info["final_observation"]; gymnax does from 1.0 on.'
        )
    return obs


def _observations(space: Any, obs: Any) -> tuple[int, tuple[int, ...]]:
    """The number of observations in a discrete space, otherwise 0, and the shape of one for learners."""
    leaves = jax.tree.leaves(obs)
    if len(leaves) == 1 and leaves[0].ndim == 0 and hasattr(space, "n"):
        return int(space.n), (int(space.n),)
    if len(leaves) == 1 and leaves[0].ndim == 3:
        return 0, leaves[0].shape
    return 0, (sum(math.prod(leaf.shape) for leaf in leaves),)


def _scale(space: Any, shape: tuple[int, ...], given: Sequence[float] | None) -> tuple[float, ...]:
    theirs: Any = getattr(space, "shape", None)
    bounds = []
    for side in ("low", "high"):
        bound = getattr(space, side, None)
        is_known = bound is not None and theirs is not None and math.prod(theirs) == math.prod(shape)
        bounds.append(np.broadcast_to(np.asarray(bound), theirs).reshape(shape) if is_known else np.full(shape, np.inf))
    return scale_of(bounds[0], bounds[1], given)


def _limit(params: Any, given: int | None) -> int:
    stated = getattr(params, "max_steps_in_episode", getattr(params, "max_steps", None))
    limit = stated if given is None else given
    if limit is None or int(limit) < 1:
        raise UpslopeError(
            "The parameters do not say after how many steps an episode is truncated: give max_steps, as many as in the "
            "longest episode of any task."
        )
    return int(limit)
