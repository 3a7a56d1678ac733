"""Typed configs: frozen dataclasses, read strictly from YAML and changed from the command line."""


class UserError(ValueError):
    """A mistake the user can mend: one line that names file, field or value and says what to do."""
