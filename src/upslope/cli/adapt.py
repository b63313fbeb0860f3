"""``upslope adapt``: Algorithm 2, MAML and the controls on one task."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from tyro.conf import Positional, arg, subcommand

from upslope.adaptation.algorithm2 import AdaptationConfig
from upslope.adaptation.rules import RECIPES, RULES
from upslope.api import adapt, check_step_size
from upslope.cli.arguments import default, option
from upslope.cli.families import DEFAULT, FamilyName, family_settings
from upslope.cli.prior_files import prior_file
from upslope.cli.runs import check_counts, print_returns, settings_of
from upslope.errors import UpslopeError
from upslope.priors.prior import Prior
from upslope.run.folder import claim
from upslope.run.session import session_in
from upslope.tasks.settings import AbstractFamilySettings, AbstractTaskChoice

Settings = TypeVar("Settings", bound=AbstractFamilySettings)
Choice = TypeVar("Choice", bound=AbstractTaskChoice)
Config = TypeVar("Config", bound=AdaptationConfig)


@dataclass(frozen=True)
class Adapt(Generic[Settings, Choice, Config]):
    """Algorithm 2: adapt a prior to one new task while solving it; or MAML and the controls.

    The options depend on the family: see `upslope adapt --family FAMILY --help`.
    """

    prior: Annotated[Positional[str], arg(metavar="PRIOR")]
    """File of the prior to start from, or the name of a shipped one."""
    tasks: Annotated[Settings, arg(name="")]
    task: Annotated[Choice, arg(name="")]
    config: Annotated[Config, arg(name="")]
    family: FamilyName = DEFAULT
    rule: Annotated[str, arg(metavar="RULE", help=f"{', '.join(RULES)}.")] = "algorithm2"
    updates: int = 20
    """Updates: pairs of Eqs. 8 and 9."""
    step_size: float = 1e-3
    """Alpha."""
    seed: int = 0
    """Seed of everything random."""
    out: Path | None = None
    """Folder for the posterior and the logs; it must be empty. A new one under runs/ by default."""
    resume: bool = False
    """Continue the run in --out, which was stopped."""

    def __call__(self) -> None:
        if self.rule not in RULES:
            raise UpslopeError(f"There is no rule {self.rule!r}: choose one of {', '.join(RULES)}.")
        prior = Prior.load(prior_file(self.prior))
        family = self.tasks.build("test")
        prior.check(family, acting=True)
        task, description = self.task.task(family, self.seed)
        check_counts(updates=self.updates)
        check_step_size(self.step_size)
        with claim(self.out, "adapted", settings_of(self), resume=self.resume) as folder:
            result = adapt(
                family,
                task,
                prior,
                updates=self.updates,
                step_size=self.step_size,
                rule=RULES[self.rule],
                seed=self.seed,
                config=self.config,
                session=session_in(folder, resume=self.resume),
            )
            path = folder / "posterior.safetensors"
            result.posterior.save(path, overwrite=self.resume)
        print_returns(f"{self.rule} on {description}", result.curve)
        print(f"The posterior is saved as\n{path}")


def command(arguments: Sequence[str]) -> Any:
    """The command's type for these arguments, with the options of the family and its tasks.

    Raises:
        UpslopeError: there is no such family.
    """
    family = option(arguments, "family", DEFAULT)
    tasks = family_settings(family)
    config = RECIPES[tasks.recipe]()
    form: Any = Adapt[default(tasks), default(tasks.task_choice()), default(config)]  # type: ignore[misc]
    return Annotated[form, subcommand("adapt")]
