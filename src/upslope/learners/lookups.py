"""What a network says of every state of a finite task: computed for all of them at once, and looked up after that."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from upslope.learners.policies import AbstractPolicy
from upslope.networks.dueling import DuelingQ
from upslope.types import Policy, Scalar, Task

#: A state's scores among those of all states cost a third of what they cost alone (the paper's network, CPU).
_CHEAPER_TOGETHER = 3


class Lookup(eqx.Module):
    """Scores of the actions.

    Attributes:
        env: with ``state_number(obs)``.
        scores: in every state.
    """

    env: Any = eqx.field(static=True)
    scores: Float[Array, "states actions"]

    def __call__(self, obs: Float[Array, "*obs"]) -> Float[Array, "actions"]:
        return self.scores[self.env.state_number(obs)]


class DuelingLookup(eqx.Module):
    """Both heads of a `DuelingQ`, for all that only asks it.

    Attributes:
        env: with ``state_number(obs)``.
        values: V in every state.
        advantages: the raw A in every state.
    """

    env: Any = eqx.field(static=True)
    values: Float[Array, "states"]
    advantages: Float[Array, "states actions"]

    def heads(self, obs: Float[Array, "*obs"]) -> tuple[Scalar, Float[Array, "actions"]]:
        """V(s) and the raw A(s, ·)."""
        state = self.env.state_number(obs)
        return self.values[state], self.advantages[state]

    def value(self, obs: Float[Array, "*obs"]) -> Scalar:
        """V(s)."""
        return self.heads(obs)[0]

    def advantage(self, obs: Float[Array, "*obs"]) -> Float[Array, "actions"]:
        """A(s, ·), raw."""
        return self.heads(obs)[1]


#: A network, or what it says everywhere: V and A without gradients.
Asked = DuelingQ | DuelingLookup


def looked_up(family: Any, task: Task, network: DuelingQ) -> DuelingLookup | None:
    """The network in every state of one task; None where states can't be listed."""
    if not family.lists_states:
        return None
    return DuelingLookup(family.env, *jax.vmap(network.heads)(family.env.observe_all(task)))


def looking_up(family: Any, task: Task, policy: Policy, steps: int) -> Policy:
    """The same policy; in a finite task its scores are computed once for all states, where that is cheaper."""
    if not (isinstance(policy, AbstractPolicy) and family.lists_states):
        return policy
    observations = family.env.observe_all(task)
    if len(observations) > _CHEAPER_TOGETHER * steps:
        return policy
    return replace(policy, network=Lookup(family.env, jax.vmap(policy.network)(observations)))
