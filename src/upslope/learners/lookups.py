"""Networks evaluated in all states of a finite task at once, with results that are then looked up."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from upslope.learners.policies import AbstractPolicy
from upslope.networks.dueling import AbstractDueling, DuelingQ, DuelingTable
from upslope.tasks.family import AbstractFamily
from upslope.types import Action, Key, Task

#: In a batch of all states, one state costs a third of a single evaluation (the paper's network, CPU).
_CHEAPER_TOGETHER = 3


class BestTable(eqx.Module):
    """The best action in every state, as a network for policies.

    Attributes:
        states: has ``state_number(obs)``.
        actions: the best action in every state ``[states, ...]``.
        network: draws random actions.
    """

    states: Any = eqx.field(static=True)
    actions: Any
    network: Any

    def best(self, obs: Float[Array, "*obs"]) -> Action:
        return self.actions[self.states.state_number(obs)]

    def random_actions(self, key: Key, count: int) -> Any:
        return self.network.random_actions(key, count)


def dueling_table(family: AbstractFamily, task: Task, network: DuelingQ) -> AbstractDueling:
    """A table of the network in all states of one task; the network itself if states can't be listed."""
    if not family.lists_states:
        return network
    values, outputs = jax.vmap(network.heads)(family.states.observe_all(task))
    return DuelingTable(states=family.states, values=values, outputs=outputs, advantage_head=network.advantage_head)


def policy_with_table(family: AbstractFamily, task: Task, policy: AbstractPolicy, steps: int) -> AbstractPolicy:
    """The same policy. In a finite task its best actions are computed once for all states if that is cheaper."""
    if not family.lists_states:
        return policy
    observations = family.states.observe_all(task)
    if len(observations) > _CHEAPER_TOGETHER * steps:
        return policy
    best = jax.vmap(policy.network.best)(observations)
    return replace(policy, network=BestTable(family.states, best, policy.network))
