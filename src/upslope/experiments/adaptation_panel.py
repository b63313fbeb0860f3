"""Adaptation with the advantage head (Figs. 1, 3, 5, left): Algorithm 2, MAML and the controls."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig, UpdateRule
from upslope.adaptation.controls import OneOf
from upslope.adaptation.rules import RULES
from upslope.errors import UpslopeError
from upslope.experiments.keys import Purpose, key_for, keys_per_task
from upslope.experiments.priors import Priors
from upslope.experiments.results import EPISODE_LENGTH, Arm, Panel, Score, differences, make_arm
from upslope.networks.dueling import DuelingQ
from upslope.run.loop import run
from upslope.run.outcome import Outcome
from upslope.run.session import Session
from upslope.tasks.family import AbstractFamily
from upslope.types import Keys, Task

#: α for every stop and task.
StepSizes = Float[np.ndarray, "stops tasks"]


@dataclass(frozen=True)
class AdaptationPanel:
    """Settings of the left panel.

    Attributes:
        stops: iterations at which Algorithm 1 is stopped early; from a finished prior every arm starts at the maximum.
        updates: the number of updates of each adaptation.
        step_sizes: candidates for α; each arm and stop has its own, selected on tuning tasks that are not test tasks.
        start: the panel shows the stop at which the priors' return on tuning tasks is nearest to this.
        average: how that return is averaged over seeds and tuning tasks.
    """

    stops: tuple[int, ...] = (75, 100, 125, 150, 500)
    updates: int = 20
    step_sizes: tuple[float, ...] = (1e-4, 3e-4, 1e-3, 2e-3, 4e-3)
    start: float = 150.0
    average: Literal["median", "mean"] = "median"

    def __post_init__(self) -> None:
        if not self.stops or not self.step_sizes or self.updates < 1:
            raise UpslopeError("The left panel needs at least one stop, one step size and one update.")


def adaptation_panel(
    family: AbstractFamily,
    priors: Priors,
    tasks: Task,
    panel: AdaptationPanel,
    config: AdaptationConfig,
    first_seed: int,
    session: Session | None = None,
    *,
    rules: Mapping[str, UpdateRule] = RULES,
    tuning_family: AbstractFamily | None = None,
    score: Score = EPISODE_LENGTH,
) -> Panel:
    """Runs every rule from every stop on every task, each at the step size that was best on tuning tasks.

    The panel shows the arms of the stop at which the priors are about half as good as they can be on the tuning tasks,
    where adaptation has something to do. The other stops are variants, named by their iteration. Tuning tasks come from
    ``tuning_family`` if it is given.
    """
    starts = jax.tree.map(lambda *leaves: np.stack(leaves), *[priors.stopped_at(stop) for stop in panel.stops])
    count = jax.tree.leaves(tasks)[0].shape[0]
    tuning = Tuning(panel.step_sizes, count)
    tuning_tasks = (family if tuning_family is None else tuning_family).sample_many(
        key_for(first_seed, Purpose.TUNING_TASKS), tuning.learners
    )
    arms_of_stops: dict[str, dict[str, Arm]] = {str(stop): {} for stop in panel.stops}
    candidates = np.broadcast_to(tuning.sizes, (len(panel.stops), tuning.learners))
    outcomes: list[Outcome] = []

    def adapt_all(learners: Adaptation, keys: Keys, title: str, updates: int = panel.updates) -> Outcome:
        outcome = run(learners, keys, updates=updates, every=1, title=title, session=session, allow_divergence=True)
        # The states are dropped: hundreds of networks with their replays are gigabytes.
        outcomes.append(outcome._replace(flat_states=None))
        return outcomes[-1]

    # Only the report before the first update counts here, but a run makes at least one update.
    learners = adaptation_learners(family, starts, one_of(rules, 0), config, tuning_tasks, candidates)
    keys = adaptation_keys(first_seed, Purpose.TUNING, learners)
    before = np.asarray(adapt_all(learners, keys, "before adaptation", updates=1).reports["return"])[..., 0]
    zero_shot = (np.median if panel.average == "median" else np.mean)(before, axis=(1, 2))
    shown_stop = str(panel.stops[int(np.abs(zero_shot - panel.start).argmin())])
    tuning_tasks, tuning_keys = tuning.tasks_of_learners(tuning_tasks), tuning.keys_of_learners(keys)
    for number, name in enumerate(rules):
        rule = one_of(rules, number)
        learners = adaptation_learners(family, starts, rule, config, tuning_tasks, candidates)
        outcome = adapt_all(learners, tuning_keys, f"tuning {name}")
        scores = tuning.by_step_size(np.asarray(outcome.reports["return"]))
        means = scores.mean(axis=(1, 2, 4))
        best = np.asarray(panel.step_sizes)[means.argmax(axis=1)]
        best_of_tasks = np.broadcast_to(best[:, None], (len(panel.stops), count))
        learners = adaptation_learners(family, starts, rule, config, tasks, best_of_tasks)
        test = adapt_all(learners, adaptation_keys(first_seed, Purpose.LEFT, learners), name)
        for index, stop in enumerate(panel.stops):
            of_stop = {measure: values[index] for measure, values in test.reports.items()}
            on_tuning_tasks = {
                f"{size:g}": float(mean) for size, mean in zip(panel.step_sizes, means[index], strict=True)
            }
            notes = {"step_size": float(best[index]), "means_on_tuning_tasks": on_tuning_tasks}
            arms_of_stops[str(stop)][name] = make_arm(test.updates, of_stop, score, notes)
    notes = {
        "stop": int(shown_stop),
        "zero_shot_on_tuning_tasks": dict(zip(arms_of_stops, zero_shot.tolist(), strict=True)),
        "algorithm2_less": {stop: differences(arms, "algorithm2") for stop, arms in arms_of_stops.items()},
    }
    title = f"Adaptation, Algorithm 1 stopped at {shown_stop}"
    compiling = sum(outcome.seconds_compiling for outcome in outcomes)
    running = sum(outcome.seconds_running for outcome in outcomes)
    return Panel(title, arms_of_stops[shown_stop], compiling, running, variants=arms_of_stops, notes=notes)


def one_of(rules: Mapping[str, UpdateRule], number: int) -> OneOf:
    """One of the rules, as an object whose type all rules share, so that they share one program."""
    return OneOf(tuple(rules.values()), jnp.asarray(number))


def adaptation_learners(
    family: AbstractFamily,
    starts: DuelingQ,
    rule: UpdateRule,
    config: AdaptationConfig,
    tasks: Task,
    step_sizes: StepSizes,
) -> Adaptation:
    """One rule from all stops ``[stops, seeds, ...]`` on all tasks ``[tasks, ...]``: ``[stops, seeds, tasks]``."""
    stops, seeds = jax.tree.leaves(starts)[0].shape[:2]
    batch = (stops, seeds, step_sizes.shape[1])
    return Adaptation(
        family,
        jax.tree.map(lambda leaf: np.broadcast_to(leaf, (*batch, *leaf.shape[1:])), tasks),
        jax.tree.map(lambda leaf: np.broadcast_to(leaf[:, :, None], (*batch, *leaf.shape[2:])), starts),
        jnp.asarray(np.broadcast_to(step_sizes[:, None], batch), jnp.float32),
        rule,
        config,
    )


def adaptation_keys(first_seed: int, purpose: Purpose, learners: Adaptation) -> Keys:
    """The keys ``[stops, seeds, tasks]``; all stops share them."""
    stops, seeds, count = learners.step_size.shape
    return jnp.broadcast_to(keys_per_task(first_seed, seeds, count, purpose), (stops, seeds, count))


class Tuning:
    """Which tuning task and step size each tuning run has: every step size runs on the same tasks with the same keys.

    The runs have the same shape as the test runs, so that one program serves both. Surplus runs are not counted.

    Attributes:
        learners: the number of runs: that of test tasks, or of step sizes if there are more of these.
        task: the number of each learner's tuning task ``[learners]``.
        sizes: each learner's step size ``[learners]``.
    """

    def __init__(self, step_sizes: tuple[float, ...], test_tasks: int):
        self._count = len(step_sizes)
        self.learners = max(test_tasks, self._count)
        number = np.arange(self.learners)
        self.task = number // self._count
        self.sizes = np.asarray(step_sizes)[number % self._count]

    def tasks_of_learners(self, tasks: Task) -> Task:
        """Each learner's task ``[learners, ...]``."""
        return jax.tree.map(lambda leaf: np.asarray(leaf)[self.task], tasks)

    def keys_of_learners(self, keys: Keys) -> Keys:
        """Each learner's key ``[stops, seeds, learners]``, from one key for each task."""
        words = np.asarray(jax.random.key_data(keys))[..., self.task, :]
        return jax.random.wrap_key_data(jax.device_put(words))

    def by_step_size(
        self, scores: Float[np.ndarray, "stops seeds learners evaluations"]
    ) -> Float[np.ndarray, "stops seeds tasks sizes evaluations"]:
        """The scores of the runs that count, by task and step size."""
        stops, seeds, _, evaluations = scores.shape
        tasks = self.learners // self._count
        return scores[:, :, : tasks * self._count].reshape(stops, seeds, tasks, self._count, evaluations)
