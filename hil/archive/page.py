"""A unit's life in words, and with the list of units as pages: self-contained, with pictures, live or as files."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from typing import Any

from hil.archive.trend import LEAST
from hil.files.figure import blank
from hil.files.page import inline_svg, rendered
from procedures.words import first_few

_COLOURS = "viridis"
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


def history_page(document: Mapping[str, Any]) -> str:
    """Return a unit's life, hil.history/1, as one HTML document: no scripts, no other files."""
    title = ", ".join(filter(None, [f"Unit {document['serial']}", document["model"]]))
    pictures = [_picture(each) for each in document["parameters"]]
    view = {**document, "title": title, "sentences": list(sentences(document)), "pictures": pictures}
    return rendered("hil.archive", "history.html.j2", view)


def units_page(rows: Sequence[Mapping[str, Any]], said: Sequence[str], address: str) -> str:
    """Return the list of units, each linked to its own page below `address`."""
    simulated = sum(bool(each["simulated"]) for each in rows)
    view = {"title": "Units of the archive", "simulated": simulated, "units": rows, "said": said, "address": address}
    return rendered("hil.archive", "units.html.j2", view)


def _picture(parameter: Mapping[str, Any]) -> str:
    """Draw one parameter over the calendar, a line for each temperature, the cold ones dark."""
    from matplotlib import colormaps
    from matplotlib.dates import AutoDateLocator

    figure, axes = blank(6.4, 2.6)
    figure.subplots_adjust(top=0.86)
    count = len(parameter["temperatures"])
    fine: Any = {"marker": "o", "markersize": 3, "linewidth": 0.8, "elinewidth": 0.5}
    for place, station in enumerate(parameter["temperatures"]):
        values, at = station["values"], station["temperature_degC"]
        days: Any = [date.fromisoformat(each["day"]) for each in values]
        bars = [0.0 if each["high"] is None else each["high"] - each["value"] for each in values]
        colour = colormaps[_COLOURS](0.85 * place / max(count - 1, 1))
        label = "" if at is None else f"{at:z.0f} °C"
        axes.errorbar(days, [each["value"] for each in values], bars, color=colour, label=label, **fine)
    for key in {"between", "back_between"}.intersection(parameter["jump"] or {}):
        jumped: Any = date.fromisoformat(parameter["jump"][key][1])
        axes.axvline(jumped, color="#D55E00", linestyle=":")
    axes.xaxis.set_major_locator(AutoDateLocator(minticks=2, maxticks=6))  # type: ignore[no-untyped-call]
    name, finding = parameter["parameter"], parameter["finding"]
    axes.set_ylabel(f"{name}, {parameter['unit']}")
    axes.set_title(f"sensor {parameter['sensor']}, {name}: {finding}", loc="left", fontsize=9)
    narrow: Any = {"columnspacing": 0.9, "handlelength": 1.2, "handletextpad": 0.4}
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=min(count, 8), frameon=False, fontsize=6, **narrow)
    figure.subplots_adjust(bottom=0.24)
    return inline_svg(figure, f"Sensor {parameter['sensor']}, {name} over the years: {finding}")
