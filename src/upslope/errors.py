"""The one error that users see: what went wrong, and how to mend it."""


class UpslopeError(ValueError):
    """Bad input, told in one sentence that names the cause and the mend.

    The command line prints it and exits with code 2; nothing has been written by then.
    """
