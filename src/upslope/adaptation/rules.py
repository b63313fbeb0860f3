"""The rules of adaptation by name, and the settings that suit a family."""

from collections.abc import Callable

from upslope.adaptation.algorithm2 import AdaptationConfig, Algorithm2, UpdateRule, for_maps
from upslope.adaptation.controls import CentredTD, FrozenPotential
from upslope.adaptation.fine_tuning import FineTuning
from upslope.tasks.family import AbstractFamily

#: Rules by their names on the command line and in figures. A new rule is one class and one line here.
RULES: dict[str, UpdateRule] = {
    "algorithm2": Algorithm2(centred=True),
    "algorithm2_raw": Algorithm2(centred=False),
    "frozen_potential": FrozenPotential(),
    "td_centred": CentredTD(),
    "maml": FineTuning(steps=1),
    "maml_two_steps": FineTuning(steps=2),
}

#: Settings by the ``recipe`` of a family.
RECIPES: dict[str, Callable[[], AdaptationConfig]] = {
    "poles": AdaptationConfig,
    "vectors": AdaptationConfig,
    "images": for_maps,
    "maps": for_maps,
}


def suited_to(family: AbstractFamily) -> AdaptationConfig:
    """The settings for a family's recipe."""
    return RECIPES[family.recipe]()
