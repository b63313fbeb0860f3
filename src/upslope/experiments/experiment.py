"""What an experiment is, and how what a user asks for changes its settings or is refused."""

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
    """What a user may ask for; None leaves it to the experiment.

    Attributes:
        is_quick: the quick form.
        seeds: how many.
        tasks: how many unseen ones.
        first_seed: how far the seeds are moved; the test tasks move along.
        panels: of a figure.
        iterations: of meta-training.
        priors_of: the folder of another figure, whose priors are taken instead of trained anew.
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
        settings: of the run.
        panels: those of a figure that are made, in the order asked for.
        is_quick: whether this is the quick form.
        trainings: titles of those that another run may have done already.
    """

    settings: Settings
    panels: tuple[PanelName, ...] = ()
    is_quick: bool = False
    trainings: tuple[str, ...] = ()

    def described(self) -> dict[str, Any]:
        """What decides the results, as the folder of the run keeps it."""
        settings: Any = self.settings
        return {**({"panels": self.panels} if self.panels else {}), **asdict(settings)}


@dataclass(frozen=True)
class Experiment(Generic[Settings, Results]):
    """One experiment: settings, a run, its files, and what is said of it at the end.

    Attributes:
        full: makes the full form's settings: a dataclass with ``seeds``, ``tasks`` and ``first_seed``.
        quick: the quick form of them.
        run: computes everything, and writes nothing but logs and checkpoints.
        write: writes the results into the folder of the run, over what is there: that is of the same run.
        tell: sums them up on a console, when the folder is free again.
        with_iterations: makes the full form's settings for so many iterations of meta-training; None where their
            number is fixed.
        panels: that it has; none where it is no figure with panels.
        trainings: titles of those that another figure begins with too, for some panels; None where there are none.
        show: writes a picture of results that are not complete yet, and says on a console where; None where there
            is nothing to be seen before the end.
    """

    full: Callable[[], Settings]
    quick: Callable[[Settings], Settings]
    run: Callable[[Plan[Settings], Session], Results]
    write: Callable[[Results, Path], None]
    tell: Callable[[Results, Path, Console], None]
    with_iterations: Callable[[int], Settings] | None = None
    panels: tuple[PanelName, ...] = ()
    trainings: Callable[[Settings, tuple[PanelName, ...]], tuple[str, ...]] | None = None
    show: Callable[[Results, Path, Console], None] | None = None

    def plan(self, name: str, options: Options) -> Plan[Settings]:
        """What is to be run.

        Args:
            name: what the experiment is called where options are refused.
            options: what was asked for.

        Raises:
            UpslopeError: options that there are none of here, or counts below one.
        """
        self._check(name, options)
        if self.with_iterations is None or options.iterations is None:
            settings: Any = self.full()
        else:
            settings = self.with_iterations(options.iterations)
        settings = self.quick(settings) if options.is_quick else settings
        settings = replace(
            settings,
            # Studies that tune have seeds of their own to start from.
            first_seed=settings.first_seed + options.first_seed,
            seeds=options.seeds or settings.seeds,
            tasks=options.tasks or settings.tasks,
        )
        panels = self.panels if options.panels is None else tuple(options.panels)
        return Plan(settings, panels, options.is_quick, self.trainings(settings, panels) if self.trainings else ())

    def _check(self, name: str, options: Options) -> None:
        if options.iterations is not None and self.with_iterations is None:
            raise UpslopeError(f"{name} has a fixed number of iterations: leave --iterations out.")
        if options.priors_of is not None and self.trainings is None:
            raise UpslopeError(f"{name} takes no priors of another figure: leave --priors-of out.")
        for count in ("seeds", "tasks", "iterations"):
            asked = getattr(options, count)
            if asked is not None and asked < 1:
                raise UpslopeError(f"{asked} {count} make no figure: give at least 1.")
        if options.panels is None:
            return
        if not self.panels:
            raise UpslopeError(f"{name} has no panels to choose among: leave --panels out.")
        lacking = [panel for panel in options.panels if panel not in self.panels]
        if lacking or not options.panels:
            what = f"has no {' and no '.join(lacking)} panel" if lacking else "needs a panel"
            raise UpslopeError(f"{name} {what}: choose among {', '.join(self.panels)}.")
