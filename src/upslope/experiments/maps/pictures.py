"""Pictures of Figures 2 and 4: one unseen map with the learned V and V*, and a sheet of many, from worst to best."""

from pathlib import Path

import numpy as np

from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.maps.plots import draw_one, draw_sheet, learned_maps, spread_by_rank
from upslope.experiments.maps.priors import families
from upslope.experiments.maps.readings import GridPriorsConfig
from upslope.planning.measures import truths
from upslope.priors.prior import Prior

SHEET_SIZE = 24


def draw_map_figures(config: GridPriorsConfig, prior: Prior, folder: Path) -> None:
    """Writes map.png with the first unseen map, sheet.png with maps evenly from the worst to the best, and PDFs."""
    family, unseen = families(config.maps)
    maps = unseen.sample_many(key_for(config.first_seed, Purpose.TEST_TASKS), config.tasks)
    learned = learned_maps(family.env, truths(family.env, maps, family.gamma), maps, prior.network, family.max_steps)
    draw_one(learned[0], folder / "map.png")
    selection = spread_by_rank(np.array([one.measures.rank_correlation for one in learned]), SHEET_SIZE)
    draw_sheet([learned[index] for index in selection], folder / "sheet.png")
