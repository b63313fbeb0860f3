"""Reports of a learner of one task: the raw return of its greedy policy."""

from typing import Any

import jax

from upslope.learners.experience import greedy_return
from upslope.learners.policies import Greedy
from upslope.planning.exact import tabulate
from upslope.planning.measures import episode_values
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Scalar, Task


def greedy_report(key: Key, family: AbstractFamily, task: Task, policy: Greedy, episodes: int) -> dict[str, Scalar]:
    """The ``return`` of the greedy policy on one task, raw and undiscounted.

    In finite tasks it is computed exactly from the policy in every state, and ``discounted_return`` is reported too.
    In other tasks it is the mean over ``episodes`` fresh episodes.
    """
    if family.lists_states:
        return exact_report(family, task, policy)
    return {"return": greedy_return(key, family, task, policy, episodes)}


def exact_report(family: Any, task: Task, policy: Greedy) -> dict[str, Scalar]:
    """The expected returns of one episode of a finite task, from its start. Nothing is sampled."""
    mdp = tabulate(family.env, task, family.gamma)
    best = jax.vmap(policy.network.best)(family.states.observe_all(task))
    greedy = jax.nn.one_hot(best, family.actions.count)
    raw, discounted = episode_values(mdp, greedy, family.max_steps)
    return {"return": raw[task.start], "discounted_return": discounted[task.start]}
