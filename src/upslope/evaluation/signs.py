"""Signs of a good or a bad prior that need no learner: what its greedy policy and its potential do on fresh tasks."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import spearmanr

from upslope.evaluation.episodes import Episodes, per_task, play, repeated
from upslope.learners.policies import EpsilonGreedy, Greedy
from upslope.networks.dueling import AbstractDueling
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Task

#: Episodes of each policy on each task.
EPISODES = 3

#: Φ is flat if it varies by less than this share of its own size and of the returns.
FLAT = 0.02


@dataclass(frozen=True, eq=False, repr=False)
class Signs:
    """What a prior's policy and potential do on fresh tasks.

    Attributes:
        greedy: return of the greedy policy on each task, a mean over episodes ``[tasks]``.
        random: return of random actions likewise ``[tasks]``.
        start_value: V of the first state ``[tasks]``.
        discounted: the discounted return that the greedy policy gets from there ``[tasks]``; see `Episodes`.
        td_error: root mean square of the TD errors along greedy and random episodes.
        spread: standard deviation of Φ over the same states.
        level: mean of Φ over the states of random episodes, in units of the return.
        largest: the largest size of Φ or of a discounted return.
        drip: (γ − 1)·level: what shaping adds to the reward of each step for the level alone.
        differs: whether anything that happened was better than something else: two rewards differ, or an episode ended.
        rise: rank correlation of Φ with time, a mean over the greedy episodes that are better than random ones and not
            constant; None if there are none. Near 1 where episodes lead to a goal; near 0 where they keep a balance.
    """

    greedy: Float[np.ndarray, "tasks"]
    random: Float[np.ndarray, "tasks"]
    start_value: Float[np.ndarray, "tasks"]
    discounted: Float[np.ndarray, "tasks"]
    td_error: float
    spread: float
    level: float
    largest: float
    drip: float
    differs: bool
    rise: float | None

    @property
    def floor_share(self) -> float:
        """The share of tasks on which the greedy policy is no better than random actions."""
        return float(np.mean(self.greedy <= self.random))

    @property
    def is_flat(self) -> bool:
        """Whether Φ is nearly constant."""
        return self.spread <= FLAT * self.largest

    @property
    def calibration(self) -> float:
        """Mean of V at the start less the discounted return."""
        return float(np.mean(self.start_value - self.discounted))

    def warnings(self) -> list[str]:
        """A sentence for each sign of trouble, with what to try."""
        if not self.differs:
            return [
                "Every step paid the same and no episode terminated, neither at random nor by the prior's policy: "
                "there is nothing to learn. Check the family's reward, or make it denser."
            ]
        share, found = self.floor_share, []
        if share > 0.8:
            found.append(
                f"The greedy policy is no better than random actions on {share:.0%} of fresh tasks (mean return "
                f"{self.greedy.mean():.4g}, random {self.random.mean():.4g}): train for more iterations, explore with "
                "a larger longest_hold or more environments, or give the family a denser reward."
            )
        elif share > 0.2:
            found.append(
                f"Tasks are split: on {share:.0%} of fresh tasks the greedy policy is no better than random actions, "
                "and on the others it is: train for more iterations or with wider layers, and check that observations "
                "show which task it is."
            )
        if self.is_flat:
            found.append(
                f"The potential is flat: it varies by {self.spread:.3g} around {self.level:.4g}, so it shapes like a "
                "constant: train for more iterations, and check that random actions ever see different rewards."
            )
        return found


def signs(family: AbstractFamily, network: AbstractDueling, tasks: Task, key: Key) -> Signs:
    """Measures a network on stacked tasks ``[tasks, ...]``, with `EPISODES` episodes of each policy on each."""
    many = repeated(tasks, EPISODES)
    count = len(jax.tree.leaves(many)[0])
    greedy_key, random_key = jax.random.split(key)
    greedy = play(family, greedy_key, many, Greedy(network), network)
    random = play(family, random_key, many, EpsilonGreedy(network, jnp.ones(count)), network)
    rewards = np.concatenate([episodes.rewards[episodes.counts] for episodes in (greedy, random)])
    values = np.concatenate([episodes.values[episodes.counts] for episodes in (greedy, random)])
    errors = np.concatenate([episodes.td_errors[episodes.counts] for episodes in (greedy, random)])
    level = float(random.values[random.counts].mean())
    returns: Any = np.concatenate([greedy.discounted, random.discounted])
    return Signs(
        greedy=per_task(greedy.returns, EPISODES),
        random=per_task(random.returns, EPISODES),
        start_value=per_task(greedy.start_values, EPISODES),
        discounted=per_task(greedy.discounted, EPISODES),
        td_error=float(np.sqrt(np.mean(errors**2))),
        spread=float(values.std()),
        level=level,
        largest=float(max(np.abs(values).max(), np.abs(returns).max())),
        drip=(family.gamma - 1) * level,
        differs=bool(np.ptp(rewards) > 0 or greedy.terminated.any() or random.terminated.any()),
        rise=_rise(greedy, float(random.returns.mean())),
    )


def _rise(greedy: Episodes, random_return: float) -> float | None:
    """The mean rank correlation of Φ with time along episodes that are better than random ones."""
    good = [
        values[counts]
        for values, counts, reached in zip(greedy.values, greedy.counts, greedy.returns, strict=True)
        if reached > random_return and counts.sum() > 2 and np.ptp(values[counts]) > 0
    ]
    if not good:
        return None
    return float(np.mean([spearmanr(values, np.arange(len(values))).statistic for values in good]))
