"""The Q-network of a DQN, without dueling."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from upslope.networks.mlp import numpy_layer
from upslope.networks.numpy_acting import affine
from upslope.networks.torso import AbstractTorso, Hidden, Scale, Shape
from upslope.networks.torsos import fresh_torso
from upslope.types import Key, Observation, Scalar


class QNetwork(eqx.Module):
    """Q(s, ·) of discrete actions. The torso depends on the shape of the observations."""

    torso: AbstractTorso
    head: eqx.nn.Linear

    def __init__(
        self, key: Key, inputs: int | Shape, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None
    ):
        torso_key, head_key = jax.random.split(key)
        self.torso = fresh_torso(torso_key, inputs, hidden, scale)
        self.head = eqx.nn.Linear(hidden[-1], actions, key=head_key)

    def __call__(self, obs: Observation) -> Float[Array, "actions"]:
        """Q(s, ·)."""
        return self.head(self.torso(obs))

    def q(self, obs: Observation, action: Int[Array, ""]) -> Scalar:
        """Q(s, a)."""
        return self(obs)[action]

    def value(self, obs: Observation) -> Scalar:
        """Max over a of Q(s, a)."""
        return jnp.max(self(obs))

    def best(self, obs: Observation) -> Int[Array, ""]:
        """The action of the highest Q(s, ·)."""
        return jnp.argmax(self(obs))

    def random_actions(self, key: Key, count: int) -> Int[Array, "count"]:
        """Uniformly random actions."""
        return jax.random.randint(key, (count,), 0, self.head.weight.shape[-2])

    def numpy_best(self) -> Callable[[np.ndarray], np.ndarray]:
        """`best` as a NumPy function of a batch ``[n, *obs]``."""
        features, weights = self.torso.numpy_features(), affine(numpy_layer(self.head))
        return lambda obs: np.dot(weights, features(obs)).T.argmax(-1)
