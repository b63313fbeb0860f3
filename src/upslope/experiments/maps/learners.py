"""The effect of DQN's settings on maps, with potentials that are not learned: how the settings were selected."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import jax.numpy as jnp

from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.results import SUCCESS, provenance
from upslope.experiments.shaping_panel import shaping_panel
from upslope.learners.dqn import DQNConfig, for_maps
from upslope.learners.shaping import Shaping
from upslope.planning.grid_potentials import CellPotential, manhattan_potential, optimal_potential
from upslope.run.compiling import compile_clock
from upslope.run.session import Session
from upslope.tasks import grid_games

#: No learned potential is among the arms, so that none is favoured.
ARMS = ("unshaped", "manhattan", "oracle")


def _settings(steps: int, rate: float, epsilon: float = 0.1, size: float = 1e-3) -> DQNConfig:
    return replace(for_maps(), steps_per_update=steps, target_rate=rate, epsilon=epsilon, learning_rate=size)


VARIANTS: dict[str, DQNConfig] = {
    "1 step, target rate 0.02": _settings(1, 0.02),
    "1 step, target rate 0.05": _settings(1, 0.05),
    "4 steps, target rate 0.02": _settings(4, 0.02),
    "4 steps, target rate 0.05": _settings(4, 0.05),
    "4 steps, target rate 0.05, ε 0.3": _settings(4, 0.05, epsilon=0.3),
    "4 steps, target rate 0.05, step size 5e-4": _settings(4, 0.05, size=5e-4),
}


@dataclass(frozen=True)
class GridLearnersConfig:
    """Settings of the study.

    Attributes:
        seeds: the number of runs per map.
        first_seed: seeds are first_seed, first_seed + 1, …; no figure uses them.
        tasks: the number of tuning maps, which come from the training split.
        updates: updates of each learner.
        every: updates between evaluations.
    """

    seeds: int = 1
    first_seed: int = 10_000
    tasks: int = 20
    updates: int = 200
    every: int = 25


def quick_grid_learners(config: GridLearnersConfig) -> GridLearnersConfig:
    """Few maps and updates: tests the code, and its results mean nothing."""
    return replace(config, tasks=2, updates=10, every=5)


def grid_learners(config: GridLearnersConfig, session: Session | None = None) -> dict[str, Any]:
    """Runs every setting with every arm, and returns the content of results.json."""
    family = grid_games(split="train")
    rows: dict[str, dict[str, Any]] = {}
    with compile_clock() as clock:
        maps = family.sample_many(key_for(config.first_seed, Purpose.TUNING_TASKS), config.tasks)
        shape = (config.seeds, config.tasks)
        exact = optimal_potential(family, maps).values
        tables = (jnp.zeros_like(exact), manhattan_potential(family, maps).values, exact)
        arms = {
            name: Shaping(CellPotential(jnp.broadcast_to(values, (config.seeds, *values.shape))), jnp.zeros(shape))
            for name, values in zip(ARMS, tables, strict=True)
        }
        for name, settings in VARIANTS.items():
            panel = shaping_panel(
                "DQN",
                family,
                maps,
                arms,
                settings,
                config.first_seed,
                updates=config.updates,
                every=config.every,
                session=session,
                stage=f"{name}:",
                score=SUCCESS,
            )
            summaries = {arm: curves.summary for arm, curves in panel.arms.items()}
            rows[name] = {"arms": summaries, "settings": asdict(settings)}
    return {
        "figure": "grid-learners",
        "variants": rows,
        **provenance(clock, asdict(config)),
    }
