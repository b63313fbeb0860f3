"""Figure 1: CartPoles with unseen pole lengths. Left: adaptation; middle: shaped DQN; right: shaped DDPG."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from upslope.adaptation.algorithm2 import AdaptationConfig
from upslope.errors import UpslopeError
from upslope.experiments.adaptation_panel import (
    RULES,
    AdaptationPanel,
    adaptation_keys,
    adaptation_learners,
    adaptation_panel,
    one_of,
)
from upslope.experiments.experiment import PANELS, PanelName
from upslope.experiments.keys import Purpose, key_for, keys_per_task
from upslope.experiments.priors import (
    blank_priors,
    describe_priors,
    mean_levels,
    meta_train_priors,
    oracle_learners,
    oracles,
    zero_shot_returns,
)
from upslope.experiments.results import FigureResult, Panel
from upslope.experiments.shaping_panel import shaping_arms, shaping_learners, shaping_panel
from upslope.learners.ddpg import DDPGConfig
from upslope.learners.dqn import DQNConfig
from upslope.meta_training.config import MetaTrainingConfig
from upslope.run.compiling import Ahead, compile_clock
from upslope.run.loop import expect
from upslope.run.session import Session
from upslope.tasks import JaxTasks, cartpoles
from upslope.types import Task


@dataclass(frozen=True)
class Figure1Config:
    """The protocol of Figure 1.

    Attributes:
        seeds: the number of priors, and of runs per task.
        tasks: the number of unseen tasks.
        first_seed: seeds are first_seed, first_seed + 1, …; it also determines the test tasks.
        length: bounds of the full pole length, in metres.
        gamma: γ.
        dqn_updates: updates in the middle panel.
        ddpg_updates: updates in the right panel.
        every: updates between evaluations in the middle and right panels.
        meta_training: settings of Algorithm 1.
        oracle: training of each task's oracle to convergence, so snapshots of its first half are not candidates.
        panel: stops and step sizes of the left panel.
        adaptation: sizes of batches and replay in the left panel.
        dqn: the learner of the middle panel.
        ddpg: the learner of the right panel.
    """

    seeds: int = 5
    tasks: int = 40
    first_seed: int = 0
    length: tuple[float, float] = (0.25, 5.0)
    gamma: float = 0.98
    dqn_updates: int = 1000
    ddpg_updates: int = 3000
    every: int = 100
    meta_training: MetaTrainingConfig = field(default_factory=MetaTrainingConfig)
    oracle: MetaTrainingConfig = field(
        default_factory=lambda: MetaTrainingConfig(
            iterations=1000, tasks=5, steps_per_task=100, snapshot_every=50, evaluation_tasks=2, select_from=0.5
        )
    )
    panel: AdaptationPanel = field(default_factory=AdaptationPanel)
    adaptation: AdaptationConfig = field(
        # Just large enough for 20 updates: a larger replay would stay mostly empty and still be copied.
        default_factory=lambda: AdaptationConfig(evaluation_episodes=1, replay_capacity=4000)
    )
    dqn: DQNConfig = field(default_factory=DQNConfig)
    ddpg: DDPGConfig = field(default_factory=DDPGConfig)

    def __post_init__(self) -> None:
        if self.seeds < 1 or self.tasks < 1:
            raise UpslopeError(f"A figure needs at least 1 seed and 1 task, not {self.seeds} and {self.tasks}.")


def quick(config: Figure1Config) -> Figure1Config:
    """The quick form, about a minute: tests the code, and says nothing about the paper."""
    return replace(
        config,
        seeds=2,
        tasks=10,
        dqn_updates=300,
        ddpg_updates=400,
        oracle=replace(config.oracle, iterations=100),
        panel=replace(config.panel, stops=(100, 150, 500), updates=8),
    )


def figure1(
    config: Figure1Config,
    *,
    panels: Sequence[PanelName] = PANELS,
    is_quick: bool = False,
    session: Session | None = None,
) -> FigureResult:
    """Runs some panels. The same configuration gives bit-identical returns on one machine.

    After each panel except the last, the session shows the unfinished figure, which does not describe the priors yet.
    """
    finished: dict[str, Panel] = {}

    def figure(rows: list[dict[str, int | float]]) -> FigureResult:
        return FigureResult(
            name="fig1",
            panels=dict(finished),
            priors=rows,
            training={"iterations": priors.iterations, "returns": priors.returns, "chosen": priors.chosen},
            configuration=asdict(config),
            quick=is_quick,
            seconds_compiling=clock.seconds,
            seconds_running=clock.seconds_running,
            pending=tuple(panel for panel in PANELS if panel in panels and panel not in finished),
        )

    def show() -> None:
        unfinished = figure([])
        if unfinished.pending:
            outer_session.show(unfinished)

    outer_session = session or Session()
    with compile_clock() as clock, Ahead() as ahead:
        session = replace(outer_session, ahead=ahead)
        family = cartpoles(config.length, gamma=config.gamma)
        pushes = cartpoles(config.length, gamma=config.gamma, continuous=True)
        seed = config.first_seed
        tasks = family.sample_many(key_for(seed, Purpose.TEST_TASKS), config.tasks)
        _compile_ahead(config, panels, family, pushes, tasks, ahead)
        priors = meta_train_priors(family, config.meta_training, seed, config.seeds, session)
        if "left" in panels:
            finished["left"] = adaptation_panel(family, priors, tasks, config.panel, config.adaptation, seed, session)
            show()
        if "middle" in panels or "right" in panels:
            levels = np.asarray(mean_levels(family, priors.final, key_for(seed, Purpose.LEVEL)))
            best = oracles(family, tasks, config.oracle, seed, session)
            arms = shaping_arms(family, priors.final, levels, best, config.tasks)
            if "middle" in panels:
                finished["middle"] = shaping_panel(
                    "Shaping only: DQN",
                    family,
                    tasks,
                    arms,
                    config.dqn,
                    seed,
                    updates=config.dqn_updates,
                    every=config.every,
                    session=session,
                )
                show()
            if "right" in panels:
                finished["right"] = shaping_panel(
                    "Shaping only: DDPG",
                    pushes,
                    tasks,
                    arms,
                    config.ddpg,
                    seed,
                    updates=config.ddpg_updates,
                    every=config.every,
                    session=session,
                )
        returns = zero_shot_returns(family, priors.final, tasks, key_for(seed, Purpose.ZERO_SHOT))
        rows = describe_priors(np.asarray(returns), seed)
    return figure(rows)


def _compile_ahead(
    config: Figure1Config, panels: Sequence[PanelName], family: JaxTasks, pushes: JaxTasks, tasks: Task, ahead: Ahead
) -> None:
    """Compiles the panels' programs in the background, in the order of use; each serves all arms of its panel."""
    seed, blank = config.first_seed, blank_priors(family, config.meta_training, config.seeds)
    if "left" in panels:
        starts = blank_priors(family, config.meta_training, len(config.panel.stops), config.seeds)
        sizes = np.zeros((len(config.panel.stops), config.tasks))
        learners = adaptation_learners(family, starts, one_of(RULES, 0), config.adaptation, tasks, sizes)
        expect(learners, adaptation_keys(seed, Purpose.LEFT, learners), ahead)
    if "middle" in panels or "right" in panels:
        expect(*oracle_learners(family, tasks, config.oracle, seed), ahead)
        shaping = shaping_arms(family, blank, np.zeros(config.seeds), None, config.tasks)["prior"]
        keys = keys_per_task(seed, config.seeds, config.tasks, Purpose.MIDDLE)
        if "middle" in panels:
            expect(shaping_learners(family, tasks, shaping, config.dqn), keys, ahead)
        if "right" in panels:
            expect(shaping_learners(pushes, tasks, shaping, config.ddpg), keys, ahead)
