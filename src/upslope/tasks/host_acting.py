"""Acting on the host: what a policy does in each step, drawn with the keys that a compiled family would use."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt32

from upslope.types import Acting, Key, Policy


def acting(policy: Policy, key: Key, environments: int, actions: int, steps: int) -> Callable[[], Acting]:
    """The policy's actions by step, drawn from now on; what is returned waits for them.

    Args:
        policy: acts in NumPy where it can (``on_host``), else compiled, one call a step.
        key: draws what the policy draws.
        environments: how many act at once.
        actions: how many there are to choose from, or numbers in one.
        steps: how many will be taken.
    """
    keys = _act_keys(key, steps)
    on_host = getattr(policy, "on_host", lambda *_: None)(keys, environments)
    if on_host is not None:
        return on_host
    return lambda: lambda step, obs: np.asarray(_act(policy, keys, jnp.asarray(step), jnp.asarray(obs)))


@jax.jit
def reset_and_act(key: Key) -> tuple[UInt32[Array, "2"], Key]:
    """The words of the key of a reset, and the key that draws what policies draw."""
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
