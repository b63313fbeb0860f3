"""Algorithm 1's settings: the recipe that works, which is the default, and the paper to the letter."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from upslope.errors import UpslopeError
from upslope.networks.convolution import Precision
from upslope.networks.dueling import Activation
from upslope.tasks.family import AbstractFamily


@dataclass(frozen=True)
class MetaTrainingConfig:
    """Settings of Algorithm 1. Each difference from the print is an option here, told in docs/deviations.md.

    Attributes:
        iterations: meta-iterations.
        tasks: tasks sampled in each iteration.
        steps_per_task: environment steps in each task's fresh replay.
        batch_size: samples per task behind each φ_i; the outer loss uses the same ones.
        hidden: widths of the hidden layers.
        activation: of the hidden layers; the paper names none.
        posterior: what of θ each task adapts: the whole "network", to a batch of its replay; or, where tasks are
            finite, to all of the replay, each pair of state and action counting once: a
            "table" of Q_θ in every state, the two "heads", or all "weights". Of these three batch_size, first_order,
            td_gradient and a kept outer_target are no part, nor is target_decay of the last two.
        inner_step_size: α. Of a table, the share of each TD error that one step removes.
        normalised_steps: inner steps are Polyak's, α of a single squared error; not of a table,
            whose steps are so by themselves.
        inner_steps: N.
        outer_step_size: β at the start.
        outer_step_size_end: β at the end; it falls linearly.
        outer_warmup: outer steps over which β rises to its start, linearly.
        outer_optimiser: plain gradient descent, as printed, or Adam.
        outer_updates: outer steps per iteration, each on a fresh draw from the same replays.
        outer_target: whether gradients flow through Q_φ as the target of Eq. 7: "kept" (the literal reading, which
            collapses) or "stopped".
        first_order: with a kept target, whether second derivatives through φ(θ) are left out.
        rematerialise: with a kept target, compute each inner step again when differentiating instead of keeping what it
            made: the same numbers in less memory and more time.
        task_by_task: take the tasks' gradients one after the other instead of side by side: the same numbers in less
            memory, and many times faster on CPU where networks are convolutional.
        td_gradient: "semi" (TD targets are constants) or "full" (Eq. 5 differentiated on both sides).
        target_decay: decay per iteration of the averaged network in the inner TD target; None for no such network.
        epsilon: random-action share of the first and of the last task of a batch; those between are spaced evenly.
            Where all of the replay is used: of the first and last environment of each task.
        environments: of each task, side by side; only where all of the replay is used.
        reward_weight: how often rewarded pairs of state and action count in the outer loss; likewise.
        advantage_weight: weight, in the outer loss, of how the errors differ between the actions of a state; likewise.
        averaging: decay per iteration of the moving average of θ that is the prior; 0 takes θ itself, as printed.
        select_from: the prior is the best snapshot after this share of training, by its greedy return on extra
            training tasks; 1 takes the last, as printed.
        snapshot_every: iterations between snapshots.
        evaluation_tasks: extra training tasks, never test tasks, on which snapshots are tried.
        evaluation_episodes: greedy episodes on each of them.
        precision: of what convolutions multiply; GPUs are faster with less than float32, CPUs only round.
    """

    iterations: int = 500
    tasks: int = 10
    steps_per_task: int = 200
    batch_size: int = 64
    hidden: tuple[int, ...] = (32, 32)
    activation: Activation = "tanh"
    posterior: Literal["network", "table", "heads", "weights"] = "network"
    inner_step_size: float = 0.01
    inner_steps: int = 1
    normalised_steps: bool = False
    outer_step_size: float = 0.005
    outer_step_size_end: float = 0.0005
    outer_warmup: int = 0
    outer_optimiser: Literal["adam", "sgd"] = "adam"
    outer_updates: int = 4
    outer_target: Literal["stopped", "kept"] = "stopped"
    first_order: bool = False
    rematerialise: bool = False
    task_by_task: bool = False
    td_gradient: Literal["semi", "full"] = "semi"
    target_decay: float | None = 0.9
    epsilon: tuple[float, float] = (0.05, 0.95)
    environments: int = 1
    reward_weight: float = 1.0
    advantage_weight: float = 0.0
    averaging: float = 0.97
    select_from: float = 0.2
    snapshot_every: int = 10
    evaluation_tasks: int = 20
    evaluation_episodes: int = 3
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        for name in _COUNTS:
            if getattr(self, name) < 1:
                raise UpslopeError(f"{name} is {getattr(self, name)}, but it counts something: give at least 1.")
        if self.posterior != "network" and self.outer_target == "kept":
            raise UpslopeError(f'A posterior of {self.posterior} is a constant in Eq. 7: set outer_target="stopped".')
        if self.posterior in ("heads", "weights") and self.target_decay is not None:
            raise UpslopeError(f"A posterior of {self.posterior} has no target network: set target_decay=None.")
        if self.posterior == "table" and self.normalised_steps:
            raise UpslopeError("Steps of a table are normalised by themselves: leave normalised_steps out.")
        shares = {
            "averaging": self.averaging,
            "select_from": self.select_from,
            "target_decay": self.target_decay or 0.0,
        }
        for name, share in (*shares.items(), *(("epsilon", share) for share in self.epsilon)):
            if not 0 <= share <= 1:
                raise UpslopeError(f"{name} is {share}, but it is a share: give a number from 0 to 1.")

    @property
    def inner(self) -> dict[str, Any]:
        """The inner steps, as `upslope.equations.maml.adapt` takes them."""
        return {
            "step_size": self.inner_step_size,
            "steps": self.inner_steps,
            "normalised": self.normalised_steps,
        }

    def best_snapshot(self, returns: Float[np.ndarray, "snapshots"]) -> int:
        """Which snapshot becomes the prior: of those after ``select_from``, the best on extra training tasks.

        Args:
            returns: each snapshot's greedy return, evenly spaced over the training, the first of them before any.

        Returns:
            Its index; of equals the last.
        """
        first = min(int(np.ceil(self.select_from * (len(returns) - 1))), len(returns) - 1)
        candidates = np.asarray(returns)[first:]
        return len(returns) - 1 - int(candidates[::-1].argmax())


_COUNTS = (
    "iterations",
    "tasks",
    "steps_per_task",
    "batch_size",
    "inner_steps",
    "outer_updates",
    "environments",
    "snapshot_every",
    "evaluation_tasks",
    "evaluation_episodes",
)


def as_printed() -> MetaTrainingConfig:
    """Algorithm 1 to the letter; it collapses (docs/deviations.md).

    N = 1, one plain gradient step per iteration on the inner step's own samples, the graph kept on both sides of Eq. 7,
    no target network, one ε for all tasks, the last θ as the prior. β is the best of three that were tried.
    """
    return MetaTrainingConfig(
        activation="relu",
        outer_step_size=0.1,
        outer_step_size_end=0.1,
        outer_optimiser="sgd",
        outer_updates=1,
        outer_target="kept",
        td_gradient="full",
        target_decay=None,
        epsilon=(0.1, 0.1),
        averaging=0.0,
        select_from=1.0,
    )


#: Of meta-training on the paper's maps. Every clean training map is solved after a thousand.
ITERATIONS = {"obstacles": 8000, "clean": 3000}


def suited_to(family: AbstractFamily) -> MetaTrainingConfig:
    """The recipe for a family: that of grid games where tasks are finite and observations maps, else CartPole's."""
    return for_grid_games() if family.recipe == "maps" else MetaTrainingConfig()


