"""SIGKILL at random moments, and at every named point inside a save: resumed runs end at the same bits."""

import random
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from reliability.processes import Ending, require, resume, work

MILESTONES = (
    "before the temporary file",
    "inside the temporary file",
    "before the file's fsync",
    "before the rename",
    "before the folder's fsync",
    "after the folder's fsync",
)


def uninterrupted(kind: str, folder: Path) -> Ending:
    """The ending of an undisturbed run, with its programs compiled before."""
    require(work(kind, folder / f"{kind}-first").code == 0, f"{kind} does not run at all")
    ending = work(kind, folder / f"{kind}-whole")
    require(ending.code == 0, f"{kind} does not run a second time: {ending.errors}")
    return ending


def at_random_moments(
    folder: Path, whole_run: Callable[[str], Ending], kinds: Sequence[str], count: int, seed: int
) -> dict[str, Any]:
    """Kills ``count`` times; each killed run is resumed, and is killed again or ends.

    A kill counts as one after progress if the run had a newer checkpoint by then than when it was started.
    """
    wholes = {kind: whole_run(kind) for kind in kinds}
    share = [count // len(kinds) + (index < count % len(kinds)) for index in range(len(kinds))]

    def chain(index: int) -> tuple[int, int, int]:
        kind, generator = kinds[index], random.Random(seed * 1000 + index)
        whole, kills, progressed, ended, number = wholes[kind], 0, 0, 0, 0
        lasts = whole.seconds
        while kills < share[index]:
            run = folder / f"{kind}-{number}"
            before = newest_checkpoint(run)
            # Half of a run is start and loading of programs, where there is little to lose.
            ending = resume(kind, run, kill_after=generator.uniform(0.3, 1.2) * lasts)
            if ending.code == 0:
                require(ending.digest == whole.digest, f"{kind} in {run} ended elsewhere after {kills} kills")
                ended, number = ended + 1, number + 1
                lasts = whole.seconds
            else:
                require(ending.code == -9, f"{kind} in {run} ended with {ending.code}: {ending.errors}")
                kills += 1
                if newest_checkpoint(run) != before:
                    progressed += 1
                else:
                    lasts *= 1.2  # else no run would get past its start on a machine that has become slower
        ending = resume(kind, folder / f"{kind}-{number}")
        require(ending.digest == whole.digest, f"{kind} did not come to the same end: {ending.errors}")
        return kills, progressed, ended + 1

    with ThreadPoolExecutor(2) as pool:
        done = list(pool.map(chain, range(len(kinds))))
    return {
        "kills": sum(kills for kills, _, _ in done),
        "of_them_after_progress": sum(progressed for _, progressed, _ in done),
        "runs_resumed_to_the_end": sum(ended for _, _, ended in done),
        "kinds": list(kinds),
    }


def newest_checkpoint(run: Path) -> str | None:
    """The name of a run's newest checkpoint, which contains its update."""
    return max((path.name for path in (run / "checkpoints").rglob("*.safetensors")), default=None)


def inside_saves(folder: Path, whole: Ending, times: int) -> dict[str, Any]:
    """Kills at each milestone of the first few saves of a DQN's run."""
    cases = [(name, nth) for name in MILESTONES for nth in range(1, times + 1)]

    def one(case: tuple[str, int]) -> None:
        name, nth = case
        run = folder / f"inside-{MILESTONES.index(name)}-{nth}"
        # The first file written is the run's description, not a checkpoint.
        ending = work("dqn", run, "--at", name, "--nth", str(nth + 1))
        require(ending.code == -9, f"was not killed {name}: {ending.errors}")
        ending = resume("dqn", run)
        require(ending.digest == whole.digest, f"ended elsewhere after a kill {name}: {ending.errors}")

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(one, cases))
    return {"points": len(MILESTONES), "kills": len(cases), "resumed_to_the_same_sha256": len(cases)}
