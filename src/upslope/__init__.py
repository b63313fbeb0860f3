"""upslope: meta-learned potentials that shape the reward of every new task of a family."""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from upslope.envs.registration import register_environments

if TYPE_CHECKING:
    from upslope.adaptation.algorithm2 import AdaptationConfig as AdaptationConfig
    from upslope.adaptation.algorithm2 import Algorithm2 as Algorithm2
    from upslope.adaptation.algorithm2 import UpdateRule as UpdateRule
    from upslope.adaptation.controls import CentredTD as CentredTD
    from upslope.adaptation.controls import FrozenPotential as FrozenPotential
    from upslope.adaptation.fine_tuning import FineTuning as FineTuning
    from upslope.api import adapt as adapt
    from upslope.api import evaluate as evaluate
    from upslope.api import meta_train as meta_train
    from upslope.api import train as train
    from upslope.checking import check_shaping as check_shaping
    from upslope.errors import PriorWarning as PriorWarning
    from upslope.errors import UpslopeError as UpslopeError
    from upslope.evaluation.verdict import Verdict as Verdict
    from upslope.learners import AbstractLearnerConfig as AbstractLearnerConfig
    from upslope.learners import DDPGConfig as DDPGConfig
    from upslope.learners import DQNConfig as DQNConfig
    from upslope.learners.agent import Agent as Agent
    from upslope.learners.curve import LearningCurve as LearningCurve
    from upslope.meta_training.config import MetaTrainingConfig as MetaTrainingConfig
    from upslope.meta_training.posteriors import HeadsPosterior as HeadsPosterior
    from upslope.meta_training.posteriors import NetworkPosterior as NetworkPosterior
    from upslope.meta_training.posteriors import TablePosterior as TablePosterior
    from upslope.meta_training.posteriors import TrajectoryPosterior as TrajectoryPosterior
    from upslope.meta_training.posteriors import WeightsPosterior as WeightsPosterior
    from upslope.meta_training.recipes import recipe_for as recipe_for
    from upslope.priors.numpy_potential import NumpyPotential as NumpyPotential
    from upslope.priors.pretrained import load_prior as load_prior
    from upslope.priors.pretrained import prior_path as prior_path
    from upslope.priors.prior import Prior as Prior
    from upslope.results import AdaptationResult as AdaptationResult
    from upslope.results import TrainingResult as TrainingResult
    from upslope.run.checkpoints import Checkpoints as Checkpoints
    from upslope.run.observers import EventLog as EventLog
    from upslope.run.observers import Observer as Observer
    from upslope.run.observers import ProgressBar as ProgressBar
    from upslope.run.session import Session as Session
    from upslope.tasks import AbstractFamily as AbstractFamily
    from upslope.tasks import GymnasiumTasks as GymnasiumTasks
    from upslope.tasks import JaxTasks as JaxTasks
    from upslope.tasks import cartpoles as cartpoles
    from upslope.tasks import clean_maps as clean_maps
    from upslope.tasks import grid_games as grid_games
    from upslope.tasks import gymnax_tasks as gymnax_tasks
    from upslope.tasks import obstacle_maps as obstacle_maps
    from upslope.wrappers import PotentialShaping as PotentialShaping
    from upslope.wrappers import shape as shape

# Names are imported when they are first used: a simulator process that only shapes rewards never imports JAX.
_NAMES = {
    "upslope.adaptation.algorithm2": ("AdaptationConfig", "Algorithm2", "UpdateRule"),
    "upslope.adaptation.controls": ("CentredTD", "FrozenPotential"),
    "upslope.adaptation.fine_tuning": ("FineTuning",),
    "upslope.api": ("adapt", "evaluate", "meta_train", "train"),
    "upslope.checking": ("check_shaping",),
    "upslope.errors": ("PriorWarning", "UpslopeError"),
    "upslope.evaluation.verdict": ("Verdict",),
    "upslope.learners": ("AbstractLearnerConfig", "DDPGConfig", "DQNConfig"),
    "upslope.learners.agent": ("Agent",),
    "upslope.learners.curve": ("LearningCurve",),
    "upslope.meta_training.config": ("MetaTrainingConfig",),
    "upslope.meta_training.posteriors": (
        "HeadsPosterior",
        "NetworkPosterior",
        "TablePosterior",
        "TrajectoryPosterior",
        "WeightsPosterior",
    ),
    "upslope.meta_training.recipes": ("recipe_for",),
    "upslope.priors.numpy_potential": ("NumpyPotential",),
    "upslope.priors.pretrained": ("load_prior", "prior_path"),
    "upslope.priors.prior": ("Prior",),
    "upslope.results": ("AdaptationResult", "TrainingResult"),
    "upslope.run.checkpoints": ("Checkpoints",),
    "upslope.run.observers": ("EventLog", "Observer", "ProgressBar"),
    "upslope.run.session": ("Session",),
    "upslope.tasks": (
        "AbstractFamily",
        "GymnasiumTasks",
        "JaxTasks",
        "cartpoles",
        "clean_maps",
        "grid_games",
        "gymnax_tasks",
        "obstacle_maps",
    ),
    "upslope.wrappers": ("PotentialShaping", "shape"),
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names}

__version__ = version("upslope")
__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'upslope' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__


register_environments()
