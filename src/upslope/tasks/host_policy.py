"""Policies on the host. Their noise is drawn with the keys that a compiled family would use."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt32

from upslope.rollouts import Act
from upslope.types import Key, Policy


def host_policy(policy: Policy, key: Key, environments: int, steps: int) -> Callable[[], Act]:
    """Starts to draw a policy's noise for all steps. The returned function waits for it and returns the policy.

    Args:
        policy: runs in NumPy if it can (``on_host``), otherwise compiled, with one call per step.
        key: for the noise.
        environments: the number of environments that act at once.
        steps: the number of steps that will be taken.
    """
    keys = _act_keys(key, steps)
    in_numpy = getattr(policy, "on_host", lambda *_: None)(keys, environments)
    if in_numpy is not None:
        return in_numpy
    return lambda: lambda step, obs: np.asarray(_act(policy, keys, jnp.asarray(step), jnp.asarray(obs)))


@jax.jit
def reset_and_act_keys(key: Key) -> tuple[UInt32[Array, "2"], Key]:
    """The two words of the reset key, and the key for a policy's noise."""
    reset_key, act_key = jax.random.split(key)
    return jax.random.key_data(reset_key), act_key


def seed_of(words: UInt32[Array, "2"]) -> int:
    """A key's two words as one number, for NumPy's generators."""
    high, low = np.asarray(words).tolist()
    return high << 32 | low


def _act_keys_of(key: Key, steps: int) -> Any:
    return jax.vmap(lambda key: jax.random.split(key)[0])(jax.random.split(key, steps))


_act_keys = jax.jit(_act_keys_of, static_argnames="steps")
_act = eqx.filter_jit(lambda policy, keys, step, obs: policy(keys[step], obs))
