"""Shaping for environments of any library that speaks Gymnasium. `upslope.wrappers.vector` has the vector twin."""

from upslope.wrappers.potential_shaping import PotentialShaping

__all__ = ["PotentialShaping"]
