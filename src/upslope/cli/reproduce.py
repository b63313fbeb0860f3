"""``upslope reproduce``: the figures of the paper, and the studies."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg, subcommand

from upslope.errors import UpslopeError
from upslope.experiments.catalogue import reproduce
from upslope.experiments.everything import reproduce_all


@dataclass(frozen=True)
class Reproduce:
    """Reproduce a figure of the paper: the main job."""

    figure: Annotated[Positional[str], arg(metavar="FIGURE")]
    """fig1 to fig5; theorems (the paper's, checked on thousands of maps); all of these; or a study: deviations (the
    effect of each difference from the paper), learners and grid-learners (of the learners' settings), grid-readings (of
    Algorithm 1's on maps), grid-precisions (of fewer bits), step-ratio (of the length of Algorithm 2's second step),
    recipe (of each part of the recipe for any family); or shipped-prior (the prior of the package, with its card)."""
    out: Path | None = None
    """Folder for the results; it must be empty. A new one under runs/ by default."""
    quick: bool = False
    """A minute or two: enough to see that everything works, too small to say anything about the paper."""
    seeds: int | None = None
    """Number of seeds; 5 by default."""
    tasks: int | None = None
    """Number of unseen tasks; 40 by default."""
    first_seed: int = 0
    """The first seed: another one gives other seeds and other test tasks."""
    panels: tuple[Literal["left", "middle", "right"], ...] | None = None
    """Panels of fig1, fig3 or fig5; all by default."""
    iterations: int | None = None
    """Iterations of meta-training, for fig2 to fig5 and both studies of it on maps; fewer make weaker priors."""
    priors_of: Path | None = None
    """Folder of a finished fig2 or fig4, for fig3 and fig5: use its priors instead of training them again."""
    resume: bool = False
    """Continue the run in --out, which was stopped."""

    def __call__(self) -> None:
        if self.figure == "all":
            given = (self.seeds, self.tasks, self.iterations, self.priors_of, self.panels)
            if any(one is not None for one in given):
                raise UpslopeError(
                    "`reproduce all` has its own seeds, tasks, iterations, priors and panels: "
                    "reproduce one figure to change those."
                )
            reproduce_all(out=self.out, is_quick=self.quick, first_seed=self.first_seed, resume=self.resume)
            return
        reproduce(
            self.figure,
            out=self.out,
            is_quick=self.quick,
            seeds=self.seeds,
            tasks=self.tasks,
            first_seed=self.first_seed,
            panels=self.panels,
            iterations=self.iterations,
            priors_of=self.priors_of,
            resume=self.resume,
        )


def command(arguments: Sequence[str]) -> Any:
    """The command's type; it is the same for all arguments."""
    del arguments
    return Annotated[Reproduce, subcommand("reproduce")]
