"""Bad input and usage, whose class stands with the ground of the drivers; and records that are damaged."""

from drivers.errors import InputError as InputError
from drivers.errors import worded as worded


class Damaged(InputError):
    """Records that are not what was written, so that nothing is stated that rests on them: ERROR, exit status 4."""
