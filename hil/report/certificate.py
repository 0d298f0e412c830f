"""The calibration certificate of one unit's night: what ISO/IEC 17025 asks of one, or why there is none.

    found = certificate(Path("night"), date(2026, 11, 25), unit="0042")
    found.refused       # in sentences: simulated, incomplete, FAIL, an instrument past its date
    found.document      # hil.certificate/1
    found.page()        # HTML, printed on A4

Every number is another command's: means are those of `hil solve`, the uncertainties those of `hil budget` (which are
never smaller than repeats show), the judgement that of `hil.analysis.in_spec`, the records' proof that of `hil verify`.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime
from pathlib import Path
from typing import Any

from hil.analysis.in_spec import InSpec, judge
from hil.analysis.night_verdict import night_verdict
from hil.campaign import Campaign
from hil.config import Bench
from hil.config.limits import load_limits
from hil.config.recorded import bench_of_record, recorded_limits
from hil.design.budget.budget import MeanBudget, budgets_of_means, repeats_of
from hil.design.budget.document import named
from hil.design.budget.scenes import measured_scenes
from hil.errors import InputError
from hil.files.document import picked, plain
from hil.files.numbers import degrees
from hil.files.page import filled, rendered
from hil.records import reading
from hil.records.export import campaign_of_night
from hil.records.ledger import read_head
from hil.records.reader import is_night
from hil.records.status import in_brief, night_status
from hil.records.verify import MISSING, verify_night
from hil.report.content import ReportContent, assumed, gather
from hil.solve.both_sensors import moving_together
from hil.solve.omissions import in_words, what_is_wrong
from hil.solve.temperatures import how_many
from procedures.verdict import NOT_GOOD, Judgement
from procedures.words import listed

K = 2.0
_ONCE = "no temperature was measured twice: what changes from run to run is not known, and in no uncertainty"


@dataclass(frozen=True)
class Certificate:
    """A certificate's `document`, and in sentences why it must not be one."""

    document: Mapping[str, Any]
    refused: Sequence[str]
    in_spec: InSpec | None

    def page(self) -> str:
        """Return it as HTML; where it is refused, as a draft, which every page says."""
        running = f"{'DRAFT ' * bool(self.refused)}Calibration certificate {self.document['number']}"
        told = {"title": running, "whole": True, "in_spec": self.in_spec}
        told["once"] = _ONCE if _ONCE in self.document["assumed"] else ""
        return rendered("hil.report", "certificate.html.j2", {**self.document, **told})


def certificate(
    folder: Path, today: date, unit: str | None = None, customer: str = "", number: str = "", limits: str | None = None
) -> Certificate:
    """Return the certificate of a night's `unit` (a serial number, None: the night's), issued `today` for a `customer`.

    `limits` judge it (without: the night's own), `number` is its own (without: the unit and when its night began).
    Raises `InputError` where the folder holds no night, no collect, or another unit; `Damaged` where the journal is.
    """
    if not is_night(folder):
        raise InputError(f"{folder}: holds no night; a certificate is made of one, whose records prove themselves")
    status, proof = night_status(folder), verify_night(folder)
    campaign = campaign_of_night(folder)
    with reading(folder) as journal:
        night, blocks = journal.night, len(journal.blocks())
        bench, own = bench_of_record(night.configuration), recorded_limits(night.configuration)
    content, serial = gather(campaign), campaign.identity.get("serial", "")
    if unit not in (None, serial):
        raise InputError(f"{folder}: --unit {unit}: the unit of this night is {serial or 'not known'}")
    scenes = measured_scenes(campaign, bench, {each.number: each.shown for each in content.sensors})
    means = {each.number: list(budgets_of_means(scenes[each.number], each.shown)) for each in content.sensors}
    measured = night_verdict(str(status["state"]), content.solutions)
    allowed = own if limits is None else load_limits(limits)
    if allowed is not None:
        layouts = {number: each.conditions.sensor for number, each in campaign.sensors.items()}
        allowed.check(layouts, campaign.identity.get("model", ""))
    shown = {}  # what repeats show with each mean's whole uncertainty; a mean without a budget tells nothing
    for each in content.sensors:
        known = {of.mean.runs: of.values for of in means[each.number]}
        whole = [replace(mean, values=known.get(mean.runs, {})) for mean in each.shown.means]
        shown[each.number] = replace(each.shown, means=whole)
    in_spec = None if allowed is None else judge(allowed, shown, content.solutions, measured)
    began, ended = (datetime.fromisoformat(status[key]) for key in ("began_utc", "last_utc"))
    refused, head = refusals(status, measured, proof, bench, serial, ended.date()), read_head(folder)
    document = {
        "schema": "hil.certificate/1",
        "number": number or f"{serial or 'unknown'}-{began:%Y%m%d-%H%M}",
        "issued": today.isoformat(),
        "simulated": campaign.simulated,
        "draft": bool(refused),
        "refused_because": refused,
        "laboratory": None if bench.laboratory is None else bench.laboratory.model_dump(),
        "customer": customer,
        "unit": {name: campaign.identity.get(name, "") for name in ("model", "serial")},
        "measured_from": began.isoformat(),
        "measured_until": ended.isoformat(),
        "operator": campaign.identity.get("operator", ""),
        "software": dict(night.versions or {}),
        "bench": bench.title or bench.name,
        "measurement": {"verdict": str(measured.verdict), "reason": measured.reason},
        "conditions": list(_conditions(campaign, content)),
        "k": K,
        "results": [
            row for n, of in means.items() for each in of for row in _results(shown[n].where(each.mean), n, each)
        ],
        "budgets": [_annex(shown[n].where(each.mean), n, each) for n, of in means.items() for each in of],
        "traceability": [each.model_dump(mode="json") for each in bench.equipment],
        "in_spec": None if in_spec is None else in_spec.document(),
        "assumed": list(_assumed(campaign, content, means)),
        "records": {
            "folder": folder.resolve().name,
            "journal_head_sha256": head[1] if head else None,
            "journal_entries": head[0] if head else None,
            "configuration_sha256": hashlib.sha256(night.configuration.encode()).hexdigest(),
            "blocks": blocks,
            "blocks_checked": proof["blocks_checked"],
        },
    }
    return Certificate(document, refused, in_spec)


