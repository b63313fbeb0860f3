"""A pure uniform replay buffer: a ring of transitions as one immutable PyTree."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from upslope.types import Key, Transition


class Replay(eqx.Module):
    """The newest ``capacity`` transitions, with raw rewards.

    Attributes:
        data: transitions ``[capacity, ...]``.
        added: how many transitions were ever added.
    """

    data: Transition
    added: Int[Array, ""]

    @classmethod
    def empty(cls, example: Transition, capacity: int) -> "Replay":
        """An empty buffer for transitions like ``example`` (one, unbatched)."""
        data = jax.tree.map(lambda leaf: jnp.zeros((capacity, *jnp.shape(leaf)), jnp.result_type(leaf)), example)
        return cls(data, jnp.zeros((), jnp.int32))

    @classmethod
    def of(cls, transitions: Transition) -> "Replay":
        """A full buffer that holds exactly ``transitions`` ``[capacity, ...]``."""
        return cls(transitions, jnp.asarray(transitions.reward.shape[0], jnp.int32))

    @property
    def capacity(self) -> int:
        return self.data.reward.shape[0]

    def add(self, transitions: Transition) -> "Replay":
        """Adds ``[n, ...]`` transitions; the oldest make room."""
        count = transitions.reward.shape[0]
        where = (self.added + jnp.arange(count)) % self.capacity
        data = jax.tree.map(lambda ring, new: ring.at[where].set(new), self.data, transitions)
        return Replay(data, self.added + count)

    def sample(self, key: Key, count: int) -> Transition:
        """Draws ``count`` transitions uniformly, with replacement, from those present (at least one must be)."""
        present = jnp.minimum(self.added, self.capacity)
        where = jax.random.randint(key, (count,), 0, jnp.maximum(present, 1))
        return jax.tree.map(lambda ring: ring[where], self.data)
