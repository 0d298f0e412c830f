"""What a screening found, for people and programs: the document hil.fleet/1, a table of the units, and one page."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import date
from typing import Any

from hil.files.columns import rows_as_csv
from hil.files.document import picked
from hil.files.figure import LOOKS, blank
from hil.files.page import inline_svg, rendered
from hil.model.effects.prior import ALPHA
from hil.reconcile.campaigns import Screened, ScreenedUnit
from hil.reconcile.fleet import SharedFinding, UnitFinding
from hil.solve.omissions import in_words
from procedures.words import counted, first_few, listed, numbered, percent

_MOST_WRONG = 5  # of which it is said what is left out
_NUMBER = re.compile(r"(\d+)\D*$")


def fleet_document(found: Screened) -> dict[str, Any]:
    """Return the document hil.fleet/1: finite numbers, null where a thing is not known."""
    return {
        "schema": "hil.fleet/1",
        "model": found.model,
        "simulated": any(each.simulated for each in found.units),
        "level": ALPHA,
        "units": [_row(each) | _rivals(each.finding) | dict(each.wrong) for each in found.units],
        "effects": list(_effects(found.units)),
        "shared": [
            {
                "layout_number": number,
                **picked(each, "id=name probability=share p_value fraction values_follow_temperature=follows"),
                **_rivals(each),
            }
            for number, each in found.shared
        ],
        "not_screened": [{"folder": folder, "reason": why} for folder, why in found.not_screened.items()],
        "said": list(found.said),
    }


def fleet_csv(found: Screened) -> str:
    """Return the units as CSV, the likeliest to lack something first."""
    return rows_as_csv([_row(each) for each in found.units])


def fleet_page(found: Screened) -> str:
    """Return the page as one HTML document: no scripts, no other files."""
    worth, quiet = ([each for each in found.units if each.worth is so] for so in (True, False))
    view = {
        "title": f"{_counted(found.units)} screened: what the model lacks",
        "simulated": sum(each.simulated for each in found.units),
        "found": found,
        "worth": worth,
        "quiet": quiet,
        "sentences": list(fleet_sentences(found)),
        "shared": _shared(found),
        "failed": any(each.runs_failed for each in found.units),
        "pictures": list(_pictures(found.units, worth)) if worth else [],
    }
    return rendered("hil.reconcile.outcome", "fleet.html.j2", view)


def fleet_sentences(found: Screened) -> Iterator[str]:
    """Yield what was found in a screenful: how many units, which effects, what many have in common."""
    worth, shared = [each for each in found.units if each.worth], _shared(found)
    called = f": of those called, at most {ALPHA:.0%} on average lack nothing"
    beside = sorted({number for number, _ in shared} - {each.layout for each in worth})
    alone = "by themselves" if len(worth) > 1 else "by itself"
    few = f" {alone}; any few of {numbered('layout', beside)} do, for what its units share" if beside else ""
    yield (
        f"{len(worth) or 'none'} of {_counted(found.units)} deserve{'s' * (len(worth) < 2)} a full hil reconcile"
        f"{called * bool(worth)}{few}"
    )
    which = ", which of them is not certain"
    for led, own in _by_names(worth):
        yield f"{' or '.join(led)} leads in {_counted(own)}{which * (len(led) > 1)}"
    for number, each in shared:
        own = [unit for unit in found.units if unit.layout == number]
        names = [f"{name} ({percent(share)})" for name, share in ((each.name, each.share), *each.rivals)]
        few, unsure = f"{each.few:.0%} to " * (each.few < each.fraction), which * (len(names) > 1)
        yield (
            f"layout {number}: its {_counted(own)} together seem to lack {' or '.join(names)}{unsure}, "
            f"p = {each.p_value:.1g}, most probably {few}{each.fraction:.0%} of them"
        )
    if bad := [f"{each.folder} ({numbered('run', runs)})" for each in found.units if (runs := each.runs_in_use)]:
        yield f"FAIL by what was recorded, and screened all the same: {listed(bad)}; hil solve says why"
    wrong = [(each.folder, lines) for each in found.units if (lines := in_words(each.wrong))]
    shown, left = first_few(wrong, _MOST_WRONG)
    yield from (f"{folder}: {line}" for folder, lines in shown for line in lines)
    if left:
        yield f"and of {counted(left, 'calibration')} more: --json has all"
    yield from _warnings(found.units)
    yield (
        "a screen asks for one thing that moves averages, by noise as it is without that; a full hil reconcile looks "
        "at the noise anew beside it, and asks what only scatters averages; hil solve whether rows and runs are good"
    )
    if follow := [number for number, each in found.shared if each.follows]:
        some = f"{numbered('layout', follow)}: " if len(follow) < len(found.shared) else ""
        yield (
            f"{some}screened beside values of {found.model} that follow temperature: that they do is no finding here, "
            "and a full hil reconcile may give it a name"
        )
    if found.not_screened:
        yield f"{counted(len(found.not_screened), 'campaign')} could not be screened"


def _warnings(units: Sequence[ScreenedUnit]) -> Iterator[str]:
    """Yield what reading the folders warned of, once of all that it was said of."""
    said: dict[str, list[str]] = {}
    for each in units:
        for warning in each.wrong.get("warnings", ()):
            said.setdefault(warning.removeprefix(f"{each.folder}/"), []).append(each.folder)
    shown, left = first_few([*said.items()], _MOST_WRONG)
    yield from (f"{listed(folders, 1)}: warning: {warning}" for warning, folders in shown)
    if left:
        yield f"and {counted(left, 'more warning')}: --json has all"


def _counted(units: Sequence[ScreenedUnit]) -> str:
    """Say how many there are: units, or calibrations of fewer units, as far as serial numbers tell."""
    known = len({each.serial or each.folder for each in units})
    same = known == len(units)
    return counted(known, "unit") if same else f"{counted(len(units), 'calibration')} of {counted(known, 'unit')}"


def _shared(found: Screened) -> list[tuple[int, Any]]:
    """Return what the calibrations of a layout share, by its number: one alone has nothing in common."""
    several = {number for number, count in Counter(each.layout for each in found.units).items() if count > 1}
    return [(number, each) for number, each in found.shared if each.p_value < ALPHA and number in several]


def _row(each: ScreenedUnit) -> dict[str, Any]:
    return {
        **picked(each, "folder title serial runs_failed", date=each.date or None),
        **picked(each, "simulated layout_number=layout"),
        **picked(each.finding, "log_odds=statistic p_value q_value leader probability=share", worth=each.worth),
    }


def _rivals(finding: UnitFinding | SharedFinding) -> dict[str, Any]:
    return {"rivals": [{"id": name, "probability": share} for name, share in finding.rivals]}


def _by_names(units: Sequence[ScreenedUnit]) -> list[tuple[tuple[str, ...], list[ScreenedUnit]]]:
    """Return the units that are called by what leads in them, or may, the commonest first."""
    called = [each for each in units if each.worth]
    counts = Counter(each.finding.names for each in called)
    ordered = sorted(counts, key=lambda names: (-counts[names], names))
    return [(names, [each for each in called if each.finding.names == names]) for names in ordered]


def _effects(units: Sequence[ScreenedUnit]) -> Iterator[dict[str, Any]]:
    """Yield each effect that leads, or may, in units that are called, the commonest first, with serial numbers."""
    called = [each for each in units if each.worth]
    counts = Counter(name for each in called for name in each.finding.names)
    for name in sorted(counts, key=lambda name: (-counts[name], name)):
        serials = sorted(each.serial for each in called if name in each.finding.names)
        certain = sum(each.finding.names == (name,) for each in called)
        yield {"id": name, "count": counts[name], "certain": certain, "serials": serials}


def _pictures(units: Sequence[ScreenedUnit], worth: Sequence[ScreenedUnit]) -> Iterator[str]:
    """Yield which effect leads in how many units, then the odds of every unit by date and by serial number."""
    effects = [(" or ".join(names), own) for names, own in _by_names(worth)]
    figure, axes = blank(6.4, 1.1 + 0.28 * len(effects))
    # Room for the longest name, in shares of the width.
    figure.subplots_adjust(left=min(0.6, 0.05 + 0.0125 * max((len(name) for name, _ in effects), default=0)), top=0.95)
    axes.barh([name for name, _ in effects][::-1], [len(own) for _, own in effects][::-1], color="#0072B2")
    axes.set_xlabel("units that are called")
    yield inline_svg(figure, f"Units by effect: {', '.join(f'{name} {len(own)}' for name, own in effects)}")
    looks = dict(zip([name for name, _ in effects], LOOKS.values(), strict=False))
    dated = {each.folder: date.fromisoformat(each.date).toordinal() for each in units if each.date}
    numbered = {each.folder: int(of[1]) for each in units if (of := _NUMBER.search(each.serial))}
    for places, what in ((dated, "date"), (numbered, "serial number")):
        if len(set(places.values())) > 1:
            yield _over(units, places, what, looks)


def _over(units: Sequence[ScreenedUnit], places: dict[str, int], what: str, looks: dict[str, Any]) -> str:
    figure, axes = blank(6.4, 3.0)
    figure.subplots_adjust(top=0.85)
    here = [each for each in units if each.folder in places]
    groups: list[tuple[str, list[ScreenedUnit], dict[str, Any]]] = [
        ("not called", [e for e in here if not e.worth], {"color": "0.75", "marker": "."})
    ]
    called = [(" or ".join(e.finding.names), e) for e in here if e.worth]
    groups += [(name, [e for own, e in called if own == name], look) for name, look in looks.items()]
    groups.append(("others", [e for own, e in called if own not in looks], {"color": "0.45", "marker": "."}))
    for name, own, look in groups:
        if own:
            x, y = [places[e.folder] for e in own], [e.finding.statistic for e in own]
            axes.plot(x, y, label=name, **(look | {"linestyle": "none", "markersize": 4}))
    if what == "date":
        ticks = sorted(set(places.values()))
        ticks = ticks[:: max(1, len(ticks) // 5)]
        axes.set_xticks(ticks, [date.fromordinal(each).isoformat() for each in ticks])
    axes.set_xlabel(what)
    axes.set_ylabel("log odds of anything missing")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False)
    return inline_svg(figure, f"Log odds that anything is missing from each unit, by {what}")
