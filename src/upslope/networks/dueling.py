"""The dueling Q-network (Eq. 6): its V head is the potential Φ."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.networks.heads import AbstractAdvantageHead, DiscreteHead
from upslope.networks.mlp import numpy_layer
from upslope.networks.numpy_acting import affine
from upslope.networks.scaling import Scaling
from upslope.networks.torso import AbstractTorso, Activation, Hidden, Scale, Shape
from upslope.networks.torsos import fresh_torso
from upslope.types import Action, Key, Observation, Scalar


class AbstractDueling(eqx.Module):
    """V, A and Q of one observation, from the outputs of the two heads. V(s) is max over a of Q(s, a), exactly.

    Attributes:
        advantage_head: computes A from its outputs.
    """

    advantage_head: eqx.AbstractVar[AbstractAdvantageHead]

    @abstractmethod
    def heads(self, obs: Observation) -> tuple[Scalar, Float[Array, "units"]]:
        """V(s) and the outputs of the A head, from one pass through the torso."""

    def value(self, obs: Observation) -> Scalar:
        """V(s)."""
        return self.heads(obs)[0]

    def advantage(self, obs: Observation, action: Action) -> Scalar:
        """A(s, a), raw: Eq. 6 does not pin down its level."""
        return self.advantage_head.advantage(self.heads(obs)[1], action)

    def highest_advantage(self, obs: Observation) -> Scalar:
        """Max over a of A(s, a)."""
        return self.advantage_head.highest(self.heads(obs)[1])

    def q(self, obs: Observation, action: Action) -> Scalar:
        """Q(s, a) by Eq. 6."""
        return self.advantage_head.q(*self.heads(obs), action)

    def best(self, obs: Observation) -> Action:
        """The action of the highest Q(s, ·)."""
        return self.advantage_head.best(*self.heads(obs))

    def best_other(self, obs: Observation, action: Action) -> Scalar:
        """Max over all actions but this one of Q(s, ·)."""
        return self.advantage_head.best_other(*self.heads(obs), action)

    def __call__(self, obs: Observation) -> Float[Array, "actions"]:
        """Q(s, ·) by Eq. 6, where actions can be listed."""
        return self.advantage_head.each_q(*self.heads(obs))

    def random_actions(self, key: Key, count: int) -> Any:
        """Uniformly random actions ``[count, ...]``."""
        return self.advantage_head.random(key, count)


class DuelingQ(AbstractDueling):
    """V head and A head on one torso, which depends on the shape of the observations.

    Attributes:
        scaling: normalises observations, and brings the outputs to units of the raw return; None for neither.
    """

    torso: AbstractTorso
    value_head: eqx.nn.Linear
    advantage_head: AbstractAdvantageHead
    scaling: Scaling | None

    def __init__(
        self,
        key: Key,
        inputs: int | Shape,
        actions: int,
        hidden: Hidden = (32, 32),
        scale: Scale | None = None,
        activation: Activation = "relu",
        head: type[AbstractAdvantageHead] = DiscreteHead,
        scaling: Scaling | None = None,
    ):
        """A network with random weights.

        Args:
            key: random key of the weights.
            inputs: the length of the observations, or the shape of one.
            actions: the number of discrete actions, or of components of a continuous action.
            hidden: widths of the fully connected layers.
            scale: factors by which observations are multiplied.
            activation: of the hidden layers.
            head: the class of the A head.
            scaling: see the class.
        """
        torso_key, value_key, advantage_key = jax.random.split(key, 3)
        self.torso = fresh_torso(torso_key, inputs, hidden, scale, activation)
        self.value_head = eqx.nn.Linear(hidden[-1], 1, key=value_key)
        self.advantage_head = head.fresh(advantage_key, hidden[-1], actions)
        self.scaling = scaling

    def heads(self, obs: Observation) -> tuple[Scalar, Float[Array, "units"]]:
        return self.heads_on(self.features(obs))

    def features(self, obs: Observation) -> Float[Array, "features"]:
        """The features of s."""
        return self.torso(obs if self.scaling is None else self.scaling.normalise(obs))

    def heads_on(self, features: Float[Array, "features"]) -> tuple[Scalar, Float[Array, "units"]]:
        """V(s) and the outputs of the A head, given the features of s."""
        value, outputs = self.value_head(features)[0], self.advantage_head(features)
        if self.scaling is None:
            return value, outputs
        return self.scaling.value(value), self.advantage_head.times(outputs, self.scaling.return_unit)

    def with_scaling(self, scaling: Scaling | None) -> "DuelingQ":
        """The same weights with another scaling."""
        return eqx.tree_at(lambda network: network.scaling, self, scaling, is_leaf=lambda node: node is None)

    def numpy_best(self) -> Callable[[np.ndarray], np.ndarray]:
        """`best` as a NumPy function of a batch ``[n, *obs]``. V is not needed: it does not change the best action."""
        features, weights = self.torso.numpy_features(), affine(numpy_layer(self.advantage_head))
        best, no_value = self.advantage_head.best, np.zeros(1, np.float32)
        if self.scaling is None:
            return lambda obs: best(no_value, np.dot(weights, features(obs)).T)
        mean, deviation = self.scaling.numpy()
        return lambda obs: best(no_value, np.dot(weights, features((obs - mean) / deviation)).T)


class DuelingTable(AbstractDueling):
    """The outputs of the heads in every state of a finite task, computed once. It carries no gradient to the network.

    Attributes:
        states: has ``state_number(obs)``, the index of an observation in the table.
        values: V in every state.
        outputs: the A head's outputs in every state.
    """

    states: Any = eqx.field(static=True)
    values: Float[Array, "states"]
    outputs: Float[Array, "states units"]
    advantage_head: AbstractAdvantageHead

    def heads(self, obs: Observation) -> tuple[Scalar, Float[Array, "units"]]:
        state = self.states.state_number(obs)
        return self.values[state], self.outputs[state]


class ByAdvantage(eqx.Module):
    """A policy network that follows the A head (Algorithm 2): the best action has the highest A(s, ·).

    Eq. 6's Q has its maximum there too, but if V is large, the Q of two actions can round to the same number.
    """

    network: AbstractDueling

    def best(self, obs: Observation) -> Action:
        _, outputs = self.network.heads(obs)
        return self.network.advantage_head.best(jnp.zeros(()), outputs)

    def random_actions(self, key: Key, count: int) -> Any:
        return self.network.random_actions(key, count)

    def numpy_best(self) -> Callable[[np.ndarray], np.ndarray]:
        network: Any = self.network
        return network.numpy_best()
