"""What an experiment is, and how a user's options change its settings or are refused."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from rich.console import Console

from upslope.errors import UpslopeError
from upslope.run.session import Session

PanelName = Literal["left", "middle", "right"]
PANELS: tuple[PanelName, ...] = ("left", "middle", "right")

Settings = TypeVar("Settings")
Results = TypeVar("Results")


@dataclass(frozen=True)
class Options:
    """A user's options; None means the experiment's default.

    Attributes:
        is_quick: run the quick form.
        seeds: the number of seeds.
        tasks: the number of unseen tasks.
        first_seed: an offset of all seeds; it changes the test tasks too.
        panels: panels of a figure.
        iterations: iterations of meta-training.
        priors_of: the folder of another figure, whose priors are used instead of training new ones.
    """

    is_quick: bool = False
    seeds: int | None = None
    tasks: int | None = None
    first_seed: int = 0
    panels: Sequence[PanelName] | None = None
    iterations: int | None = None
    priors_of: Path | None = None


@dataclass(frozen=True)
class Plan(Generic[Settings]):
    """One run of an experiment, with all options applied.

    Attributes:
        settings: the settings of the run.
        panels: the panels of a figure to be made, in the order of the options.
        is_quick: whether this is the quick form.
        trainings: titles of the trainings that another run may already have done.
    """

    settings: Settings
    panels: tuple[PanelName, ...] = ()
    is_quick: bool = False
    trainings: tuple[str, ...] = ()

    def description(self) -> dict[str, Any]:
        """Everything that determines the results, as the folder of the run stores it."""
        settings: Any = self.settings
        return {**({"panels": self.panels} if self.panels else {}), **asdict(settings)}


@dataclass(frozen=True)
class Experiment(Generic[Settings, Results]):
    """One experiment: its settings, how it runs, the files it writes, and its summary.

    Attributes:
        full: makes the full form's settings: a dataclass with ``seeds``, ``tasks`` and ``first_seed``.
        quick: makes the quick form's settings from the full form's.
        run: computes all results; writes only logs and checkpoints.
        write: writes the results into the folder of the run, over earlier files of the same run.
        summarise: prints a summary on a console, when the folder is no longer locked.
        with_iterations: makes the full form's settings for a given number of iterations of meta-training; None if
            that number is fixed.
        panels: the panels of a figure; empty if the experiment is not a figure with panels.
        trainings: titles of the trainings that some panels share with another figure; None if there are none.
        show: writes a picture of incomplete results and prints its path on a console; None if there is nothing to
            show before the end.
    """

    full: Callable[[], Settings]
    quick: Callable[[Settings], Settings]
    run: Callable[[Plan[Settings], Session], Results]
    write: Callable[[Results, Path], None]
    summarise: Callable[[Results, Path, Console], None]
    with_iterations: Callable[[int], Settings] | None = None
    panels: tuple[PanelName, ...] = ()
    trainings: Callable[[Settings, tuple[PanelName, ...]], tuple[str, ...]] | None = None
    show: Callable[[Results, Path, Console], None] | None = None

    def plan(self, name: str, options: Options) -> Plan[Settings]:
        """The run that some options ask for.

        Args:
            name: the name of the experiment in error messages.
            options: the user's options.

        Raises:
            UpslopeError: the experiment does not have an option, or a count is below one.
        """
        self._check(name, options)
        if self.with_iterations is None or options.iterations is None:
            settings: Any = self.full()
        else:
            settings = self.with_iterations(options.iterations)
        settings = self.quick(settings) if options.is_quick else settings
        settings = replace(
            settings,
            # Studies that tune start from their own seeds.
            first_seed=settings.first_seed + options.first_seed,
            seeds=options.seeds or settings.seeds,
            tasks=options.tasks or settings.tasks,
        )
        panels = self.panels if options.panels is None else tuple(options.panels)
        return Plan(settings, panels, options.is_quick, self.trainings(settings, panels) if self.trainings else ())

    def _check(self, name: str, options: Options) -> None:
        if options.iterations is not None and self.with_iterations is None:
            raise UpslopeError(f"{name} has a fixed number of iterations: leave out --iterations.")
        if options.priors_of is not None and self.trainings is None:
            raise UpslopeError(f"{name} takes no priors of another figure: leave out --priors-of.")
        for count in ("seeds", "tasks", "iterations"):
            number = getattr(options, count)
            if number is not None and number < 1:
                raise UpslopeError(f"{number} {count} are too few: give at least 1.")
        if options.panels is None:
            return
        if not self.panels:
            raise UpslopeError(f"{name} has no panels: leave out --panels.")
        unknown = [panel for panel in options.panels if panel not in self.panels]
        if unknown or not options.panels:
            what = f"has no {' and no '.join(unknown)} panel" if unknown else "needs at least one panel"
            raise UpslopeError(f"{name} {what}: choose from {', '.join(self.panels)}.")
