"""What learns one task: DQN, DDPG, and what they are made of. A new learner is one file, and one line here."""

from upslope.errors import UpslopeError
from upslope.learners.ddpg import DDPGConfig
from upslope.learners.dqn import DQNConfig
from upslope.learners.settings import AbstractLearnerConfig
from upslope.tasks.family import AbstractFamily

#: By name. The first for a kind of action is the default there.
LEARNERS: dict[str, type[AbstractLearnerConfig]] = {config.name: config for config in (DQNConfig, DDPGConfig)}


def suited_to(family: AbstractFamily) -> AbstractLearnerConfig:
    """The settings of the default learner for a family: the first for its kind of action, by the family's recipe.

    Raises:
        UpslopeError: no learner is for this kind of action.
    """
    for config in LEARNERS.values():
        if config.actions == family.actions.kind:
            return config.for_recipe(family.recipe)
    raise UpslopeError(f"No learner is for {family.actions.kind} actions: give the settings of one of your own.")


__all__ = ["LEARNERS", "AbstractLearnerConfig", "DDPGConfig", "DQNConfig", "suited_to"]
