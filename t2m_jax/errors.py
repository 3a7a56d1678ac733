"""The exception for mistakes that the user can correct."""


class UserError(ValueError):
    """A mistake that the user can correct.

    The message is one line. It names the file, field or value, says what is wrong, and says what to do.
    """
