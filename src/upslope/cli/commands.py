"""What each command of the command line does: typed settings with a verb."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from rich.console import Console
from rich.table import Table
from tyro.conf import Positional, arg

from upslope.api import adapt, meta_train, train
from upslope.cli.families import Tasks, draw_task
from upslope.errors import UpslopeError
from upslope.experiments.adaptation_panel import RULES
from upslope.experiments.catalogue import reproduce
from upslope.experiments.everything import reproduce_all
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import as_printed
from upslope.priors.prior import Prior
from upslope.run.folder import claim
from upslope.run.session import session_in

AGENTS = {"dqn": False, "ddpg": True}


@dataclass(frozen=True)
class Reproduce:
    """Reproduce a figure of the paper: the main job."""

    figure: Positional[str]
    """fig1 to fig5; theorems (the paper's, checked on thousands of maps); all of these; or a study: deviations (what
    each difference from the paper is worth), learners and grid-learners (what their settings are worth), grid-readings
    (what Algorithm 1's are worth on maps), grid-precisions (what fewer bits do to it), step-ratio (how long Algorithm
    2's second step should be); or shipped-prior (the prior of the package, with its card)."""
    out: Path | None = None
    """Folder for the results; it must be empty. A new one under runs/ by default."""
    quick: bool = False
    """A minute or two: enough to see that all works, too small to say anything about the paper."""
    seeds: int | None = None
    """How many seeds; 5 by default."""
    tasks: int | None = None
    """How many unseen tasks; 40 by default."""
    first_seed: int = 0
    """Moves to other seeds and other test tasks."""
    panels: tuple[Literal["left", "middle", "right"], ...] | None = None
    """Which panels of fig1, fig3 or fig5; all that it has by default."""
    iterations: int | None = None
    """Of meta-training, for fig2 to fig5 and both studies of it on maps; fewer than their own make weaker priors."""
    priors_of: Path | None = None
    """The folder of fig2 or fig4: fig3 and fig5 begin with the same priors, and need not train them again."""
    resume: bool = False
    """Go on with the run in --out, which was stopped."""

    def __call__(self) -> None:
        if self.figure == "all":
            given = (self.seeds, self.tasks, self.iterations, self.priors_of, self.panels)
            if any(one is not None for one in given):
                raise UpslopeError(
                    "All figures come with their own seeds, tasks, iterations and priors, and with all panels: "
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


@dataclass(frozen=True)
class MetaTrain:
    """Algorithm 1: learn a prior over a family of tasks, and save it.

    The defaults are the family's own recipe; those told here are of CartPoles.
    """

    family: Positional[str] = "cartpole"
    """Which family: cartpole, obstacles or clean (the paper's maps), or grid (any others)."""
    out: Path | None = None
    """Folder for the prior and its logs; it must be empty."""
    seed: int = 0
    """Of everything random."""
    printed: bool = False
    """Algorithm 1 to the letter, which collapses; all settings below are ignored then."""
    resume: bool = False
    """Go on with the run in --out, which was stopped."""
    tasks: Annotated[Tasks, arg(name="")] = field(default_factory=Tasks)
    config: Annotated[MetaTrainingConfig, arg(name="")] = field(default_factory=MetaTrainingConfig)

    def __call__(self) -> None:
        family = self.tasks.family(self.family, split="train")
        config = as_printed() if self.printed else self.config
        with claim(self.out, "prior", _settings(self), resume=self.resume) as folder:
            session = session_in(folder, resume=self.resume)
            prior = meta_train(family, seed=self.seed, config=config, session=session)
            path = folder / "prior.safetensors"
            prior.save(path, overwrite=self.resume)
        settings = prior.trained_on.settings
        table = Table("prior", "from iteration", "return on extra training tasks", title="Algorithm 1")
        table.add_row(str(path), str(settings["iteration"]), f"{settings['return_on_training_tasks']:.1f}")
        Console().print(table)


@dataclass(frozen=True)
class Train:
    """Train an agent on one new task, with or without shaping."""

    agent: Positional[str]
    """dqn (discrete actions) or ddpg (continuous actions)."""
    prior: Path | None = None
    """The prior whose V head shapes the rewards; no shaping without one."""
    family: str = "cartpole"
    """Which family the task comes from: cartpole, obstacles, clean or grid; of maps an unseen one."""
    pole: float | None = None
    """Length of the pole in metres; drawn from the family by default."""
    updates: int = 1000
    """Gradient updates."""
    every: int = 100
    """Updates between evaluations."""
    seed: int = 0
    """Of everything random."""
    out: Path | None = None
    """Folder for the logs; it must be empty."""
    resume: bool = False
    """Go on with the run in --out, which was stopped."""
    tasks: Annotated[Tasks, arg(name="")] = field(default_factory=Tasks)

    def __call__(self) -> None:
        if self.agent not in AGENTS:
            raise UpslopeError(f"There is no agent {self.agent!r}: choose one of {', '.join(AGENTS)}.")
        family = self.tasks.family(self.family, continuous=AGENTS[self.agent])
        prior = None if self.prior is None else Prior.load(self.prior)
        if prior is not None:
            prior.check(family)
        task, called = draw_task(family, self.pole, self.seed)
        _check_counts(updates=self.updates, every=self.every)
        with claim(self.out, self.agent, _settings(self), resume=self.resume) as folder:
            outcome = train(
                family,
                task,
                prior,
                updates=self.updates,
                every=self.every,
                seed=self.seed,
                session=session_in(folder, resume=self.resume),
            )
        shaped = "no shaping" if prior is None else f"shaped by {self.prior}"
        _print_returns(
            f"{self.agent} on {called}, {shaped}",
            outcome.updates,
            outcome.reports["return"][0],
        )


@dataclass(frozen=True)
class Adapt:
    """Algorithm 2: adapt a prior to one new task while solving it; or MAML and the controls."""

    prior: Positional[Path]
    """The prior to start from."""
    family: str = "cartpole"
    """Which family the task comes from: cartpole, obstacles, clean or grid; of maps an unseen one."""
    pole: float | None = None
    """Length of the pole in metres; drawn from the family by default."""
    rule: str = "algorithm2"
    """algorithm2, algorithm2_raw, frozen_potential, td_centred, maml or maml_two_steps."""
    updates: int = 20
    """Updates: pairs of Eqs. 8 and 9."""
    step_size: float = 1e-3
    """Alpha."""
    seed: int = 0
    """Of everything random."""
    out: Path | None = None
    """Folder for the posterior and the logs; it must be empty."""
    resume: bool = False
    """Go on with the run in --out, which was stopped."""
    tasks: Annotated[Tasks, arg(name="")] = field(default_factory=Tasks)

    def __call__(self) -> None:
        if self.rule not in RULES:
            raise UpslopeError(f"There is no rule {self.rule!r}: choose one of {', '.join(RULES)}.")
        prior = Prior.load(self.prior)
        family = self.tasks.family(self.family)
        prior.check(family, acting=True)
        task, called = draw_task(family, self.pole, self.seed)
        _check_counts(updates=self.updates)
        with claim(self.out, "adapted", _settings(self), resume=self.resume) as folder:
            posterior, returns = adapt(
                prior,
                family,
                task,
                updates=self.updates,
                step_size=self.step_size,
                rule=RULES[self.rule],
                seed=self.seed,
                session=session_in(folder, resume=self.resume),
            )
            posterior.save(folder / "posterior.safetensors", overwrite=self.resume)
        title = f"{self.rule} on {called}, saved as {folder / 'posterior.safetensors'}"
        _print_returns(title, np.arange(len(returns)), returns)


def _settings(command: Any) -> dict[str, Any]:
    """What decides a command's results: all but where they go, and whether they go on."""
    fields = asdict(command, dict_factory=_with_paths_as_text)
    return {name: value for name, value in fields.items() if name not in ("out", "resume")}


def _with_paths_as_text(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    return {name: str(value) if isinstance(value, Path) else value for name, value in pairs}


def _check_counts(**counts: int) -> None:
    """Before a folder is claimed."""
    for name, count in counts.items():
        if count < 1:
            raise UpslopeError(f"{count} {name} can't be run: give --{name} at least 1.")


def _print_returns(title: str, updates: np.ndarray, returns: np.ndarray) -> None:
    table = Table("updates", "raw greedy return", title=title, title_justify="left")
    for update, value in zip(updates, returns, strict=True):
        table.add_row(str(update), f"{value:.1f}")
    Console().print(table)
