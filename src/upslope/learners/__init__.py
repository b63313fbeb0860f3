"""Learners of one task: DQN and DDPG, and their parts. A new learner is one file and one line here."""

from upslope.errors import UpslopeError
from upslope.learners.ddpg import DDPGConfig
from upslope.learners.dqn import DQNConfig
from upslope.learners.settings import AbstractLearnerConfig
from upslope.tasks.family import AbstractFamily

#: Learners by name. The first one for a kind of action is the default for that kind.
LEARNERS: dict[str, type[AbstractLearnerConfig]] = {config.name: config for config in (DQNConfig, DDPGConfig)}


def suited_to(family: AbstractFamily) -> AbstractLearnerConfig:
    """The settings of a family's default learner: the first one for its kind of action, by the family's recipe.

    Raises:
        UpslopeError: there is no learner for this kind of action.
    """
    for config in LEARNERS.values():
        if config.actions == family.actions.kind:
            return config.for_recipe(family.recipe)
    raise UpslopeError(f"No learner is for {family.actions.kind} actions: give the settings of one of your own.")


__all__ = ["LEARNERS", "AbstractLearnerConfig", "DDPGConfig", "DQNConfig", "suited_to"]
