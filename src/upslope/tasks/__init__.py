"""Families of tasks: the distributions that meta-training learns over."""

from upslope.tasks.cartpoles import cartpoles
from upslope.tasks.family import AbstractFamily
from upslope.tasks.grids import clean_maps, grid_games, obstacle_maps
from upslope.tasks.gymnasium_tasks import GymnasiumTasks
from upslope.tasks.gymnax_tasks import gymnax_tasks
from upslope.tasks.jax_tasks import JaxTasks
from upslope.tasks.settings import FAMILIES

__all__ = [
    "FAMILIES",
    "AbstractFamily",
    "GymnasiumTasks",
    "JaxTasks",
    "cartpoles",
    "clean_maps",
    "grid_games",
    "gymnax_tasks",
    "obstacle_maps",
]
