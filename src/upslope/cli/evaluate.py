"""``upslope evaluate``: a verdict on a prior, with its picture and its numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from tyro.conf import Positional, arg, subcommand

from upslope.api import evaluate
from upslope.cli.arguments import default
from upslope.cli.families import DEFAULT, family_settings
from upslope.cli.meta_train import FamilyName
from upslope.cli.prior_files import prior_file
from upslope.cli.runs import settings_of
from upslope.evaluation.picture import draw
from upslope.priors.prior import Prior
from upslope.run.folder import claim
from upslope.run.session import session_in
from upslope.storage import write_atomically
from upslope.tasks.settings import AbstractFamilySettings

Settings = TypeVar("Settings", bound=AbstractFamilySettings)


@dataclass(frozen=True)
class Evaluate(Generic[Settings]):
    """Find out what a prior is worth: its policy and its potential on fresh tasks, and learners with and without it.

    Writes verdict.json, verdict.png, and the prior with the verdict in its card.
    """

    prior: Annotated[Positional[str], arg(metavar="PRIOR")]
    """File of the prior, or the name of a shipped one."""
    family: FamilyName
    settings: Annotated[Settings, arg(name="")]
    tasks: int = 20
    """Fresh tasks on which policy and potential are measured."""
    learners: int = 10
    """Fresh tasks on which learners are trained; 0 trains none."""
    updates: int = 2000
    """Updates of each learner."""
    seed: int = 0
    """Seed of everything random."""
    out: Path | None = None
    """Folder for the verdict; it must be empty. A new one under runs/ by default."""
    resume: bool = False
    """Continue the run in --out, which was stopped."""

    def __call__(self) -> None:
        prior = Prior.load(prior_file(self.prior))
        family = self.settings.build("test")
        prior.check(family, acting=True)
        with claim(self.out, "verdict", settings_of(self), resume=self.resume) as folder:
            verdict = evaluate(
                prior,
                family,
                tasks=self.tasks,
                learners=self.learners,
                updates=self.updates,
                seed=self.seed,
                session=session_in(folder, resume=self.resume),
            )
            write_atomically(folder / "verdict.json", verdict.to_json().encode())
            draw(verdict, folder / "verdict.png")
            card = prior.trained_on.settings | {"verdict": verdict.sentence}
            path = folder / "prior.safetensors"
            Prior(prior.network, replace(prior.trained_on, settings=card)).save(path, overwrite=self.resume)
        print(f"{verdict}\nPicture, numbers, and the prior with the verdict in its card are in\n{folder}")


def command(arguments: Sequence[str]) -> Any:
    """The command's type for these arguments, with the options of the family.

    Raises:
        UpslopeError: there is no such family.
    """
    positional = [one for one in arguments[:2] if not one.startswith("-")]
    settings = family_settings(positional[1] if len(positional) == 2 else DEFAULT)
    return Annotated[Evaluate[default(settings)], subcommand("evaluate")]  # type: ignore[misc]