def for_grid_games(iterations: int = ITERATIONS["obstacles"]) -> MetaTrainingConfig:
    """Algorithm 1 on grid games: φ_i a table, adapted by many steps on sixteen environments of each of two maps.

    What the choices are worth is told in docs/deviations.md, where it was measured.
    """
    return MetaTrainingConfig(
        iterations=iterations,
        tasks=2,
        steps_per_task=50,
        hidden=(128, 128),
        activation="relu",
        posterior="table",
        inner_step_size=1.0,
        inner_steps=30,
        outer_step_size=0.002,
        outer_step_size_end=0.00002,
        outer_warmup=50,
        outer_updates=1,
        target_decay=None,
        epsilon=(0.3, 1.0),
        environments=16,
        reward_weight=5.0,
        advantage_weight=30.0,
        averaging=0.998,
        select_from=1.0,
        snapshot_every=max(1, iterations // 16),
        evaluation_tasks=40,
        evaluation_episodes=1,
    )


def multi_task_dqn(iterations: int = ITERATIONS["obstacles"]) -> MetaTrainingConfig:
    """The control of `for_grid_games`: DQN over all maps, with a target network.

    One inner step of size one makes the posterior a Bellman backup of the target network, and Eq. 7 the loss of DQN.
    Network, experience, outer optimiser and ``reward_weight`` are those of the recipe, and were not tuned for it; each
    pair of state and action counts once, as there. Asking the target network makes its iterations 1.1 to 1.2 times as
    long.
    """
    return replace(for_grid_games(iterations), inner_steps=1, target_decay=0.99, advantage_weight=0.0)
