"""``upslope train``: an agent on one task, with or without shaping."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from tyro.conf import Positional, arg, subcommand

from upslope.api import train
from upslope.cli.arguments import check_first, default, first_name, option
from upslope.cli.families import DEFAULT, FamilyName, family_settings
from upslope.cli.prior_files import prior_file
from upslope.cli.runs import check_counts, print_returns, settings_of
from upslope.errors import UpslopeError
from upslope.learners import LEARNERS, AbstractLearnerConfig
from upslope.priors.prior import Prior
from upslope.run.folder import claim
from upslope.run.session import session_in
from upslope.tasks.settings import AbstractFamilySettings, AbstractTaskChoice

Settings = TypeVar("Settings", bound=AbstractFamilySettings)
Choice = TypeVar("Choice", bound=AbstractTaskChoice)
Config = TypeVar("Config", bound=AbstractLearnerConfig)

LearnerName = Annotated[
    Positional[str],
    arg(
        metavar="LEARNER",
        help=f"{', '.join(f'{name} ({config.actions} actions)' for name, config in LEARNERS.items())}.",
    ),
]


@dataclass(frozen=True)
class Train(Generic[Settings, Choice, Config]):
    """Train an agent on one new task, with or without shaping, and save it.

    The options depend on the learner and the family: see `upslope train LEARNER --family FAMILY --help`.
    """

    learner: LearnerName
    tasks: Annotated[Settings, arg(name="")]
    task: Annotated[Choice, arg(name="")]
    config: Annotated[Config, arg(name="")]
    family: FamilyName = DEFAULT
    prior: str | None = None
    """File of the prior whose V head shapes the rewards, or the name of a shipped one; no shaping by default."""
    updates: int = 1000
    """Gradient updates."""
    every: int = 100
    """Updates between evaluations."""
    seed: int = 0
    """Seed of everything random."""
    out: Path | None = None
    """Folder for the agent and the logs; it must be empty. A new one under runs/ by default."""
    resume: bool = False
    """Continue the run in --out, which was stopped."""

    def __call__(self) -> None:
        check_first("train", self.learner, self.learner == self.config.name)
        family = self.tasks.build("test", actions=self.config.actions)
        self.config.check_actions(family)
        prior = None if self.prior is None else Prior.load(prior_file(self.prior))
        if prior is not None:
            prior.check(family)
        task, description = self.task.task(family, self.seed)
        check_counts(updates=self.updates, every=self.every)
        with claim(self.out, self.learner, settings_of(self), resume=self.resume) as folder:
            result = train(
                family,
                task,
                prior,
                updates=self.updates,
                every=self.every,
                seed=self.seed,
                config=self.config,
                session=session_in(folder, resume=self.resume),
            )
            path = folder / "agent.safetensors"
            result.agent.save(path, overwrite=self.resume)
        shaping = "no shaping" if prior is None else f"shaped by {self.prior}"
        print_returns(f"{self.learner} on {description}, {shaping}", result.curve)
        print(f"The agent is saved as\n{path}")


def command(arguments: Sequence[str]) -> Any:
    """The command's type for these arguments, with the options of the learner, the family and its tasks.

    Raises:
        UpslopeError: there is no such learner or family.
    """
    learner = first_name(arguments, LEARNERS, next(iter(LEARNERS)))
    if learner not in LEARNERS:
        raise UpslopeError(f"There is no learner {learner!r}: choose one of {', '.join(LEARNERS)}.")
    family = option(arguments, "family", DEFAULT)
    tasks = family_settings(family)
    config = LEARNERS[learner].for_recipe(tasks.recipe)
    updates = option(arguments, "updates", "")
    if updates.isdigit():
        config = config.lasting(int(updates))
    form: Any = Train[default(tasks), default(tasks.task_choice()), default(config)]  # type: ignore[misc]
    return Annotated[form, subcommand("train")]
