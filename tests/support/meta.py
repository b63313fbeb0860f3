"""Algorithm 1 at a size that hand-made sums can follow."""

import dataclasses

from support.probes import discrete_family
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig

TASKS, BATCH, ALPHA = 2, 3, 0.1
TINY = MetaTrainingConfig(
    iterations=4, tasks=TASKS, steps_per_task=8, batch_size=BATCH, hidden=(6, 5), inner_step_size=ALPHA,
    outer_updates=2, evaluation_tasks=3, evaluation_episodes=2,
)  # fmt: skip


def learner(**changes) -> MetaTraining:
    """On the probe family, with some settings changed."""
    return MetaTraining(discrete_family(), dataclasses.replace(TINY, **changes))
