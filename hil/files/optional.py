"""Libraries that only some need: loaded where they are used, and a sentence where they are absent."""

from importlib import import_module
from typing import Any

from hil.errors import InputError


def library(name: str, extra: str) -> Any:
    """Return the module `name`; raise `InputError` saying which `extra` of hil brings it where it is absent."""
    try:
        return import_module(name)
    except ImportError:
        raise InputError(f"this needs {name}, which is not installed: pip install 'hil[{extra}]' brings it") from None
