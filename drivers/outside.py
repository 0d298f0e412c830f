"""What other installed distributions bring, under entry points: chambers, positioners, effects, frame descriptions.

And libraries that only some need: loaded where they are used, and a sentence where they are absent.

Names are known without loading anything: what is broken is told to who asks for it, and to nobody else.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from drivers.errors import InputError

Entry = TypeVar("Entry")


@cache
def brought(group: str) -> Mapping[str, EntryPoint]:
    """Return the entry points of a group, by name; raise `InputError` where two distributions bring one name."""
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        other = found.setdefault(point.name, point)
        if other.value != point.value:
            raise InputError(
                f"{point.name}: both {_whose(other)} and {_whose(point)} bring it as {group}; uninstall one"
            )
    return found


def loaded(point: EntryPoint) -> Any:
    """Return what an entry point names; raise `InputError`, which names its distribution, where it cannot be loaded."""
    try:
        return point.load()
    except Exception as error:  # whatever somebody else's code may raise
        raise InputError(
            f"{point.name}: {_whose(point)} brings it ({point.group}: {point.value}), and it cannot be loaded: "
            f"{type(error).__name__}: {error}"
        ) from error


def _whose(point: EntryPoint) -> str:
    return "a distribution" if point.dist is None else f"{point.dist.name} {point.dist.version}"


class Catalogue(Mapping[str, Entry], Generic[Entry]):
    """What ships, by name, and what other distributions bring, which `made` turns into the same; ours win."""

    def __init__(self, group: str, shipped: Mapping[str, Entry], made: Callable[[Any], Entry]) -> None:
        self._group, self._made = group, made
        self._known = dict(shipped)

    def __getitem__(self, name: str) -> Entry:
        if name not in self._known and name in brought(self._group):
            self._known[name] = self._made(loaded(brought(self._group)[name]))
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter({**self._known, **brought(self._group)})

    def __len__(self) -> int:
        return sum(1 for _ in self)


def library(name: str, extra: str) -> Any:
    """Return the module `name`; raise `InputError` saying which `extra` of hil brings it where it is absent."""
    try:
        return import_module(name)
    except ImportError:
        raise InputError(f"this needs {name}, which is not installed: pip install 'hil[{extra}]' brings it") from None
