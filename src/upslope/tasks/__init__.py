"""Families of tasks: what is learned over."""

from upslope.tasks.cartpoles import cartpoles
from upslope.tasks.family import AbstractFamily
from upslope.tasks.jax_tasks import JaxTasks
from upslope.tasks.single import SingleTask

__all__ = ["AbstractFamily", "JaxTasks", "SingleTask", "cartpoles"]
