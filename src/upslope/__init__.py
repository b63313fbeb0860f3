"""upslope: meta-learned potentials that shape the reward of every new task of a family."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from upslope.envs.registration import register_environments

if TYPE_CHECKING:
    from upslope.api import adapt, meta_train, train
    from upslope.checking import check_shaping
    from upslope.errors import UpslopeError
    from upslope.meta_training.config import MetaTrainingConfig
    from upslope.priors.numpy_potential import NumpyPotential
    from upslope.priors.pretrained import load_prior, prior_path
    from upslope.priors.prior import Prior
    from upslope.run.checkpoints import Checkpoints
    from upslope.run.session import Session
    from upslope.tasks import GymnasiumTasks, cartpoles, clean_maps, grid_games, gymnax_tasks, obstacle_maps
    from upslope.wrappers import PotentialShaping, shape

# Imported when first asked for: a simulator process that only shapes rewards never imports JAX.
_HOMES = {
    "GymnasiumTasks": "upslope.tasks",
    "Checkpoints": "upslope.run.checkpoints",
    "MetaTrainingConfig": "upslope.meta_training.config",
    "NumpyPotential": "upslope.priors.numpy_potential",
    "PotentialShaping": "upslope.wrappers",
    "Prior": "upslope.priors.prior",
    "Session": "upslope.run.session",
    "UpslopeError": "upslope.errors",
    "adapt": "upslope.api",
    "cartpoles": "upslope.tasks",
    "clean_maps": "upslope.tasks",
    "grid_games": "upslope.tasks",
    "gymnax_tasks": "upslope.tasks",
    "obstacle_maps": "upslope.tasks",
    "check_shaping": "upslope.checking",
    "load_prior": "upslope.priors.pretrained",
    "meta_train": "upslope.api",
    "prior_path": "upslope.priors.pretrained",
    "shape": "upslope.wrappers",
    "train": "upslope.api",
}

__all__ = [
    "Checkpoints",
    "GymnasiumTasks",
    "MetaTrainingConfig",
    "NumpyPotential",
    "PotentialShaping",
    "Prior",
    "Session",
    "UpslopeError",
    "adapt",
    "cartpoles",
    "check_shaping",
    "clean_maps",
    "grid_games",
    "gymnax_tasks",
    "load_prior",
    "meta_train",
    "obstacle_maps",
    "prior_path",
    "shape",
    "train",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'upslope' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register_environments()
