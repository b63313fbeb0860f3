"""Every type and shape that crosses a layer, in one small file."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree
from jaxtyping import Key as KeyArray

Key: TypeAlias = PRNGKeyArray
Keys: TypeAlias = KeyArray[Array, "..."]
Scalar: TypeAlias = Float[Array, ""]

#: A task M_i: the parameters that tell it from the other tasks of its family. 200 tasks are one stacked PyTree.
Task: TypeAlias = PyTree

#: One observation, unbatched. Batches carry leading axes and are mapped over at the call site.
Observation: TypeAlias = Float[Array, "*obs"]

#: An action: an integer for discrete tasks, a float vector or scalar for continuous ones.
Action: TypeAlias = Any

#: A potential Φ: one observation to one number.
Potential: TypeAlias = Callable[[Observation], Scalar]

#: A policy: a key and a batch of observations ``[n, *obs]`` to a batch of actions ``[n, ...]``.
Policy: TypeAlias = Callable[[Key, Float[Array, "n *obs"]], Any]

#: A policy on the host: the number of a step and observations ``[n, *obs]`` to actions ``[n, ...]``.
Acting: TypeAlias = Callable[[int, np.ndarray], np.ndarray]

#: What a learner reports of one step: named numbers, or one for each of its tasks.
Metrics: TypeAlias = dict[str, Float[Array, "..."]]


class Transition(NamedTuple):
    """What learning code sees of the world: the seam between families and learners.

    ``discount`` is γ·(1 − terminated). This one factor carries γ, termination and Φ(terminal) = 0.
    ``next_obs`` is the true successor, never the observation after a reset; at truncation the discount stays γ.
    """

    obs: Float[Array, "*batch_and_obs"]
    action: Any
    reward: Float[Array, "*batch"]
    discount: Float[Array, "*batch"]
    next_obs: Float[Array, "*batch_and_obs"]
