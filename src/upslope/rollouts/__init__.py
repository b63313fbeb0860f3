"""Environments on the host: where they run, and how policies are run in them. Loads no JAX."""

from collections.abc import Callable

import gymnasium as gym

from upslope.rollouts.rollouts import AbstractRollouts, Act, Trajectories
from upslope.rollouts.task_slot import EnvironmentFactory
from upslope.rollouts.vector_rollouts import in_process, process_for_each

#: Backends by the name that a family takes as its ``mode``. Each is made from a factory of environments and from the
#: observation and action space that these share.
ROLLOUTS: dict[str, Callable[[EnvironmentFactory, gym.Space, gym.Space], AbstractRollouts]] = {
    "sync": in_process,
    "async": process_for_each,
}

__all__ = ["ROLLOUTS", "AbstractRollouts", "Act", "EnvironmentFactory", "Trajectories"]
