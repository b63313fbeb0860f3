"""What users are told when something is wrong: the cause, and how to mend it."""


class UpslopeError(ValueError):
    """Bad input, told in one sentence that names the cause and the mend.

    The command line prints it and exits with code 2; nothing has been written by then.
    """


class DamagedFileError(UpslopeError):
    """A file that is damaged, cut short, foreign, or of another format than this version reads."""


class NotSavedError(UpslopeError):
    """Something could not be written; what was there before is intact.

    Attributes:
        outcome: of the run that was stopped by it, as far as it came; None outside a run.
    """

    outcome: object = None


class InterruptedRunError(UpslopeError):
    """A run stopped by a signal, to be resumed later.

    Attributes:
        signal: its number.
    """

    def __init__(self, message: str, signal: int):
        super().__init__(message)
        self.signal = signal
