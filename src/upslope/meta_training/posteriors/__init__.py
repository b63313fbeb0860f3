"""Task-posteriors: what of θ each task adapts. A new one is one file, and one line here."""

from upslope.meta_training.posteriors.heads import HeadsPosterior
from upslope.meta_training.posteriors.network import NetworkPosterior
from upslope.meta_training.posteriors.posterior import AbstractPosterior
from upslope.meta_training.posteriors.table import TablePosterior
from upslope.meta_training.posteriors.trajectories import TrajectoryPosterior
from upslope.meta_training.posteriors.weights import WeightsPosterior

POSTERIORS: dict[str, type[AbstractPosterior]] = {
    posterior.name: posterior
    for posterior in (NetworkPosterior, TrajectoryPosterior, TablePosterior, HeadsPosterior, WeightsPosterior)
}

__all__ = [
    "POSTERIORS",
    "AbstractPosterior",
    "HeadsPosterior",
    "NetworkPosterior",
    "TablePosterior",
    "TrajectoryPosterior",
    "WeightsPosterior",
]
