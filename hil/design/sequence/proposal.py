"""A proposed sequence for programs (hil.design/1) and as a sweep file that `hil plan` and `hil run` accept.

design_document(proposal, goal, sweep, bench)
write_sweep(proposal, sweep, bench, Path("my.yaml"), "hil design rd-gc-86-1 --goal 'MU 0.5 deg/hr' --out my.yaml")
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from hil.config.bench import Bench
from hil.config.sweep import Sweep, check_sweep_against_bench, parse_sweep
from hil.design.sequence.search import Candidate, Goal, Proposal, spelled_out
from hil.design.sequence.unit_scatter import UnitScatter
from hil.files.document import picked
from hil.files.durable import check_new, write_result
from hil.files.strict import parse_yaml
from procedures.words import counted

_DAY_S = 86400.0
_LONG_DAYS = 3.0  # of repeats in one night of days it is said what they are for, and what would spare them


def design_document(proposal: Proposal, goal: Goal, sweep: Sweep, bench: Bench) -> dict[str, Any]:
    """Return what `hil design --json` prints."""
    return {
        "schema": "hil.design/1",
        "simulated": bench.simulated,
        "bench": bench.name,
        "sweep": sweep.title,
        "goal": {
            **picked(goal, "targets drift_immune residuals tells_even_terms time_s"),
            "repeats": goal.repeats or sweep.self_calibrations_per_temperature,
            "scatter": dict(goal.scatter),
            "scatter_of": {str(number): dict(of.sizes) for number, of in goal.shown.items()},
            "lasting_of": {str(number): list(of.lasting) for number, of in goal.shown.items()},
            "noise_of": {str(number): dict(of.noise) for number, of in goal.shown.items()},
            "at_most_of": {str(number): dict(of.at_most) for number, of in goal.shown.items()},
        },
        "met": not proposal.missing,
        "missing": list(proposal.missing),
        "said": [*_unasked(goal), *_in_days(proposal, goal), *_at_most(proposal, goal)],
        "proposed": _entry(proposal.best),
        "at_most": {str(number): dict(of) for number, of in proposal.at_most.total.items()},
        "with_more_time": None if proposal.with_more_time is None else _entry(proposal.with_more_time),
        "compared": [_entry(each) for each in proposal.compared],
    }


def _entry(candidate: Candidate) -> dict[str, Any]:
    return {
        **picked(
            candidate,
            "sequence positions collect_duration_s=duration_s self_calibrations_per_temperature=repeats total_s=time_s",
        ),
        "sensors": {
            str(number): {
                "uncertainty": dict(candidate.total[number]),
                "white": dict(worth.white),
                "drift": {name: round(value, 9) for name, value in worth.drift.items()},
                "immune_to_drift": [name for name in worth.drift if worth.immune([name])],
                **picked(worth, "residuals condition_number tells_even_terms"),
                "terms_seen": dict(zip(("of_4_linear", "of_10_with_squares", "of_13"), worth.terms, strict=True)),
            }
            for number, worth in candidate.worth.items()
        },
    }


def _unasked(goal: Goal) -> Iterator[str]:
    """Say what was preferred where nobody said how certain anything has to be."""
    if not goal.targets:
        yield "no uncertainty was asked for (--goal): of the shortest nights that do it is the most certain"


def _in_days(proposal: Proposal, goal: Goal) -> Iterator[str]:
    """Say of a night of days what its repeats are for: of what runs scatter by by more than was asked."""
    longest = proposal.with_more_time or proposal.best
    if longest.time_s < _LONG_DAYS * _DAY_S:
        return
    large, targets = [], _targets(proposal, goal)
    for number, total in longest.total.items():
        own = {**goal.shown.get(number, UnitScatter()).sizes, **goal.scatter}
        scatter = spelled_out({name: size for name, size in own.items() if size > 0.0}, total)
        some = [f"{name} by {scatter[name]:.3g}" for name, asked in targets.items() if scatter.get(name, 0.0) > asked]
        large += [f"sensor {number}: {', '.join(some)}"] if some else []
    days = f"{counted(longest.repeats, 'self-calibration')} at each temperature, {longest.time_s / _DAY_S:.1f} days"
    if large:
        out = "are not enough" if proposal.missing and proposal.with_more_time is None else "is what it takes"
        yield (
            f"{days}, {out} for what runs differ by ({'; '.join(large)}; deg/hr, deg/hr/g): half as uncertain takes "
            "four times as long. hil reconcile asks what makes them differ: what its model holds needs no repeats"
        )
    else:
        yield f"{days}: more than {_LONG_DAYS:.0f} days in one sweep"


def _at_most(proposal: Proposal, goal: Goal) -> Iterator[str]:
    """Say which goals may be missed all the same, for few repeats told what runs scatter by."""
    for number, most in proposal.at_most.total.items():
        total = proposal.best.total[number]
        asked = {name: size for name, size in _targets(proposal, goal).items() if name in total}
        some = [f"{n} ± {most[n]:.3g} instead of {of:.3g}" for n, of in asked.items() if total[n] <= of < most[n]]
        if some:
            yield f"sensor {number} may miss the goal, for few repeats told what its runs differ by: {', '.join(some)}"


def _targets(proposal: Proposal, goal: Goal) -> dict[str, float]:
    return spelled_out(goal.targets, dict.fromkeys(name for total in proposal.best.total.values() for name in total))


def sweep_text(proposal: Proposal, sweep: Sweep, command: str) -> str:
    """Return the base sweep with the proposed sequence, duration and repeats, and at its head where it comes from."""
    best = proposal.best
    document = parse_yaml(sweep.text, sweep.source)
    document["title"] = f"{sweep.title.partition(', collects ')[0]}, collects {best.sequence}"
    document["positions"] = list(best.positions)
    document["self_calibrations_per_temperature"] = best.repeats
    document["collect"] = {**(document.get("collect") or {}), "duration": f"{best.duration_s:g} s"}
    head = [f"Proposed by: {command}", f"on the temperatures and soaks of {Path(sweep.source).name}"]
    head += [f"The goal is not met: {text}" for text in proposal.missing]
    for number, total in best.total.items():
        told = ", ".join(f"{name} {value:.2g}" for name, value in total.items())
        head.append(f"sensor {number}, mean of {best.repeats} at one temperature, ±: {told} (deg/hr, deg/hr/g)")
    body = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    return "".join(f"# {line}\n" for line in head) + body


def write_sweep(proposal: Proposal, sweep: Sweep, bench: Bench, out: Path, command: str) -> None:
    """Write the proposed sweep as a new file; raises as `check_new` does."""
    check_new(out)
    text = sweep_text(proposal, sweep, command)
    check_sweep_against_bench(parse_sweep(text, str(out)), bench)
    write_result(out, text)
