"""Errors for users. Each message names the cause and the fix."""


class UpslopeError(ValueError):
    """Bad input. The message names the cause and the fix in one sentence.

    The command line prints it and exits with code 2, before anything is written.
    """


class PriorWarning(UserWarning):
    """Meta-training ended with a prior that shows signs of trouble: a policy no better than random, or a flat Φ."""


class DamagedFileError(UpslopeError):
    """A file that is damaged, truncated, of another kind, or of a format that this version does not read."""


class NotSavedError(UpslopeError):
    """A file could not be written. Earlier versions of it are intact.

    Attributes:
        outcome: the results so far of the run that it stopped; None outside a run.
    """

    outcome: object = None


class InterruptedRunError(UpslopeError):
    """A run that was stopped by a signal and can be resumed.

    Attributes:
        signal: its number.
    """

    def __init__(self, message: str, signal: int):
        super().__init__(message)
        self.signal = signal
