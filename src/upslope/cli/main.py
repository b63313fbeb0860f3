"""The command line: upslope reproduce, meta-train, evaluate, train, adapt, check."""

import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any, Union

import tyro

from upslope.cli import adapt, check, evaluate, meta_train, reproduce, train
from upslope.errors import InterruptedRunError, UpslopeError
from upslope.run.compiling import set_up_devices
from upslope.run.signals import stop_requests

#: Each command's type, given its arguments. A new command is one file and one line here.
COMMANDS: dict[str, Callable[[Sequence[str]], Any]] = {
    "reproduce": reproduce.command,
    "meta-train": meta_train.command,
    "evaluate": evaluate.command,
    "train": train.command,
    "adapt": adapt.command,
    "check": check.command,
}


def parse(arguments: Sequence[str]) -> Callable[[], None]:
    """The command that the arguments ask for.

    Raises:
        UpslopeError: a name that is unknown, of a family for example.
        SystemExit: other mistakes, --help and --version.
    """
    if "--version" in arguments[:1]:
        print(f"upslope {version('upslope')}")
        sys.exit(0)
    chosen = arguments[0] if arguments else ""
    commands = tuple(command(arguments[1:] if name == chosen else ()) for name, command in COMMANDS.items())
    command: Any = Union[commands]  # noqa: UP007
    return tyro.cli(
        command,
        args=arguments,
        prog="upslope",
        description="Meta-learned potentials that shape the reward of every new task of a family.",
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.AvoidSubcommands),
    )


def main() -> None:
    """Runs the command line; bad input ends in one sentence and exit code 2."""
    set_up_devices()
    warnings.showwarning = _show
    try:
        command = parse(sys.argv[1:])
        with stop_requests():
            command()
    except InterruptedRunError as stop:
        print(f"upslope: {stop}", file=sys.stderr)
        sys.exit(128 + stop.signal)
    except UpslopeError as error:
        print(f"upslope: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("upslope: stopped.", file=sys.stderr)
        sys.exit(130)


def _show(message: Warning | str, *where: Any, **others: Any) -> None:
    del where, others  # the place in the code is of no use here
    print(f"upslope: warning: {message}", file=sys.stderr)


if __name__ == "__main__":
    main()
