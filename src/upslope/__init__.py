"""upslope: meta-learned potentials that shape the reward of every new task of a family."""

from upslope.api import adapt, meta_train, train
from upslope.errors import UpslopeError
from upslope.prior import Prior
from upslope.recipes import MetaTrainingConfig
from upslope.tasks import cartpoles, clean_maps, grid_games, obstacle_maps

__all__ = [
    "MetaTrainingConfig",
    "Prior",
    "UpslopeError",
    "adapt",
    "cartpoles",
    "clean_maps",
    "grid_games",
    "meta_train",
    "obstacle_maps",
    "train",
]
