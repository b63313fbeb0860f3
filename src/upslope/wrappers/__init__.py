"""Shaping for environments of any library that speaks Gymnasium. `upslope.wrappers.vector` has the vector twin."""

from upslope.wrappers.checking import check_shaping
from upslope.wrappers.potential_shaping import PotentialShaping
from upslope.wrappers.shaping_report import ShapingReport

__all__ = ["PotentialShaping", "ShapingReport", "check_shaping"]