def refusals(
    status: Mapping[str, Any], judged: Judgement, proof: Mapping[str, Any], bench: Bench, serial: str, measured: date
) -> list[str]:
    """Return why no certificate can be made of a night that was measured until the day `measured`."""
    told = {"status": status, "judged": judged, "problems": proof["problems"], "missing": in_brief(status["missing"])}
    known = {"bench": bench, "serial": serial, "measured": measured, "not_good": NOT_GOOD, "lacks": MISSING}
    return filled("hil.report", "refusals.txt.j2", **told, **known).splitlines()


def _results(where: Mapping[str, Any], sensor: int, each: MeanBudget) -> Iterator[dict[str, Any]]:
    for name, value in each.values.items():
        expanded = value.expanded(K)
        # Two digits of an expanded uncertainty are left (GUM 7.2.6).
        decimals = max(0, 1 - math.floor(math.log10(expanded))) if 0.0 < expanded < math.inf else 2
        yield {
            "sensor": sensor,
            **where,
            "parameter": name,
            **picked(value, "value unit runs standard_uncertainty=sd"),
            "unexplained": plain(each.unexplained[each.budget.names.index(name)]),
            "degrees_of_freedom": plain(value.freedom),
            "k": plain(expanded / value.sd) if value.sd > 0.0 else None,
            "expanded_uncertainty": plain(expanded),
            "decimals": decimals,
        }


def _annex(where: Mapping[str, Any], sensor: int, each: MeanBudget) -> dict[str, Any]:
    return {
        "sensor": sensor,
        **where,
        "runs": list(each.mean.runs),
        "repeats_of": dict(zip(each.budget.names, repeats_of(each.budget, each.mean).tolist(), strict=True)),
        "units": dict(zip(each.budget.names, each.budget.units, strict=True)),
        "sources": [
            {"title": title, "parameters": named(each.budget, values)} for title, values in each.shares.items()
        ],
        "unexplained": named(each.budget, each.unexplained),
        "combined": named(each.budget, each.standard),
        "left_out": list(each.scene.left_out),
    }


def _conditions(campaign: Campaign, content: ReportContent) -> Iterator[str]:
    """Yield under what conditions it was measured, a sentence for each sensor, what is wrong, and the site."""
    for each in content.sensors:
        rows, shown = campaign.sensors[each.number], each.shown
        own = [degC for mean in shown.means for degC in mean.unit_degC or ()]
        chamber = rows.conditions.columns.get("chamber_degC")
        air = "" if chamber is None else f", the chamber at {min(chamber):z.1f} … {max(chamber):z.1f} °C"
        inside = f"; inside the unit {min(own):z.1f} … {max(own):z.1f} °C" if own else ""
        durations = dict.fromkeys(f"{of:.6g} s" for of in sorted(rows.conditions.duration_s.tolist()))
        yield (
            f"sensor {each.number}: {how_many(rows.conditions)}{air}{inside}; collects of "
            f"{listed(durations)} at positions {listed(sorted({str(label) for label in rows.conditions.position}))}"
        )
    told = ", ".join(
        f"{name.removesuffix('_deg').replace('_', ' ')} {value:.4g}°" for name, value in campaign.site.items()
    )
    yield from (*in_words(what_is_wrong(campaign)), *moving_together(campaign))
    yield f"site: {told}; 1 g is the local gravity, and the earth's rotation is taken off"


def _assumed(campaign: Campaign, content: ReportContent, means: Mapping[int, Sequence[MeanBudget]]) -> Iterator[str]:
    """Yield what every number rests upon, the budget's sizes that nobody stated for this bench among it."""
    yield from assumed(content)
    every = [each for of in means.values() for each in of]
    usual = {
        share.source.title for each in every for share in each.budget.shares if "default of" in share.source.origin
    }
    if usual:
        yield f"the budget takes usual sizes, not stated for this bench, for {listed(sorted(usual))}"
    if lacking := {title for each in every for title in each.scene.left_out}:
        yield f"how a sensor lay is not on record, so the budget is without {listed(sorted(lacking))}"
    for each in content.sensors:
        told = {mean.mean.runs for mean in means[each.number]}
        for lost in (mean for mean in each.shown.means if mean.runs not in told):
            at = degrees(lost.temperature_degC, each.shown.told_by)
            yield f"sensor {each.number} at {at}: no run has every rate, so none is stated"
    if not any(each.shown.scatter_included for each in content.sensors):
        yield _ONCE
    yield from campaign.notes.splitlines()
