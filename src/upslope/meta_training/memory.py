"""What Algorithm 1 remembers between iterations: replays of the latest ones, and what random steps showed."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors.posterior import Replays
from upslope.meta_training.state import MetaTrainingState
from upslope.types import Key


def remember(state: MetaTrainingState, gathered: Replays, config: MetaTrainingConfig) -> MetaTrainingState:
    """The state with the replays of one more iteration; while steps are random, all networks get the new scaling."""
    if state.kept is not None:
        place = state.iteration % config.kept_iterations * config.tasks
        kept = jax.tree.map(
            lambda old, new: jax.lax.dynamic_update_slice_in_dim(old, new, place, 0), state.kept, gathered
        )
        state = replace(state, kept=kept)
    if state.statistics is None:
        return state
    is_random = state.iteration < config.random_iterations
    statistics = jax.tree.map(
        lambda new, old: jnp.where(is_random, new, old), state.statistics.with_steps(gathered), state.statistics
    )
    scaling = statistics.scaling
    networks = {name: getattr(state, name).with_scaling(scaling) for name in ("theta", "acting", "target", "average")}
    return replace(state, statistics=statistics, **networks)


def drawn_replays(key: Key, state: MetaTrainingState, config: MetaTrainingConfig) -> Replays:
    """The replays of ``config.tasks`` tasks ``[tasks, ...]``, drawn from all that are kept."""
    filled = jnp.minimum(state.iteration + 1, config.kept_iterations) * config.tasks
    which = jax.random.randint(key, (config.tasks,), 0, filled)
    return jax.tree.map(lambda leaf: leaf[which], state.kept)
