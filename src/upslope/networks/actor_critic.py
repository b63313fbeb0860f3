"""The networks of learners with continuous actions: an actor and a critic.

Both are plain PyTrees that act on one observation; map over batches at the call site.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.networks.mlp import MLP, numpy_layer
from upslope.networks.numpy_acting import affine
from upslope.networks.torso import AbstractTorso, Hidden, Scale, Shape
from upslope.networks.torsos import fresh_torso
from upslope.types import Key, Observation, Scalar


class Actor(eqx.Module):
    """A deterministic policy, bounded to [−1, 1] by tanh. The torso depends on the shape of the observations."""

    torso: AbstractTorso
    head: eqx.nn.Linear

    def __init__(
        self, key: Key, inputs: int | Shape, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None
    ):
        torso_key, head_key = jax.random.split(key)
        self.torso = fresh_torso(torso_key, inputs, hidden, scale)
        self.head = eqx.nn.Linear(hidden[-1], actions, key=head_key)

    @property
    def actions(self) -> int:
        """The number of components of an action."""
        return self.head.weight.shape[-2]

    def pre_activation(self, obs: Observation) -> Float[Array, "actions"]:
        """The input of the tanh."""
        return self.head(self.torso(obs))

    def best(self, obs: Observation) -> Float[Array, "actions"]:
        """The action."""
        return jnp.tanh(self.pre_activation(obs))

    def numpy_best(self) -> Callable[[np.ndarray], np.ndarray]:
        """`best` as a NumPy function of a batch ``[n, *obs]``."""
        features, weights = self.torso.numpy_features(), affine(numpy_layer(self.head))
        return lambda obs: np.tanh(np.dot(weights, features(obs)).T)


class Critic(eqx.Module):
    """Q(s, a) of a continuous action: fully connected layers on state and action together.

    Attributes:
        seeing: the torso that computes features of images first; None for vectors.
    """

    torso: MLP
    head: eqx.nn.Linear
    seeing: AbstractTorso | None

    def __init__(
        self, key: Key, inputs: int | Shape, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None
    ):
        torso_key, head_key = jax.random.split(key)
        shape = (inputs,) if isinstance(inputs, int) else inputs
        self.seeing = None
        numbers = scale or (1.0,) * shape[0]
        if len(shape) > 1:
            self.seeing = fresh_torso(jax.random.fold_in(key, 0), shape, hidden, scale)
            numbers = (1.0,) * hidden[-1]
        both = numbers + (1.0,) * actions
        self.torso = MLP(torso_key, len(both), hidden, both)
        self.head = eqx.nn.Linear(hidden[-1], 1, key=head_key)

    def __call__(self, obs: Observation, action: Float[Array, "actions"]) -> Scalar:
        features = obs if self.seeing is None else self.seeing(obs)
        return self.head(self.torso(jnp.concatenate([features, action])))[0]
