"""A uniform replay buffer: a ring of records as one immutable PyTree."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from upslope.errors import UpslopeError
from upslope.types import Key


class Replay(eqx.Module):
    """The newest ``capacity`` records: transitions with raw rewards, and other data that a learner stores.

    Attributes:
        data: a PyTree of arrays ``[capacity, ...]``.
        added: the total number of records added so far.
    """

    data: Any
    added: Int[Array, ""]

    @classmethod
    def empty(cls, example: Any, capacity: int) -> "Replay":
        """An empty buffer for records like ``example`` (one, unbatched)."""
        data = jax.tree.map(lambda leaf: jnp.zeros((capacity, *jnp.shape(leaf)), jnp.result_type(leaf)), example)
        return cls(data, jnp.zeros((), jnp.int32))

    @classmethod
    def of(cls, records: Any) -> "Replay":
        """A full buffer that holds exactly ``records`` ``[capacity, ...]``."""
        return cls(records, jnp.asarray(_length(records), jnp.int32))

    @property
    def capacity(self) -> int:
        return _length(self.data)

    def add(self, records: Any) -> "Replay":
        """Adds ``[n, ...]`` records, which replace the oldest ones.

        Raises:
            UpslopeError: more records than the capacity.
        """
        count = _length(records)
        if count > self.capacity:
            raise UpslopeError(
                f"{count} records at once do not fit into a replay of {self.capacity}: "
                "raise replay_capacity, or take fewer steps between updates."
            )
        where = (self.added + jnp.arange(count)) % self.capacity
        data = jax.tree.map(lambda ring, new: ring.at[where].set(new), self.data, records)
        return Replay(data, self.added + count)

    def sample(self, key: Key, count: int) -> Any:
        """Draws ``count`` records uniformly, with replacement, from those present; there must be at least one."""
        present = jnp.minimum(self.added, self.capacity)
        where = jax.random.randint(key, (count,), 0, jnp.maximum(present, 1))
        return jax.tree.map(lambda ring: ring[where], self.data)


def _length(records: Any) -> int:
    return jax.tree.leaves(records)[0].shape[0]
