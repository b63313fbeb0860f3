"""Chunks of steps, compiled once and mapped over a batch of learners and over the local devices."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from upslope.learner import AbstractLearner


@jax.jit
def start(learners, keys):
    return jax.vmap(lambda learner, key: learner.init(key))(learners, keys)

@partial(jax.jit, donate_argnums=1)
def advance(learners, states, steps):
    def one(learner, state):
        zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(learner.step, state)[1])
        def body(_, carry):
            state, total = carry
            state, metrics = learner.step(state)
            return state, jax.tree.map(jnp.add, total, metrics)
        state, total = jax.lax.fori_loop(0, steps, body, (state, zeros))
        return state, jax.tree.map(lambda t: t / jnp.maximum(steps, 1), total), learner.report(state)
    return jax.vmap(one)(learners, states)
