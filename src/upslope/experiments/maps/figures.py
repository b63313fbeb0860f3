"""Figures 3 and 5, on unseen maps. Left: adaptation with the advantage head; right: shaped DQN."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import jax
import numpy as np

from upslope.adaptation import algorithm2 as adaptation
from upslope.adaptation.algorithm2 import AdaptationConfig
from upslope.errors import UpslopeError
from upslope.experiments.adaptation_panel import AdaptationPanel, adaptation_panel
from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.maps.arms import grid_arms, mean_levels_on_maps
from upslope.experiments.maps.priors import families
from upslope.experiments.maps.readings import Maps, quick_reading, training_title
from upslope.experiments.priors import Priors, describe_priors, meta_train_priors
from upslope.experiments.results import SUCCESS, Arm, FigureResult, Panel, differences
from upslope.experiments.shaping_panel import shaping_panel
from upslope.experiments.statistics import paired_shortfall
from upslope.learners import dqn
from upslope.learners.dqn import DQNConfig
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import ITERATIONS, for_grid_games, multi_task_dqn
from upslope.planning.measures import measure_all, truths
from upslope.run.compiling import compile_clock
from upslope.run.session import Session
from upslope.tasks import JaxTasks
from upslope.types import Task

GridPanelName = Literal["left", "right"]
GRID_PANELS: tuple[GridPanelName, ...] = ("left", "right")

#: Iterations at which the left panel stops Algorithm 1: two at which success on training maps shows that there is
#: something left to learn, and on maps with obstacles also the end. At the end the priors solve every clean map.
STOPS: dict[Maps, tuple[int, ...]] = {"obstacles": (2000, 4000, 8000), "clean": (561, 748)}


@dataclass(frozen=True)
class GridFigureConfig:
    """The protocol of Figures 3 and 5; `full_grid_figure` makes the full form.

    Attributes:
        maps: "clean" for Figure 3 (10 × 10, no test goal is ever a training goal), "obstacles" for Figure 5 (8 × 8).
        meta_training: settings of Algorithm 1.
        multi_task: settings of the control, plain DQN over all training maps; its iterations take a little longer.
        panel: stops and step sizes of the left panel.
        seeds: the number of priors, and of runs per map.
        tasks: the number of unseen maps.
        first_seed: seeds are first_seed, first_seed + 1, …; it also determines the test maps.
        dqn_updates: updates in the right panel.
        every: updates between evaluations in the right panel.
        adaptation: sizes of batches and replay in the left panel.
        dqn: the learner of the right panel.
    """

    maps: Maps
    meta_training: MetaTrainingConfig
    multi_task: MetaTrainingConfig
    panel: AdaptationPanel
    seeds: int = 5
    tasks: int = 40
    first_seed: int = 0
    dqn_updates: int = 300
    every: int = 25
    adaptation: AdaptationConfig = field(default_factory=adaptation.for_maps)
    dqn: DQNConfig = field(default_factory=dqn.for_maps)

    def __post_init__(self) -> None:
        if self.seeds < 1 or self.tasks < 1:
            raise UpslopeError(f"A figure needs at least 1 seed and 1 map, not {self.seeds} and {self.tasks}.")


def full_grid_figure(maps: Maps, iterations: int | None = None) -> GridFigureConfig:
    """The full form; with shorter or longer meta-training the left panel's stops move in proportion."""
    default = ITERATIONS[maps]
    iterations = default if iterations is None else iterations
    if iterations < 1:
        raise UpslopeError(f"{iterations} iterations are too few: give at least 1.")
    stops = tuple(max(1, stop * iterations // default) for stop in STOPS[maps])
    return GridFigureConfig(
        maps,
        meta_training=for_grid_games(iterations),
        multi_task=multi_task_dqn(iterations),
        panel=AdaptationPanel(
            stops=stops, updates=20, step_sizes=(0.001, 0.003, 0.01, 0.03), start=0.5, average="mean"
        ),
    )


def quick_grid_figure(config: GridFigureConfig) -> GridFigureConfig:
    """The quick form, a minute or two: tests the code, and its results mean nothing."""
    return replace(
        config,
        seeds=1,
        tasks=4,
        dqn_updates=30,
        every=15,
        meta_training=quick_reading(config.meta_training),
        multi_task=quick_reading(config.multi_task),
        panel=replace(config.panel, stops=(20, 40), updates=2, step_sizes=(0.01, 0.1)),
    )


def trainings(maps: Maps, panels: Sequence[str]) -> tuple[str, ...]:
    """The trainings that Figures 3 and 5 share with Figures 2 and 4; the left panel alone needs no control."""
    recipes = ("algorithm1", "multi_task_dqn") if "right" in panels else ("algorithm1",)
    return tuple(training_title(maps, recipe) for recipe in recipes)


def grid_figure(
    config: GridFigureConfig,
    *,
    panels: Sequence[GridPanelName] = GRID_PANELS,
    is_quick: bool = False,
    session: Session | None = None,
) -> FigureResult:
    """Runs some panels, the right one first. The same configuration gives the same returns on one machine.

    If the left panel is pending, the session shows the right one, which does not describe the priors yet.
    """
    finished: dict[str, Panel] = {}
    seed = config.first_seed

    def figure(rows: list[dict[str, Any]]) -> FigureResult:
        return FigureResult(
            name="fig3" if config.maps == "clean" else "fig5",
            panels=dict(finished),
            priors=rows,
            training={
                "iterations": priors.iterations,
                "returns": priors.returns,
                "chosen": priors.chosen,
                **({} if control is None else {"multi_task_returns": control.returns}),
            },
            configuration=asdict(config),
            quick=is_quick,
            seconds_compiling=clock.seconds,
            seconds_running=clock.seconds_running,
            pending=tuple(panel for panel in GRID_PANELS if panel in panels and panel not in finished),
        )

    with compile_clock() as clock:
        family, unseen = families(config.maps)
        tasks = unseen.sample_many(key_for(seed, Purpose.TEST_TASKS), config.tasks)
        titles = trainings(config.maps, panels)
        # The left panel alone needs the priors only up to its last stop.
        until = None if "right" in panels else max(config.panel.stops)
        priors = meta_train_priors(family, config.meta_training, seed, config.seeds, session, titles[0], until=until)
        control = None
        if "right" in panels:
            control = meta_train_priors(family, config.multi_task, seed, config.seeds, session, titles[1])
            levels = mean_levels_on_maps(family, family.sample_many(key_for(seed, Purpose.LEVEL), 20), priors.final)
            finished["right"] = shaping_panel(
                "Shaping only: DQN",
                unseen,
                tasks,
                grid_arms(unseen, tasks, priors.final, control.final, levels),
                config.dqn,
                seed,
                updates=config.dqn_updates,
                every=config.every,
                session=session,
                score=SUCCESS,
            )
            finished["right"] = replace(finished["right"], notes=_about_the_prior(finished["right"].arms))
            if session is not None and "left" in panels:
                session.show(figure([]))
        if "left" in panels:
            left = adaptation_panel(
                unseen,
                priors,
                tasks,
                config.panel,
                config.adaptation,
                seed,
                session,
                tuning_family=family,
                score=SUCCESS,
            )
            finished = {"left": left, **finished}
        rows = _describe(unseen, tasks, priors, control, seed)
    return figure(rows)


def _about_the_prior(arms: dict[str, Arm]) -> dict[str, Any]:
    """The prior's arm compared with each other arm, and with V* in percent."""
    below = paired_shortfall(arms["prior"].returns, arms["oracle"].returns)
    return {
        "prior_less": differences(arms, "prior"),
        "percent_below_oracle": None if below is None else below._asdict(),
    }


def _describe(
    family: JaxTasks, tasks: Task, priors: Priors, control: Priors | None, first_seed: int
) -> list[dict[str, Any]]:
    """One row per seed: the measures of its prior and of multi-task DQN's on unseen maps, before learning on them."""
    exact = truths(family.env, tasks, family.gamma)
    rows: list[dict[str, Any]] = [{"iterations": int(priors.iterations[-1])} for _ in priors.chosen]
    for prefix, of_seeds in (("", priors), ("multi_task_", control)):
        if of_seeds is None:
            continue
        networks = (jax.tree.map(lambda leaf, s=seed: leaf[s], of_seeds.final) for seed in range(len(rows)))
        measures = [measure_all(family.env, exact, tasks, network, family.max_steps) for network in networks]
        solved = describe_priors(np.stack([np.asarray(one.success) for one in measures]), first_seed)
        for row, one, description in zip(rows, measures, solved, strict=True):
            row["seed"] = description.pop("seed")
            row |= {f"{prefix}{name}": value for name, value in description.items()}
            for name in ("rank_correlation", "action_optimality", "discounted_return"):
                row[f"{prefix}{name}"] = float(np.mean(getattr(one, name)))
    return rows
