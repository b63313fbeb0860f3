"""The networks of learners on continuous actions: an actor, and a critic of its actions.

Both are plain PyTrees that act on one observation; map over batches at the call site.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.networks.dueling import MLP, ConvolutionalTorso, Hidden, Scale, Shape, convolutional_torso, torso_for
from upslope.types import Key, Observation, Scalar


class Actor(eqx.Module):
    """A deterministic policy, bounded to [−1, 1] by tanh; its torso suits the observations as `DuelingQ`'s does."""

    torso: MLP | ConvolutionalTorso
    head: eqx.nn.Linear

    def __init__(
        self, key: Key, inputs: int | Shape, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None
    ):
        torso_key, head_key = jax.random.split(key)
        self.torso = torso_for(torso_key, inputs, hidden, scale)
        self.head = eqx.nn.Linear(hidden[-1], actions, key=head_key)

    def pre_activation(self, obs: Observation) -> Float[Array, "actions"]:
        """What goes into the tanh."""
        return self.head(self.torso(obs))

    def __call__(self, obs: Observation) -> Float[Array, "actions"]:
        return jnp.tanh(self.pre_activation(obs))


class Critic(eqx.Module):
    """Q(s, a) of a continuous action, by fully connected layers on both together.

    Attributes:
        seeing: what makes features of images first, as `DuelingQ`'s torso does; None for vectors.
    """

    torso: MLP
    head: eqx.nn.Linear
    seeing: ConvolutionalTorso | None

    def __init__(
        self, key: Key, inputs: int | Shape, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None
    ):
        torso_key, head_key = jax.random.split(key)
        shape = (inputs,) if isinstance(inputs, int) else inputs
        self.seeing = None
        numbers = scale or (1.0,) * shape[0]
        if len(shape) > 1:
            self.seeing = convolutional_torso(jax.random.fold_in(key, 0), shape, hidden, scale)
            numbers = (1.0,) * hidden[-1]
        both = numbers + (1.0,) * actions
        self.torso = MLP(torso_key, len(both), hidden, both)
        self.head = eqx.nn.Linear(hidden[-1], 1, key=head_key)

    def __call__(self, obs: Observation, action: Float[Array, "actions"]) -> Scalar:
        features = obs if self.seeing is None else self.seeing(obs)
        return self.head(self.torso(jnp.concatenate([features, action])))[0]
