"""The families on whose training tasks the recipe for any family may be tuned."""

from collections.abc import Callable
from typing import NamedTuple

from upslope.families.acrobots import acrobots
from upslope.families.crossings import crossings
from upslope.families.frozen_lakes import frozen_lakes
from upslope.families.mountain_cars import mountain_cars
from upslope.families.pendulums import pendulums
from upslope.families.point_mazes import point_mazes
from upslope.families.reach import reach
from upslope.tasks import cartpoles
from upslope.tasks.family import AbstractFamily


class Entry(NamedTuple):
    """A family of the suite.

    Attributes:
        build: makes it.
        solved: the return from which on a task counts as solved.
    """

    build: Callable[[], AbstractFamily]
    solved: float


TUNING: dict[str, Entry] = {
    "poles": Entry(cartpoles, 195.0),
    "mountain cars": Entry(mountain_cars, -120.0),
    "acrobots": Entry(acrobots, -100.0),
    "pendulums": Entry(pendulums, -300.0),
    "reach": Entry(reach, 1.0),
    "frozen lakes": Entry(frozen_lakes, 1.0),
    "point mazes": Entry(point_mazes, 1.0),
    "crossings": Entry(crossings, 0.1),
}
