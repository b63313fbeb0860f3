"""What each part of the recipe for any family is worth: the recipe as it is, and with one change."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import jax
import numpy as np

from upslope.experiments.families.suite import TUNING, Entry
from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.priors import meta_train_priors
from upslope.experiments.results import provenance
from upslope.learners.policies import Greedy
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import for_any_family
from upslope.run.compiling import compile_clock
from upslope.run.session import Session
from upslope.tasks.family import AbstractFamily

Change = Callable[[MetaTrainingConfig], MetaTrainingConfig]


def _setting(**changes: Any) -> Change:
    return lambda config: replace(config, **changes)


def _of_posterior(**changes: Any) -> Change:
    return lambda config: config.with_posterior(**changes)


#: What is changed in the recipe, by name.
VARIANTS: dict[str, tuple[str, Change]] = {
    "recipe": ("nothing", _setting()),
    "fresh": ("only the latest replays", _setting(kept_iterations=1)),
    "steps": ("random actions are not held", _setting(longest_hold=1)),
    "raw": ("neither observations nor returns are normalised", _setting(normalise=False)),
    "few": ("4 outer updates per iteration", _setting(outer_updates=4)),
    "no target": ("no target network", _of_posterior(target_decay=0.0)),
    "no average": ("no average of θ", _setting(averaging=0.0)),
    "last": ("no selection among snapshots", _setting(select_from=1.0)),
    "whole": ("whole trajectories in each outer step", _of_posterior(drawn_steps=None)),
    "huber": ("a Huber loss in place of Eq. 7", _of_posterior(outer_loss="huber")),
    "N = 10": ("ten inner steps along the trajectories", _of_posterior(inner_steps=10)),
    "α = 0.5": ("an inner step of half the size", _of_posterior(inner_step_size=0.5)),
    "narrow": ("hidden layers of 64", _setting(hidden=(64, 64))),
}


@dataclass(frozen=True)
class RecipeConfig:
    """Settings of the study.

    Attributes:
        seeds: the number of priors of each variant.
        first_seed: seeds are first_seed, first_seed + 1, …; it also determines the fresh tasks.
        tasks: the number of fresh tasks.
        families: names in the suite.
        variants: names of the variants; all if empty.
        iterations: of each training; the recipe's if None.
    """

    seeds: int = 3
    first_seed: int = 0
    tasks: int = 50
    families: tuple[str, ...] = ("mountain cars", "reach")
    variants: tuple[str, ...] = ()
    iterations: int | None = None


def quick_recipe(config: RecipeConfig) -> RecipeConfig:
    """Two variants of one family, hardly trained: tests the code, and its results mean nothing."""
    return replace(config, seeds=2, tasks=4, families=("mountain cars",), variants=("recipe", "fresh"), iterations=6)


def recipe_study(config: RecipeConfig, session: Session | None = None) -> dict[str, Any]:
    """Meta-trains every variant on every family and returns the content of its results.json.

    Each row has the zero-shot returns ``[seeds, tasks]`` of the priors on fresh tasks, and the seconds that they took.
    """
    rows: dict[str, dict[str, Any]] = {}
    with compile_clock() as clock:
        for family_name in config.families:
            entry, rows[family_name] = TUNING[family_name], {}
            family = entry.build()
            for name, (what, change) in VARIANTS.items():
                if config.variants and name not in config.variants:
                    continue
                start, compiled = time.perf_counter(), clock.seconds
                title = f"{family_name}, {name}"
                settings = change(for_any_family(family))
                if config.iterations is not None:
                    settings = replace(settings, iterations=config.iterations)
                rows[family_name][name] = {
                    "what": what,
                    **_zero_shot(family, entry, settings, config, session, title),
                    "seconds_compiling": clock.seconds - compiled,
                    "seconds": time.perf_counter() - start,
                    "settings": asdict(settings),
                }
    return {"figure": "recipe", "families": rows, **provenance(clock, asdict(config))}


def _zero_shot(
    family: AbstractFamily,
    entry: Entry,
    settings: MetaTrainingConfig,
    config: RecipeConfig,
    session: Session | None,
    title: str,
) -> dict[str, Any]:
    """Trains the priors of all seeds, and measures them on fresh tasks."""
    priors = meta_train_priors(
        family, settings, config.first_seed, config.seeds, session, title=title, allow_divergence=True
    )
    tasks = family.sample_many(key_for(config.first_seed, Purpose.TEST_TASKS), config.tasks)
    key = key_for(config.first_seed, Purpose.ZERO_SHOT)
    returns = np.stack(
        [
            np.asarray(family.returns(key, tasks, Greedy(jax.tree.map(lambda leaf, at=seed: leaf[at], priors.final))))
            for seed in range(config.seeds)
        ]
    )
    return {
        "zero_shot": returns.tolist(),
        "medians": np.median(returns, axis=1).tolist(),
        "means": returns.mean(axis=1).tolist(),
        "solved": np.mean(returns >= entry.solved, axis=1).tolist(),
        "chosen": priors.chosen.tolist(),
        "curve": priors.returns.mean(axis=0).tolist(),
    }
