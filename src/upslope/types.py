"""The types and shapes that pass between layers."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree
from jaxtyping import Key as KeyArray

Key: TypeAlias = PRNGKeyArray
Keys: TypeAlias = KeyArray[Array, "..."]
Scalar: TypeAlias = Float[Array, ""]

#: A task M_i: the parameters that distinguish it from the other tasks of its family. 200 tasks are one stacked PyTree.
Task: TypeAlias = PyTree

#: One observation, unbatched. Batches have leading axes; the caller maps over them.
Observation: TypeAlias = Float[Array, "*obs"]

#: An action: an integer for discrete tasks, a float vector or scalar for continuous ones.
Action: TypeAlias = Any

#: A potential Φ: from one observation to one number.
Potential: TypeAlias = Callable[[Observation], Scalar]

#: A policy: from a key and a batch of observations ``[n, *obs]`` to a batch of actions ``[n, ...]``.
Policy: TypeAlias = Callable[[Key, Float[Array, "n *obs"]], Any]

#: A policy on the host: from the index of a step and observations ``[n, *obs]`` to actions ``[n, ...]``.
Acting: TypeAlias = Callable[[int, np.ndarray], np.ndarray]

#: A learner's metrics of one step by name: one number each, or one number per task.
Metrics: TypeAlias = dict[str, Float[Array, "..."]]


class Transition(NamedTuple):
    """Transitions: the interface between families and learners.

    ``discount`` is γ·(1 − terminated). This one factor represents γ, termination and Φ(terminal) = 0.
    ``next_obs`` is the true successor, never the observation after a reset; at truncation the discount stays γ.
    """

    obs: Float[Array, "*batch_and_obs"]
    action: Any
    reward: Float[Array, "*batch"]
    discount: Float[Array, "*batch"]
    next_obs: Float[Array, "*batch_and_obs"]
