"""Bad input, in one sentence that says what is wrong, where, and what to do; and records that are damaged."""

from __future__ import annotations


class InputError(Exception):
    """Bad input or usage: exit status 2. Nothing was written.

    The message names the file, and the row, column or key where there is one.
    """


class Damaged(InputError):
    """Records that are not what was written, so that nothing is stated that rests on them: ERROR, exit status 4."""
