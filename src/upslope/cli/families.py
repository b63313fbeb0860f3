"""Families on the command line: the named ones, with their settings, and the user's own as MODULE:NAME."""

from dataclasses import dataclass
from functools import cache
from typing import Annotated, ClassVar

from tyro.conf import Fixed, Suppress, arg

from upslope.cli.places import call, find, is_place
from upslope.errors import UpslopeError
from upslope.tasks.family import AbstractFamily
from upslope.tasks.grid_maps import Split
from upslope.tasks.settings import FAMILIES, AbstractFamilySettings, AbstractTaskChoice, RandomTask

DEFAULT = "cartpole"

#: Of the commands that work on one task.
FamilyName = Annotated[
    str,
    arg(metavar="FAMILY", help=f"Family of the task: {', '.join(FAMILIES)}, or MODULE:NAME. Maps are unseen ones."),
]


@dataclass(frozen=True)
class ImportedFamily(AbstractFamilySettings):
    """A family of the user's. It has no settings on the command line.

    Attributes:
        place: MODULE:NAME of the family, or of a function that returns it.
    """

    task_choice: ClassVar[type[AbstractTaskChoice]] = RandomTask

    place: Suppress[Fixed[str]]

    @property
    def recipe(self) -> str:  # type: ignore[override]
        """The family's own."""
        return self.build().recipe

    def build(self, split: Split = "all", *, actions: str = "discrete") -> AbstractFamily:
        del split, actions
        return import_family(self.place)


def family_settings(name: str) -> AbstractFamilySettings:
    """The default settings of a family.

    Args:
        name: in `FAMILIES`, or MODULE:NAME.

    Raises:
        UpslopeError: there is no such family.
    """
    if is_place(name):
        import_family(name)
        return ImportedFamily(name)
    if name not in FAMILIES:
        raise UpslopeError(
            f"There is no family {name!r}: choose one of {', '.join(FAMILIES)}, or give your own as MODULE:NAME."
        )
    return FAMILIES[name]()


@cache
def import_family(place: str) -> AbstractFamily:
    """The family at MODULE:NAME, or the one that the function there returns.

    Raises:
        UpslopeError: it can't be imported, or is not a family.
    """
    family = find(place)
    if not isinstance(family, AbstractFamily) and callable(family):
        family = call(place)
    if not isinstance(family, AbstractFamily):
        raise UpslopeError(
            f"{place} is {type(family).__name__}, but must be a family, such as upslope.GymnasiumTasks(...), "
            "or a function that returns one."
        )
    return family
