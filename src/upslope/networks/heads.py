"""Advantage heads: how A(s, ·) depends on the action, with its maximum in closed form (Eq. 6 needs it exactly)."""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from upslope.equations.losses import dueling_q
from upslope.errors import UpslopeError
from upslope.types import Action, Key


class AbstractAdvantageHead(eqx.Module):
    """One affine map from features to outputs, and methods that compute A from the outputs.

    These methods work on JAX and NumPy arrays, for the outputs of one state ``[units]`` or of many ``[..., units]``.

    Attributes:
        name: the name of the head in files and settings.
        action_kind: "discrete" or "continuous".
        weight: of the affine map.
        bias: of the affine map.
    """

    name: eqx.AbstractClassVar[str]
    action_kind: eqx.AbstractClassVar[str]

    weight: eqx.AbstractVar[Float[Array, "*batch units features"]]
    bias: eqx.AbstractVar[Float[Array, "*batch units"]]

    @classmethod
    @abstractmethod
    def fresh(cls, key: Key, features: int, actions: int) -> "AbstractAdvantageHead":
        """A head with random weights.

        Args:
            key: random key of the weights.
            features: the number of features.
            actions: the number of discrete actions, or of components of a continuous action.
        """

    @abstractmethod
    def __call__(self, features: Float[Array, "features"]) -> Float[Array, "units"]:
        """The outputs for one state's features."""

    @abstractmethod
    def times(self, outputs: Any, unit: Any) -> Any:
        """The outputs for which A(s, a) is ``unit`` times as large, for each a."""

    @abstractmethod
    def advantage(self, outputs: Any, action: Action) -> Any:
        """A(s, a), raw: Eq. 6 does not pin down its level."""

    @abstractmethod
    def highest(self, outputs: Any) -> Any:
        """Max over a of A(s, a), exactly."""

    @abstractmethod
    def q(self, value: Any, outputs: Any, action: Action) -> Any:
        """Q(s, a) by Eq. 6, given V(s)."""

    @abstractmethod
    def best(self, value: Any, outputs: Any) -> Any:
        """The action of the highest Q(s, ·), given V(s)."""

    @abstractmethod
    def best_other(self, value: Any, outputs: Any, action: Action) -> Any:
        """Max over all actions but this one of Q(s, ·), given V(s); V(s) itself where actions can't be listed."""

    @abstractmethod
    def each_q(self, value: Any, outputs: Any) -> Any:
        """Q(s, a) of every action ``[..., actions]``, where actions can be listed.

        Raises:
            UpslopeError: they can't.
        """

    @abstractmethod
    def random(self, key: Key, count: int) -> Any:
        """Uniformly random actions ``[count, ...]``."""


class DiscreteHead(AbstractAdvantageHead):
    """One output for each action: A(s, a) itself."""

    name: ClassVar[str] = "discrete"
    action_kind: ClassVar[str] = "discrete"

    weight: Float[Array, "*batch actions features"]
    bias: Float[Array, "*batch actions"]

    @classmethod
    def fresh(cls, key: Key, features: int, actions: int) -> "DiscreteHead":
        layer: Any = eqx.nn.Linear(features, actions, key=key)
        return cls(layer.weight, layer.bias)

    def __call__(self, features: Float[Array, "features"]) -> Float[Array, "actions"]:
        return self.weight @ features + self.bias

    def times(self, outputs: Any, unit: Any) -> Any:
        return unit * outputs

    def advantage(self, outputs: Any, action: Int[Array, ""] | int) -> Any:
        return outputs[..., action]

    def highest(self, outputs: Any) -> Any:
        return outputs.max(-1)

    def q(self, value: Any, outputs: Any, action: Int[Array, ""] | int) -> Any:
        return self.each_q(value, outputs)[..., action]

    def best(self, value: Any, outputs: Any) -> Any:
        return self.each_q(value, outputs).argmax(-1)

    def best_other(self, value: Any, outputs: Any, action: Int[Array, ""] | int) -> Any:
        q = self.each_q(value, outputs)
        return jnp.where(jnp.arange(q.shape[-1]) == action, -jnp.inf, q).max(-1)

    def each_q(self, value: Any, outputs: Any) -> Any:
        return dueling_q(value[..., None], outputs, outputs.max(-1, keepdims=True))

    def random(self, key: Key, count: int) -> Int[Array, "count"]:
        return jax.random.randint(key, (count,), 0, self.bias.shape[-1])


#: Heads by name. A new head is one class in a new file, and one line here.
HEADS: dict[str, type[AbstractAdvantageHead]] = {head.name: head for head in (DiscreteHead,)}


def head_class(name: str | None, action_kind: str) -> type[AbstractAdvantageHead]:
    """The head with this name; None for the first head for this kind of action.

    Raises:
        UpslopeError: there is no such head, or it is for another kind of action.
    """
    fitting = {known: head for known, head in HEADS.items() if head.action_kind == action_kind}
    if name is None and fitting:
        return next(iter(fitting.values()))
    if name in fitting:
        return fitting[name]
    raise UpslopeError(
        f"There is no advantage head {'' if name is None else f'{name!r} '}for {action_kind} actions "
        f"(there is {', '.join(f'{head.name} for {head.action_kind} ones' for head in HEADS.values())}): meta-train on "
        "a family with discrete actions and the same observations; its V shapes the rewards of any learner."
    )
