"""Reward shaping for environments: `shape` for any kind, `PotentialShaping` for single Gymnasium environments."""

from upslope.wrappers.dispatch import shape
from upslope.wrappers.potential_shaping import PotentialShaping

__all__ = ["PotentialShaping", "shape"]
