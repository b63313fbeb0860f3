"""Algorithm 1's settings: what every posterior uses."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from upslope.errors import UpslopeError
from upslope.learners.checks import check_counts, check_shares
from upslope.learners.policies import AbstractPolicy, EpsilonGreedy, HeldActions
from upslope.meta_training.posteriors import (
    HeadsPosterior,
    NetworkPosterior,
    TablePosterior,
    TrajectoryPosterior,
    WeightsPosterior,
)
from upslope.meta_training.posteriors.posterior import Explorer
from upslope.networks.convolution import Precision
from upslope.networks.torso import Activation

Posterior = NetworkPosterior | TrajectoryPosterior | TablePosterior | HeadsPosterior | WeightsPosterior


@dataclass(frozen=True)
class MetaTrainingConfig:
    """Settings of Algorithm 1. Each difference from the paper is an option here, described in docs/deviations.md.

    Attributes:
        iterations: number of meta-iterations.
        tasks: number of tasks sampled in each iteration.
        steps_per_task: environment steps in each iteration, for each task (or each of its environments).
        hidden: widths of the hidden layers.
        activation: activation of the hidden layers; the paper names none.
        head: name of the advantage head; None takes the one for the family's kind of action.
        posterior: what of the prior is adapted to each task, and how.
        outer_step_size: β, the step size of θ, at the start.
        outer_step_size_end: β at the end; it falls linearly.
        outer_warmup: number of outer steps over which β rises linearly from 0 to its start.
        outer_optimiser: Adam, or plain gradient descent as in the paper.
        outer_updates: outer steps per iteration, each on a fresh draw from the same replays.
        epsilon: share of random actions in the first and in the last task (or environment); the rest are spaced evenly.
        longest_hold: random actions are held for up to so many steps (`HeldActions`); 1 draws a new one in each step.
        random_iterations: in so many iterations at the start all actions are random.
        kept_iterations: outer steps draw from the replays of so many iterations, the latest; 1 is the paper's.
        normalise: bring observations and returns to the order of one, by what the random iterations show.
        averaging: decay per iteration of the moving average of θ that is the prior; 0 takes θ itself, as in the paper.
        select_from: the prior is the snapshot with the best greedy return on extra training tasks, among those after
            this share of the training; 1 takes the last one, as in the paper.
        snapshot_every: iterations between snapshots.
        evaluation_tasks: number of extra training tasks, never test tasks, on which snapshots are compared.
        evaluation_episodes: greedy episodes on each of them.
        precision: precision of the factors in convolutions; below float32 GPUs are faster, and CPUs only round.
    """

    iterations: int = 500
    tasks: int = 10
    steps_per_task: int = 200
    hidden: tuple[int, ...] = (32, 32)
    activation: Activation = "tanh"
    head: str | None = None
    posterior: Posterior = field(default_factory=NetworkPosterior)
    outer_step_size: float = 0.005
    outer_step_size_end: float = 0.0005
    outer_warmup: int = 0
    outer_optimiser: Literal["adam", "sgd"] = "adam"
    outer_updates: int = 4
    epsilon: tuple[float, float] = (0.05, 0.95)
    longest_hold: int = 1
    random_iterations: int = 0
    kept_iterations: int = 1
    normalise: bool = False
    averaging: float = 0.97
    select_from: float = 0.2
    snapshot_every: int = 10
    evaluation_tasks: int = 20
    evaluation_episodes: int = 3
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        check_counts(self, "iterations", "tasks", "steps_per_task", "outer_updates", "snapshot_every")
        check_counts(self, "evaluation_tasks", "evaluation_episodes", "longest_hold", "kept_iterations")
        if self.normalise and self.random_iterations < 1:
            raise UpslopeError("normalise measures random steps, and random_iterations is 0: give 1 or more.")
        check_shares(averaging=self.averaging, select_from=self.select_from)
        for share in self.epsilon:
            check_shares(epsilon=share)

    def with_posterior(self, **changes: Any) -> "MetaTrainingConfig":
        """The same settings, some of the posterior's changed."""
        return replace(self, posterior=replace(self.posterior, **changes))

    def explorer(self, iteration: Int[Array, ""]) -> Explorer:
        """How to explore in an iteration, counted from 0."""

        def policy(network: Any, epsilon: Float[Array, "n"]) -> AbstractPolicy:
            if self.random_iterations:
                epsilon = jnp.where(iteration < self.random_iterations, 1.0, epsilon)
            if self.longest_hold == 1:
                return EpsilonGreedy(network, epsilon)
            return HeldActions(network, epsilon, self.longest_hold)

        return policy

    def optimiser(self) -> optax.GradientTransformation:
        """The outer optimiser, β rising and falling as the settings say."""
        updates = self.iterations * self.outer_updates - self.outer_warmup
        schedule = optax.linear_schedule(self.outer_step_size, self.outer_step_size_end, max(updates, 1))
        if self.outer_warmup:
            rise = optax.linear_schedule(0.0, self.outer_step_size, self.outer_warmup)
            schedule = optax.join_schedules([rise, schedule], [self.outer_warmup])
        return {"adam": optax.adam, "sgd": optax.sgd}[self.outer_optimiser](schedule)

    def best_snapshot(self, returns: Float[np.ndarray, "snapshots"]) -> int:
        """Which snapshot becomes the prior: of those after ``select_from``, the best on extra training tasks.

        Args:
            returns: each snapshot's greedy return, evenly spaced over the training, the first of them before any.

        Returns:
            Its index; among equals the last.
        """
        first = min(int(np.ceil(self.select_from * (len(returns) - 1))), len(returns) - 1)
        candidates = np.asarray(returns)[first:]
        return len(returns) - 1 - int(candidates[::-1].argmax())
