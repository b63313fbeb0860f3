"""The effect of DQN's and DDPG's settings on each arm, on tuning tasks: the record of how they were selected."""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.priors import mean_levels, meta_train_priors
from upslope.experiments.results import provenance
from upslope.experiments.shaping_panel import shaping_arms, shaping_panel
from upslope.learners.ddpg import DDPGConfig
from upslope.learners.dqn import DQNConfig
from upslope.meta_training.config import MetaTrainingConfig
from upslope.run.compiling import compile_clock
from upslope.run.session import Session
from upslope.tasks import cartpoles

ARMS = ("unshaped", "constant", "prior")

DQN_VARIANTS: dict[str, DQNConfig] = {
    "as set": DQNConfig(),
    "squared TD errors": DQNConfig(huber_threshold=math.inf),
    "step size 2e-3, not decayed": DQNConfig(learning_rate=2e-3, decay_updates=0),
    "target rate 0.03": DQNConfig(target_rate=0.03),
    "4 steps per update": DQNConfig(steps_per_update=4),
}

DDPG_VARIANTS: dict[str, DDPGConfig] = {
    "as set": DDPGConfig(),
    "squared TD errors": DDPGConfig(huber_threshold=math.inf),
    "target rate 0.01": DDPGConfig(target_rate=0.01),
    "target rate 0.01, squared": DDPGConfig(target_rate=0.01, huber_threshold=math.inf),
    "noise 0.15": DDPGConfig(noise=0.15),
    "no saturation penalty": DDPGConfig(saturation_penalty=0.0),
}


@dataclass(frozen=True)
class LearnersConfig:
    """Settings of the study.

    Attributes:
        seeds: the number of priors, and of runs per task.
        first_seed: seeds are first_seed, first_seed + 1, …; no figure uses them.
        tasks: the number of tuning tasks.
        dqn_updates: updates of each DQN.
        ddpg_updates: updates of each DDPG.
        every: updates between evaluations.
        meta_training: training of the priors.
    """

    seeds: int = 2
    first_seed: int = 10_000
    tasks: int = 20
    dqn_updates: int = 1000
    ddpg_updates: int = 3000
    every: int = 100
    meta_training: MetaTrainingConfig = field(default_factory=MetaTrainingConfig)


def quick_learners(config: LearnersConfig) -> LearnersConfig:
    """Few tasks and updates: tests the code, and its results mean nothing."""
    return replace(config, seeds=1, tasks=4, dqn_updates=100, ddpg_updates=100)


def learners(config: LearnersConfig, session: Session | None = None) -> dict[str, Any]:
    """Runs every setting of both learners with every arm, and returns the content of its results.json."""
    family = cartpoles()
    rows: dict[str, dict[str, Any]] = {}
    with compile_clock() as clock:
        tasks = family.sample_many(key_for(config.first_seed, Purpose.TUNING_TASKS), config.tasks)
        priors = meta_train_priors(family, config.meta_training, config.first_seed, config.seeds, session).final
        levels = np.asarray(mean_levels(family, priors, key_for(config.first_seed, Purpose.LEVEL)))
        arms = shaping_arms(family, priors, levels, None, config.tasks)
        compared = {name: arms[name] for name in ARMS}
        for learner, actions, updates, variants in (
            ("DQN", family, config.dqn_updates, DQN_VARIANTS),
            ("DDPG", cartpoles(continuous=True), config.ddpg_updates, DDPG_VARIANTS),
        ):
            for name, settings in variants.items():
                panel = shaping_panel(
                    learner,
                    actions,
                    tasks,
                    compared,
                    settings,
                    config.first_seed,
                    updates=updates,
                    every=config.every,
                    session=session,
                    stage=f"{learner}, {name}:",
                )
                summaries = {arm: curves.summary for arm, curves in panel.arms.items()}
                rows[f"{learner}, {name}"] = {"arms": summaries, "settings": _plain(asdict(settings))}
    return {
        "figure": "learners",
        "variants": rows,
        **provenance(clock, asdict(config)),
    }


def _plain(settings: dict[str, Any]) -> dict[str, Any]:
    """JSON has no infinity: a threshold without effect is null."""
    return {name: None if value == math.inf else value for name, value in settings.items()}
