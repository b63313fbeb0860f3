"""The command line: upslope reproduce, meta-train, train, adapt, check."""

import sys
from typing import Annotated

import tyro

from upslope.cli.check import Check
from upslope.cli.commands import Adapt, MetaTrain, Reproduce, Train
from upslope.cli.families import recipe_for
from upslope.errors import InterruptedRunError, UpslopeError
from upslope.meta_training.config import MetaTrainingConfig
from upslope.run.compiling import set_up_devices
from upslope.run.signals import stop_requests

Command = Reproduce | MetaTrain | Train | Adapt | Check


def parse(recipe: MetaTrainingConfig | None = None) -> Command:
    """What the command line asks for; a recipe stands in for the defaults of meta-training."""
    meta_training = MetaTrain(config=recipe or MetaTrainingConfig())
    commands = (
        Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
        | Annotated[MetaTrain, tyro.conf.subcommand("meta-train", default=meta_training)]
        | Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Adapt, tyro.conf.subcommand("adapt")]
        | Annotated[Check, tyro.conf.subcommand("check")]
    )
    command = tyro.cli(
        commands,
        prog="upslope",
        description="Meta-learned potentials that shape the reward of every new task of a family.",
        config=(tyro.conf.OmitArgPrefixes,),
    )
    # Which defaults hold is known only once the family is.
    if recipe is None and isinstance(command, MetaTrain) and command.family != "cartpole":
        return parse(recipe_for(command.family))
    return command


def main() -> None:
    """Parses the command line and runs what it asks for; bad input ends in one sentence and exit code 2."""
    set_up_devices()
    try:
        command = parse()
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


if __name__ == "__main__":
    main()
