"""The networks: a dueling Q-network whose V head is the potential, and what vanilla learners use.

All are plain PyTrees that act on one observation; map over batches at the call site.
"""

from collections.abc import Callable
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.losses import dueling_q
from upslope.types import Key, Observation, Scalar

Hidden = tuple[int, ...]
Scale = tuple[float, ...]
Activation = Literal["relu", "tanh"]

ACTIVATIONS: dict[str, Callable] = {"relu": jax.nn.relu, "tanh": jnp.tanh}


class MLP(eqx.Module):
    """Inputs times a fixed scale, then fully connected layers: the shared torso."""

    layers: tuple[eqx.nn.Linear, ...]
    scale: Scale = eqx.field(static=True)
    activation: Activation = eqx.field(static=True)

    def __init__(
        self, key: Key, inputs: int, hidden: Hidden, scale: Scale | None = None, activation: Activation = "relu"
    ):
        widths = (inputs, *hidden)
        keys = jax.random.split(key, len(hidden))
        self.layers = tuple(eqx.nn.Linear(n, m, key=k) for n, m, k in zip(widths[:-1], hidden, keys, strict=True))
        self.scale = scale if scale is not None else (1.0,) * inputs
        self.activation = activation

    def __call__(self, inputs: Float[Array, "inputs"]) -> Float[Array, "features"]:
        features = inputs * jnp.asarray(self.scale, inputs.dtype)
        for layer in self.layers:
            features = ACTIVATIONS[self.activation](layer(features))
        return features


class DuelingQ(eqx.Module):
    """V head and A head on one torso (Eq. 6). Its V head is the potential Φ."""

    torso: MLP
    value_head: eqx.nn.Linear
    advantage_head: eqx.nn.Linear

    def __init__(
        self,
        key: Key,
        inputs: int,
        actions: int,
        hidden: Hidden = (32, 32),
        scale: Scale | None = None,
        activation: Activation = "relu",
    ):
        torso_key, value_key, advantage_key = jax.random.split(key, 3)
        self.torso = MLP(torso_key, inputs, hidden, scale, activation)
        self.value_head = eqx.nn.Linear(hidden[-1], 1, key=value_key)
        self.advantage_head = eqx.nn.Linear(hidden[-1], actions, key=advantage_key)

    def heads(self, obs: Observation) -> tuple[Scalar, Float[Array, "actions"]]:
        """V(s) and the raw A(s, ·), from one pass through the torso."""
        features = self.torso(obs)
        return self.value_head(features)[0], self.advantage_head(features)

    def value(self, obs: Observation) -> Scalar:
        """V(s)."""
        return self.heads(obs)[0]

    def advantage(self, obs: Observation) -> Float[Array, "actions"]:
        """A(s, ·), raw: its level is not pinned down by Eq. 6."""
        return self.heads(obs)[1]

    def __call__(self, obs: Observation) -> Float[Array, "actions"]:
        """Q(s, ·) by Eq. 6."""
        return dueling_q(*self.heads(obs))


class QNetwork(eqx.Module):
    """The vanilla Q-network of a DQN: no dueling."""

    torso: MLP
    head: eqx.nn.Linear

    def __init__(self, key: Key, inputs: int, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None):
        torso_key, head_key = jax.random.split(key)
        self.torso = MLP(torso_key, inputs, hidden, scale)
        self.head = eqx.nn.Linear(hidden[-1], actions, key=head_key)

    def __call__(self, obs: Observation) -> Float[Array, "actions"]:
        return self.head(self.torso(obs))


class Actor(eqx.Module):
    """A deterministic policy, bounded to [−1, 1] by tanh."""

    torso: MLP
    head: eqx.nn.Linear

    def __init__(self, key: Key, inputs: int, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None):
        torso_key, head_key = jax.random.split(key)
        self.torso = MLP(torso_key, inputs, hidden, scale)
        self.head = eqx.nn.Linear(hidden[-1], actions, key=head_key)

    def pre_activation(self, obs: Observation) -> Float[Array, "actions"]:
        """What goes into the tanh."""
        return self.head(self.torso(obs))

    def __call__(self, obs: Observation) -> Float[Array, "actions"]:
        return jnp.tanh(self.pre_activation(obs))


class Critic(eqx.Module):
    """Q(s, a) of a continuous action, by a network of two hidden layers on both together."""

    torso: MLP
    head: eqx.nn.Linear

    def __init__(self, key: Key, inputs: int, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None):
        torso_key, head_key = jax.random.split(key)
        both = (scale or (1.0,) * inputs) + (1.0,) * actions
        self.torso = MLP(torso_key, inputs + actions, hidden, both)
        self.head = eqx.nn.Linear(hidden[-1], 1, key=head_key)

    def __call__(self, obs: Observation, action: Float[Array, "actions"]) -> Scalar:
        return self.head(self.torso(jnp.concatenate([obs, action])))[0]
