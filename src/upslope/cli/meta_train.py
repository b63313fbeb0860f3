"""``upslope meta-train``: Algorithm 1."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from tyro.conf import Positional, arg, subcommand

from upslope.api import meta_train
from upslope.cli.arguments import check_first, first_name, option
from upslope.cli.families import DEFAULT, family_settings
from upslope.cli.runs import settings_of
from upslope.errors import UpslopeError
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import POSTERIORS
from upslope.meta_training.recipes import RECIPES, as_printed, named
from upslope.run.folder import claim
from upslope.run.session import session_in
from upslope.tasks.settings import FAMILIES, AbstractFamilySettings

Settings = TypeVar("Settings", bound=AbstractFamilySettings)

FamilyName = Annotated[
    Positional[str],
    arg(
        metavar="FAMILY",
        help=f"{', '.join(FAMILIES)}, or MODULE:NAME of a family of your own, or of a function that returns one.",
    ),
]
PosteriorName = Annotated[
    str, arg(metavar="NAME", help=f"What of the prior is adapted to each task: {', '.join(POSTERIORS)}.")
]


@dataclass(frozen=True)
class MetaTrain(Generic[Settings]):
    """Algorithm 1: learn a prior over a family of tasks, and save it.

    The options depend on the family and the posterior: see `upslope meta-train FAMILY --posterior NAME --help`.
    """

    family: FamilyName
    tasks: Annotated[Settings, arg(name="")]
    config: Annotated[MetaTrainingConfig, arg(name="")]
    posterior: PosteriorName
    out: Path | None = None
    """Folder for the prior and its logs; it must be empty. A new one under runs/ by default."""
    seed: int = 0
    """Seed of everything random."""
    printed: bool = False
    """Begin with the settings of Algorithm 1 to the letter, which collapses."""
    resume: bool = False
    """Continue the run in --out, which was stopped."""

    def __call__(self) -> None:
        check_first("meta-train", self.family, type(self.tasks) is type(family_settings(self.family)))
        family = self.tasks.build("train")
        with claim(self.out, "prior", settings_of(self), resume=self.resume) as folder:
            session = session_in(folder, resume=self.resume)
            prior = meta_train(family, seed=self.seed, config=self.config, session=session)
            path = folder / "prior.safetensors"
            prior.save(path, overwrite=self.resume)
        settings = prior.trained_on.settings
        print(
            f"The prior of iteration {settings['iteration']} has a mean return of "
            f"{settings['return_on_training_tasks']:.1f} on extra training tasks. It is saved as\n{path}"
        )


def command(arguments: Sequence[str]) -> Any:
    """The command's type for these arguments, with the family's own options and the defaults of its recipe.

    Raises:
        UpslopeError: there is no such family or posterior.
    """
    family = first_name(arguments, FAMILIES, DEFAULT)
    tasks = family_settings(family)
    recipe = family if family in RECIPES else tasks.recipe
    config = as_printed() if "--printed" in arguments else named(recipe, lambda: tasks.build("train"))
    posterior = option(arguments, "posterior", config.posterior.name)
    if posterior not in POSTERIORS:
        raise UpslopeError(f"There is no posterior {posterior!r}: choose one of {', '.join(POSTERIORS)}.")
    if posterior != config.posterior.name:
        other: Any = POSTERIORS[posterior]()
        config = replace(config, posterior=other)
    default = MetaTrain(family, tasks, config, posterior)
    return Annotated[MetaTrain[type(tasks)], subcommand("meta-train", default=default)]  # type: ignore[misc]
