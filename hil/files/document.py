"""Documents that commands print: keys that are attributes of an object."""

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any


def picked(of: object, *names: str, **more: Any) -> dict[str, Any]:
    """Return attributes of an object as a document's keys, in the order of `names`, then `more`.

    `key=attribute` is a key of another name. Arrays and tuples become lists; a number that is not finite is null.

    >>> picked(complex(1.5, math.inf), "real size=imag", unit="V")
    {'real': 1.5, 'size': None, 'unit': 'V'}
    """
    pairs = (name.partition("=") for each in names for name in each.split())
    return {key: plain(getattr(of, attribute or key)) for key, _, attribute in pairs} | more


def plain(value: Any) -> Any:
    """Return a value as JSON has it: numbers, text, lists and mappings; null for a number that is not finite.

    What JSON has not is its text: evidence is written when something has gone wrong, and better so than not at all.
    """
    if value is None or isinstance(value, str | int):
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(plain(key)): plain(item) for key, item in value.items()}
    if isinstance(value, Sequence | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, datetime):
        return value.isoformat()
    return str(value) if isinstance(value, Path | BaseException) else repr(value)
