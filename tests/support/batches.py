"""Small networks and hand-made transitions."""

import equinox as eqx
import jax
import jax.numpy as jnp

from upslope.networks.dueling import DuelingQ
from upslope.types import Transition

OBSERVATIONS = 3
ACTIONS = 2


@eqx.filter_jit  # one program, not one for every array shape
def small_network(seed=0, *, inputs=OBSERVATIONS, actions=ACTIONS, hidden=(6, 5)) -> DuelingQ:
    return DuelingQ(jax.random.key(seed), inputs, actions, hidden)


@eqx.filter_jit
def random_batch(seed=0, *, leading=(8,), gamma=0.9, actions=ACTIONS) -> Transition:
    """Transitions ``[*leading, ...]`` with random contents; about a third of them terminate."""
    keys = jax.random.split(jax.random.key(seed), 5)
    return Transition(
        jax.random.normal(keys[0], (*leading, OBSERVATIONS)),
        jax.random.randint(keys[1], leading, 0, actions),
        jax.random.normal(keys[2], leading),
        gamma * (jax.random.uniform(keys[3], leading) > 1 / 3),
        jax.random.normal(keys[4], (*leading, OBSERVATIONS)),
    )


def one_number(value) -> jnp.ndarray:
    """A number as the scalar array that the equations take."""
    return jnp.asarray(value, float)
