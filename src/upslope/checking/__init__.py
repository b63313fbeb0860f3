"""The checker of reward shaping."""

from upslope.checking.checking import check_shaping
from upslope.checking.shaping_report import ShapingReport

__all__ = ["ShapingReport", "check_shaping"]
