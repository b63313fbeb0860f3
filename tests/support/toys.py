"""A learner that compiles quickly and an observer that records its calls, to test the loop without an algorithm."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from upslope.learners.learner import AbstractLearner
from upslope.types import Key


class WalkState(eqx.Module):
    key: Key
    place: Float[Array, ""]
    steps: Int[Array, ""]


class Walk(AbstractLearner):
    """A random walk with a drift; breaks (NaN) at the step numbered ``breaks_at``."""

    drift: Float[Array, ""]
    breaks_at: Int[Array, ""]
    in_turns: bool = eqx.field(static=True, default=False)

    @property
    def engine(self) -> str:
        return "compiled"

    @property
    def takes_turns(self) -> bool:
        return self.in_turns

    def init(self, key: Key) -> WalkState:
        return WalkState(key, jnp.zeros(()), jnp.zeros((), jnp.int32))

    def step(self, state: WalkState) -> tuple[WalkState, dict[str, Any]]:
        key, step_key = jax.random.split(state.key)
        place = state.place + self.drift + 0.1 * jax.random.normal(step_key)
        metric = jnp.where(state.steps + 1 == self.breaks_at, jnp.nan, state.steps + 1.0)
        return WalkState(key, place, state.steps + 1), {"step": metric}

    def report(self, state: WalkState) -> dict[str, Any]:
        return {"return": state.place, "pair": jnp.stack([state.place, -state.place])}


def walks(drifts, breaks_at: int = -1, *, in_turns: bool = False) -> Walk:
    """Walks stacked in the shape of ``drifts``."""
    drifts = jnp.asarray(drifts, jnp.float32)
    stacked = Walk(jnp.zeros(()), jnp.zeros((), jnp.int32), in_turns=in_turns)
    return eqx.tree_at(
        lambda walk: (walk.drift, walk.breaks_at), stacked, (drifts, jnp.full(drifts.shape, breaks_at, jnp.int32))
    )


class Memory:
    """An observer that records its calls."""

    def __init__(self):
        self.calls = []

    def begin(self, title, updates, learners):
        self.calls.append(("begin", title, updates, learners))

    def record(self, update, returns, metrics, *, at):
        self.calls.append(("record", update, returns, metrics))

    def end(self):
        self.calls.append(("end",))
