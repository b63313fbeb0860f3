"""SIGTERM and SIGINT stop a run within seconds in every phase, even while a program compiles.

Python runs its signal handlers between two steps of the interpreter, and compiling or a long chunk is one step of
many seconds. So a watcher thread, woken by the C-level handler, ends the process if a clean stop takes too long.
That loses nothing that is saved: a run always resumes from its last checkpoint.
"""

import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from upslope.errors import InterruptedRunError

#: Seconds from a signal until the process is ended, if the run has not stopped by then.
GRACE = 7.0

_SIGNALS = (signal.SIGTERM, signal.SIGINT)


class StopRequest:
    """A request to stop this process.

    Attributes:
        signal: the number of the signal that arrived; None before that.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._deferred = False

    @contextmanager
    def defer(self) -> Iterator[None]:
        """Inside the ``with`` block a signal only sets `signal`; the code inside checks it and stops where it can."""
        outer, self._deferred = self._deferred, True
        try:
            yield
        finally:
            self._deferred = outer

    def handle(self, number: int, frame: FrameType | None) -> None:
        """The Python-level handler."""
        del frame
        self.signal = number
        if not self._deferred:
            self.stop("Stopped")

    def stop(self, what: str) -> None:
        """Stops the process with an error.

        Raises:
            InterruptedRunError: always.
        """
        number = self.signal or signal.SIGINT
        name = signal.Signals(number).name
        raise InterruptedRunError(f"{what} by {name}. The same command with --resume continues from there.", number)


_current: StopRequest | None = None


@contextmanager
def stop_requests() -> Iterator[StopRequest]:
    """Listens for SIGTERM and SIGINT, and restores the previous handlers at the end.

    A second signal ends the process at once. Inside another such context, or outside the main thread, nothing changes.
    """
    global _current
    if _current is not None or threading.current_thread() is not threading.main_thread():
        yield _current or StopRequest()
        return
    request = _current = StopRequest()
    ours, kernels = socket.socketpair()
    kernels.setblocking(False)
    previous = {number: signal.signal(number, request.handle) for number in _SIGNALS}
    previous_descriptor = signal.set_wakeup_fd(kernels.fileno(), warn_on_full_buffer=False)
    watcher = threading.Thread(target=_watch, args=(ours,), daemon=True)
    watcher.start()
    try:
        yield request
    finally:
        _current = None
        signal.set_wakeup_fd(previous_descriptor)
        for number, handler in previous.items():
            signal.signal(number, handler)
        kernels.send(b"\0")
        watcher.join()
        ours.close()
        kernels.close()


def _watch(wakes: socket.socket) -> None:
    """Ends the process when a stop takes too long, or at a second signal. A zero byte ends the watch."""
    pending: int | None = None
    while True:
        ready, _, _ = select.select([wakes], [], [], GRACE if pending else None)
        for number in wakes.recv(64) if ready else b"":
            if number == 0:
                return
            if number in _SIGNALS:
                if pending:
                    _end(number, "Stopped at once")
                pending = number
        if pending and not ready:
            _end(pending, "Stopped")


def _end(number: int, how: str) -> None:
    """Ends the process without waiting for anything; the kernel releases its locks."""
    show_cursor = "\x1b[?25h" if sys.stderr.isatty() else ""
    text = f"{show_cursor}\n{how} by {signal.Signals(number).name}. The same command with --resume continues from the "
    os.write(2, f"{text}last checkpoint.\n".encode())
    os._exit(128 + number)
