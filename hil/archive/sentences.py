"""What a unit's history says in words, for terminals and pages, from the document hil.history/1."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hil.archive.trend import LEAST
from procedures.words import first_few

_SHOWN = 8  # things of one kind in a sentence; the document has all


def sentences(document: Mapping[str, Any]) -> Iterator[str]:
    """Yield its jumps, what changed in bench or software between calibrations, and when the next is due."""
    for each in document["parameters"]:
        if (jump := each["jump"]) is not None:
            alike = "alike at all temperatures"
            otherwise = "not the same at all temperatures: how it depends on temperature has changed"
            back = f" and back between {' and '.join(jump['back_between'])}" if "back_between" in jump else ""
            yield (
                f"sensor {each['sensor']}, {each['parameter']} jumped by {jump['value']:+.3g} {each['unit']} "
                f"({jump['low']:+.3g} … {jump['high']:+.3g}) between {' and '.join(jump['between'])}{back}, "
                f"{otherwise if each['differs_between_temperatures'] else alike}"
            )
    for campaign in document["campaigns"]:
        if changed := campaign["changed_since_the_last"]:
            shown, left = first_few(changed, _SHOWN)
            yield f"changed by {campaign['began_utc'][:10]}: {'; '.join(shown)}{f' and {left} more' * bool(left)}"
    if 1 < sum(each["used"] for each in document["campaigns"]) < LEAST:
        yield (
            f"drift and jump are told from {LEAST} calibrations on; of two hil report --against says what differs "
            "beyond chance"
        )
    due = document["next_calibration"]
    yield f"next calibration: {due['due'] or 'no date'} ({due['why']})"


def some(lines: Sequence[str]) -> Iterator[str]:
    """Yield the first of many lines, and how many more there are."""
    shown, left = first_few(lines, _SHOWN)
    yield from shown
    if left:
        yield f"… and {left} more: --json has all"
