"""The random keys of an experiment: one per purpose, so that no two purposes share random numbers."""

from enum import IntEnum

import jax
import jax.numpy as jnp

from upslope.types import Key, Keys


class Purpose(IntEnum):
    """What a key is for. Test tasks have their own key, which nothing else uses."""

    META_TRAINING = 0
    TEST_TASKS = 1
    TUNING_TASKS = 2
    ORACLE = 3
    LEVEL = 4
    ZERO_SHOT = 5
    LEFT = 6
    TUNING = 7
    MIDDLE = 8
    RIGHT = 9


def key_for(seed: int, purpose: Purpose) -> Key:
    """The key of one seed for one purpose."""
    return jax.random.fold_in(jax.random.key(seed), purpose)


def keys_for(first_seed: int, seeds: int, purpose: Purpose) -> Keys:
    """The keys ``[seeds]`` of consecutive seeds for one purpose."""
    return jnp.stack([key_for(seed, purpose) for seed in range(first_seed, first_seed + seeds)])


def keys_per_task(first_seed: int, seeds: int, tasks: int, purpose: Purpose) -> Keys:
    """The keys ``[seeds, tasks]`` of every run; the arms of a comparison share them."""
    return jax.vmap(lambda key: jax.random.split(key, tasks))(keys_for(first_seed, seeds, purpose))
