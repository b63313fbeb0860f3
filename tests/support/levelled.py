"""A second advantage head, to show that a new head needs one class and one line.

It gives A(s, a) = b(s) + c_a(s): one output more than there are actions, so code must not confuse outputs with actions.
By Eq. 6 the level b drops out of Q, so Algorithm 1 and MAML must learn the same as with the discrete head.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax
from jaxtyping import Array, Float

from support.probes import ACTIONS, PLACES
from upslope.equations.losses import dueling_q
from upslope.networks.dueling import DuelingQ
from upslope.networks.heads import AbstractAdvantageHead, DiscreteHead


class LevelledHead(AbstractAdvantageHead):
    """The level of a state, then one output for each action."""

    name: ClassVar[str] = "levelled"
    action_kind: ClassVar[str] = "discrete"

    weight: Float[Array, "*batch units features"]
    bias: Float[Array, "*batch units"]

    @classmethod
    def fresh(cls, key, features, actions):
        layer: Any = eqx.nn.Linear(features, actions + 1, key=key)
        return cls(layer.weight, layer.bias)

    def __call__(self, features):
        return self.weight @ features + self.bias

    def times(self, outputs, unit):
        return unit * outputs

    def best_other(self, value, outputs, action):
        q = self.each_q(value, outputs)
        return jax.numpy.where(jax.numpy.arange(q.shape[-1]) == action, -jax.numpy.inf, q).max(-1)

    def advantage(self, outputs, action):
        return outputs[..., 0] + outputs[..., 1 + action]

    def highest(self, outputs):
        return self.each(outputs).max(-1)

    def q(self, value, outputs, action):
        return self.each_q(value, outputs)[..., action]

    def best(self, value, outputs):
        return self.each_q(value, outputs).argmax(-1)

    def each_q(self, value, outputs):
        return dueling_q(value[..., None], self.each(outputs), self.highest(outputs)[..., None])

    def each(self, outputs):
        """A(s, ·)."""
        return outputs[..., :1] + outputs[..., 1:]

    def random(self, key, count):
        return jax.random.randint(key, (count,), 0, self.bias.shape[-1] - 1)


def levelled(seed=0, inputs=PLACES, actions=ACTIONS) -> DuelingQ:
    return DuelingQ(jax.random.key(seed), inputs, actions, (6, 5), (1.0,) * inputs, head=LevelledHead)


def plain(network: DuelingQ) -> DuelingQ:
    """The same Q(s, ·) and A(s, ·) with the discrete head."""
    head = network.advantage_head
    discrete = DiscreteHead(head.weight[:1] + head.weight[1:], head.bias[:1] + head.bias[1:])
    return eqx.tree_at(lambda net: net.advantage_head, network, discrete)
