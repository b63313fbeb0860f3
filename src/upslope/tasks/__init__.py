"""Families of tasks: what is learned over."""

from upslope.tasks.cartpoles import cartpoles
from upslope.tasks.family import AbstractFamily
from upslope.tasks.jax_tasks import JaxTasks

__all__ = ["AbstractFamily", "JaxTasks", "cartpoles"]
