"""Many starts in one folder at once: exactly one runs."""

import multiprocessing
import os
import time
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

from reliability.processes import require
from upslope.errors import UpslopeError
from upslope.run.folder import claim


def _start(folder: Path, barrier: Barrier, answers: Any) -> None:
    barrier.wait()
    began = time.monotonic()
    try:
        with claim(folder, "race"):
            answers.put(("won", os.getpid(), time.monotonic() - began))
            time.sleep(5)
    except UpslopeError as error:
        answers.put((str(error), os.getpid(), time.monotonic() - began))
    answers.close()
    answers.join_thread()
    os._exit(0)


def simultaneous(folder: Path, count: int) -> dict[str, Any]:
    """Starts ``count`` processes that claim the same folder at the same moment."""
    context = multiprocessing.get_context("fork")
    barrier, queue = context.Barrier(count), context.Queue()
    starters = [context.Process(target=_start, args=(folder / "run", barrier, queue)) for _ in range(count)]
    for starter in starters:
        starter.start()
    answers = [queue.get(timeout=120) for _ in starters]
    for starter in starters:
        starter.join()
    winners = [answer for answer in answers if answer[0] == "won"]
    require(len(winners) == 1, f"{len(winners)} of {count} starts ran in one folder")
    losers = [answer for answer in answers if answer[0] != "won"]
    named = sum(f"process {winners[0][1]} " in text for text, _, _ in losers)
    require(named == len(losers), f"only {named} of {len(losers)} losers were given the process that holds the folder")
    slowest = max(seconds for _, _, seconds in losers)
    require(slowest < 1, f"a loser took {slowest:.2f} seconds")
    return {"starts": count, "ran": 1, "told_who_holds_it": named, "slowest_loser_in_seconds": round(slowest, 3)}
