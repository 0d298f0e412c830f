"""Nights whose records contradict themselves, each through bytes and the whole path, and what is said of them.

    python -m benchmarks.reliability.contradictions              # every case once, one JSON document
    python -m benchmarks.reliability.contradictions --clean 1000 # nights with nothing wrong: is any word said?

A case is a bench file, a sweep and what stands between the simulated unit's physics and its bytes. It is *caught* where
no verdict over the night is PASS, and *named* where what is said (by the check before, the night's end, the events, or
the report) matches the case's own words for its cause.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.reliability.contradicted import Case, cases
from drivers.imu.samples import FloatArray
from hil.analysis.against import Comparison
from hil.bench import LiveBench
from hil.bench.at_rest import at_rest
from hil.campaign.reader import read_campaign
from hil.config import Bench, Sweep, load_bench, parse_bench, parse_sweep
from hil.errors import InputError
from hil.night import start_night
from hil.records import open_readonly
from hil.records.export import campaign_of_night, export_campaign
from hil.report.content import gather, good
from procedures.attended import Terminal
from procedures.collect import join
from procedures.verdict import Verdict

SAID = (
    "lies as in|accelerometer|belong, as in|very same samples|not being measured|did not change|clipped|shows only|"
    "renewed|from the others|other runs|thermometer|belongs by|samples: the unit sends|one body|"
    "not measured well enough|NOT|S/N|jump"
)
"""What is said of contradictions; residuals beyond 5 % of chance are said of 5 % of nights, and are none."""

_SWEEP = """
title: A night that contradicts itself
temperatures: [{temperatures}]
self_calibrations_per_temperature: {runs}
positions: [{positions}]
restabilisation: {{at_least: 45 min, window: 10 min, ceiling: 2 h}}
collect: {{settle: 60 s, duration: 60 s}}
final: 23 degC
"""


@dataclass(frozen=True)
class Told:
    """What became of a night: the verdict over all of it, and everything that was said."""

    verdict: str
    said: str


def bench_of(case: Case) -> Bench:
    """Return the simulated bench of a case; raise `InputError` where a replacement does not apply."""
    shipped = load_bench("simulated")
    text = shipped.text
    for old, new in case.file:
        if old not in text:
            raise InputError(f"{case.name}: the bench file has no {old!r}")
        text = text.replace(old, new)
    if case.faults:
        text += "faults:\n" + "".join(f"  - {line}\n" for line in case.faults)
    return parse_bench(text, shipped.source)


def sweep_of(case: Case) -> Sweep:
    """Return the sweep of a case."""
    text = _SWEEP.format(temperatures=case.temperatures, runs=case.runs, positions=case.positions)
    return parse_sweep(text, "contradictions.yaml")


class Yes(Terminal):
    """An operator at the terminal who confirms whatever is asked."""

    def put(self, question: str, timeout_s: float, *, wants_words: bool) -> None:
        """Show nothing."""
        del question, timeout_s, wants_words

    def answer(self) -> bool | str | None:
        """Say yes."""
        return True

    def settle(self, how: str) -> None:
        """Hear nothing."""
        del how


def told_of(case: Case, folder: Path, seed: int = 1) -> Told:
    """Carry a case out in the new `folder` and return what is said of it."""
    said: list[str] = []

    def opened(live: LiveBench) -> None:
        if case.tamper is not None and live.simulators is not None:
            unit, tamper = live.simulators.unit, case.tamper
            physics = unit.signals

            def signals(times_s: FloatArray) -> Mapping[str, FloatArray]:
                given = dict(physics(times_s))
                return given if not len(times_s) else {**given, **tamper(times_s, given, live)}

            unit.signals = signals  # type: ignore[method-assign]
        if case.laid is not None and live.simulators is not None:
            timeline, laid = live.simulators.unit._timeline, dict([case.laid])
            add = timeline.add
            timeline.add = lambda asked, *when: add(laid.get(asked, asked), *when)  # type: ignore[method-assign]
        imu, clock = live.devices.imu, live.devices.clock
        blocks = []
        for _ in range(20):
            clock.sleep(0.1)
            blocks.append(imu.read_block())
        said.extend(f"{each.message} {each.advice}" for each in at_rest(live, join(blocks)) if not each.good)

    outcome = start_night(folder, sweep_of(case), bench_of(case), seed=seed, terminal=Yes(), opened=opened)
    stopped = bool(said)  # `hil run` begins no night over such a finding
    with open_readonly(folder) as journal:
        said += [f"{event.kind}: {event.message}" for event in journal.events()]
    said.append(outcome.reason)
    try:
        campaign, against = campaign_of_night(folder), None
        if case.history:
            before = folder.with_name("before")
            start_night(before, sweep_of(case), load_bench("simulated"), seed=seed)
            against = Comparison(campaign, campaign_of_night(before))
        content = gather(campaign, None, against)
        export_campaign(folder, folder.with_name("exported"))
        exported = read_campaign(folder.with_name("exported"))
    except InputError as error:
        return Told("nothing", "\n".join([*said, str(error)]))
    found = [each for sensor in content.sensors for each in sensor.solutions]
    said += [each.reason for each in found] + [*content.campaign.warnings, *exported.warnings]
    said.append(good(content)[1])
    worst = good(content)[0] if outcome.state == "complete" else str(Verdict.INCONCLUSIVE)
    return Told("not begun" if stopped and worst == Verdict.PASS else worst, "\n".join(said))


def clean(nights: int, seed: int) -> Iterator[Told]:
    """Yield what is said of nights with nothing wrong, which differ in seed, positions and temperatures."""
    shapes = [Case("clean", "", positions=p, runs=r) for p, r in (("1, 2, 3", 2), ("1, 3, 2, 4", 1), ("1, 2, 3", 4))]
    for number in range(nights):
        with tempfile.TemporaryDirectory(prefix="hil-clean-") as scratch:
            yield told_of(shapes[number % len(shapes)], Path(scratch) / "night", seed=seed + number)


def main() -> None:
    """Carry the cases out, print one JSON document, and end with 1 where one was called PASS."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clean", type=int, default=0, help="so many nights with nothing wrong instead")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="cases whose name matches this")
    asked = parser.parse_args()
    began_s = time.monotonic()
    if asked.clean:
        told = list(clean(asked.clean, asked.seed))
        loud = [each.said for each in told if re.search(SAID, each.said)]
        by_chance = sum(each.verdict != Verdict.PASS for each in told) - len(loud)
        document = {"nights": len(told), "a_word_was_said": len(loud), "residuals_by_chance": by_chance, "said": loud}
        print(json.dumps(document, ensure_ascii=False, indent=1))
        sys.exit(bool(loud))
    rows = []
    for case in cases():
        if not re.search(asked.only, case.name):
            continue
        with tempfile.TemporaryDirectory(prefix="hil-contradiction-") as scratch:
            told_here = told_of(case, Path(scratch) / "night", asked.seed)
        named = re.search(case.words, told_here.said) is not None
        rows.append({"case": case.name, "verdict": told_here.verdict, "named": named})
        if told_here.verdict == Verdict.PASS or not named:
            print(f"{case.name}: {told_here.verdict}\n{told_here.said}\n", file=sys.stderr)
    passed = [row["case"] for row in rows if row["verdict"] == Verdict.PASS]
    document = {
        "cases": len(rows),
        "called_pass": passed,
        "named": sum(bool(row["named"]) for row in rows),
        "seconds": round(time.monotonic() - began_s),
        "rows": rows,
    }
    print(json.dumps(document, ensure_ascii=False, indent=1))
    sys.exit(bool(passed))


if __name__ == "__main__":
    main()
