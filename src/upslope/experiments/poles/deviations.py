"""The effect of each difference from the paper: Algorithm 1 to the letter, our recipe, the recipe with one change."""

import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.priors import Priors, meta_train_priors, zero_shot_returns
from upslope.experiments.results import provenance
from upslope.learners.policies import EpsilonGreedy
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import as_printed
from upslope.networks.dueling import DuelingQ
from upslope.run.compiling import compile_clock
from upslope.run.session import Session
from upslope.tasks import JaxTasks, cartpoles

RECIPE = MetaTrainingConfig()

#: By the number in docs/deviations.md: what is changed, and the recipe with only that change.
VARIANTS: dict[str, tuple[str, MetaTrainingConfig]] = {
    "0": ("the recipe", RECIPE),
    "1": ("Algorithm 1 to the letter, SGD with β = 0.1", as_printed()),
    "1b": ("to the letter, Adam with β = 0.005", replace(as_printed(), outer_optimiser="adam", outer_step_size=0.005)),
    "1c": ("to the letter, semi-gradient of Eq. 5", as_printed().with_posterior(td_gradient="semi")),
    "2": ("Q_φ kept in the graph as the target of Eq. 7", RECIPE.with_posterior(outer_target="kept")),
    "2b": ("the same, first order", RECIPE.with_posterior(outer_target="kept", first_order=True)),
    "3": ("no target network", RECIPE.with_posterior(target_decay=None)),
    "4": ("one outer update per iteration", replace(RECIPE, outer_updates=1)),
    "5": ("β constant", replace(RECIPE, outer_step_size_end=RECIPE.outer_step_size)),
    "6": (
        "plain gradient descent for the outer step, β = 0.5",
        replace(RECIPE, outer_optimiser="sgd", outer_step_size=0.5),
    ),
    "7": ("ε = 0.2 for every task", replace(RECIPE, epsilon=(0.2, 0.2))),
    "8": ("ReLU", replace(RECIPE, activation="relu")),
    "9": ("no average of θ", replace(RECIPE, averaging=0.0)),
    "10": ("no selection among snapshots", replace(RECIPE, select_from=1.0)),
    "10b": ("selection from the second half only", replace(RECIPE, select_from=0.5)),
    "11": ("full gradient of Eq. 5", RECIPE.with_posterior(td_gradient="full")),
    "12": ("N = 3 inner steps", RECIPE.with_posterior(inner_steps=3)),
}


@dataclass(frozen=True)
class DeviationsConfig:
    """Settings of the study.

    Attributes:
        seeds: the number of priors of each variant.
        first_seed: seeds are first_seed, first_seed + 1, …; it also determines the test tasks.
        tasks: the number of unseen tasks.
        variants: names of the variants; all if empty.
    """

    seeds: int = 10
    first_seed: int = 0
    tasks: int = 40
    variants: tuple[str, ...] = ()


def quick_deviations(config: DeviationsConfig) -> DeviationsConfig:
    """Two variants and two seeds: tests the code, and its results mean nothing."""
    return replace(config, seeds=2, tasks=10, variants=("0", "1"))


def deviations(config: DeviationsConfig, session: Session | None = None) -> dict[str, Any]:
    """Meta-trains every variant and returns the content of its results.json.

    Each variant has the zero-shot return of each seed's prior on unseen tasks, and the standard deviation of V over
    states of half-random behaviour (zero if the potential has collapsed or diverged).
    """
    family = cartpoles()
    tasks = family.sample_many(key_for(config.first_seed, Purpose.TEST_TASKS), config.tasks)
    rows = {}
    with compile_clock() as clock:
        for name, (what, settings) in VARIANTS.items():
            if config.variants and name not in config.variants:
                continue
            start, compiled = time.perf_counter(), clock.seconds
            priors = meta_train_priors(
                family,
                settings,
                config.first_seed,
                config.seeds,
                session,
                title=f"variant {name}",
                allow_divergence=True,
            )
            rows[name] = {
                "what": what,
                **_measure(family, priors, tasks, config),
                "seconds_compiling": clock.seconds - compiled,
                "seconds": time.perf_counter() - start,
                "settings": asdict(settings),
            }
    return {
        "figure": "deviations",
        "variants": rows,
        **provenance(clock, asdict(config)),
    }


def _measure(family: JaxTasks, priors: Priors, tasks: Any, config: DeviationsConfig) -> dict[str, Any]:
    returns = zero_shot_returns(family, priors.final, tasks, key_for(config.first_seed, Purpose.ZERO_SHOT))
    means = np.sort(np.asarray(returns).mean(axis=1))
    spread = np.asarray(value_spread(family, priors.final, key_for(config.first_seed, Purpose.LEVEL)))
    return {
        "zero_shot": means.tolist(),
        "median": float(np.median(means)),
        "at_least_195": int(np.sum(means >= 195)),
        "diverged": int(np.sum(~np.isfinite(spread))),
        "value_spread_median": float(np.median(np.nan_to_num(spread, nan=0.0, posinf=0.0))),
    }


@jax.jit
def value_spread(family: JaxTasks, networks: DuelingQ, key: jax.Array) -> jax.Array:
    """Each prior's standard deviation of V over the states that it visits with ε = 0.5 on extra tasks ``[seeds]``."""
    task_key, reset_key, act_key = jax.random.split(key, 3)
    tasks = family.sample_many(task_key, 20)

    def spread(network: DuelingQ) -> jax.Array:
        running = family.reset(reset_key, tasks)
        _, transitions = family.collect(act_key, tasks, running, EpsilonGreedy(network, 0.5), family.max_steps)
        return jnp.std(jax.vmap(jax.vmap(network.value))(transitions.obs))

    return jax.vmap(spread)(networks)
