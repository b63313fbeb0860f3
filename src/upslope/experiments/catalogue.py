"""All experiments by name, and how one is reproduced: run, written, drawn and summarised."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from upslope.errors import UpslopeError
from upslope.experiments.experiment import Experiment, Options, PanelName
from upslope.experiments.figures import FIGURE_1, figure_on
from upslope.experiments.maps.prior_studies import priors_study
from upslope.experiments.maps.readings import grid_precisions, grid_priors, grid_readings
from upslope.experiments.poles.shipped_prior import SHIPPED_PRIOR
from upslope.experiments.studies import STUDIES
from upslope.experiments.theorems.study import THEOREMS
from upslope.run.checkpoints import adopt
from upslope.run.folder import claim
from upslope.run.session import session_in

#: By the name that `upslope reproduce` takes: the paper's figures and theorems, then further studies.
EXPERIMENTS: dict[str, Experiment[Any, Any]] = {
    "fig1": FIGURE_1,
    "fig2": priors_study("Figure 2: learned V on clean maps", partial(grid_priors, "clean")),
    "fig3": figure_on("clean"),
    "fig4": priors_study("Figure 4: learned V on maps with obstacles", partial(grid_priors, "obstacles")),
    "fig5": figure_on("obstacles"),
    "grid-precisions": priors_study("Algorithm 1 with fewer bits, on maps with obstacles", grid_precisions),
    "grid-readings": priors_study("Algorithm 1 read in other ways, on maps with obstacles", grid_readings),
    "theorems": THEOREMS,
    "shipped-prior": SHIPPED_PRIOR,
    **STUDIES,
}


def reproduce(
    experiment: str,
    *,
    out: Path | None = None,
    is_quick: bool = False,
    seeds: int | None = None,
    tasks: int | None = None,
    first_seed: int = 0,
    panels: Sequence[PanelName] | None = None,
    iterations: int | None = None,
    priors_of: Path | None = None,
    resume: bool = False,
    console: Console | None = None,
) -> None:
    """Runs an experiment into an empty folder and prints a summary.

    Args:
        experiment: one of `EXPERIMENTS`: a figure of the paper, its theorems, or a study.
        out: the folder; a new one under ``runs/`` if None.
        is_quick: run the quick form.
        seeds: the number of seeds; the experiment's default if None.
        tasks: the number of unseen tasks; the experiment's default if None.
        first_seed: selects other seeds and other test tasks.
        panels: panels of the figure; all of them if None. Figures on maps have no middle panel.
        iterations: iterations of meta-training on maps; the recipe's default if None.
        priors_of: folder of fig2 (for fig3) or fig4 (for fig5), whose priors are used instead of training new ones.
        resume: continue the run in ``out``, which was started with the same settings.
        console: where the summary is printed.

    Raises:
        UpslopeError: the experiment or a panel is unknown, the experiment does not have an option, the folder is not
            empty (or holds no run to resume), or a count is below one.
    """
    if experiment not in EXPERIMENTS:
        raise UpslopeError(f"There is no experiment {experiment!r}: choose one of {', '.join(EXPERIMENTS)} or all.")
    definition = EXPERIMENTS[experiment]
    plan = definition.plan(experiment, Options(is_quick, seeds, tasks, first_seed, panels, iterations, priors_of))
    with claim(out, experiment, plan.description(), resume=resume) as folder:
        if priors_of is not None:
            adopt(plan.trainings, priors_of, folder)
        session = session_in(folder, resume=resume or priors_of is not None, final_states=False)
        if (show := definition.show) is not None:
            progress = Console(stderr=True)  # where progress bars are; the summary at the end goes elsewhere
            session = replace(session, show=lambda results: show(results, folder, progress))
        results = definition.run(plan, session)
        definition.write(results, folder)
    definition.summarise(results, folder, console or Console())
