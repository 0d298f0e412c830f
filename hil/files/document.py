"""Documents that commands print: keys that are attributes of an object."""

import math
from collections.abc import Mapping
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
    """Return a value as JSON has it: numbers, text, lists and mappings; null for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
