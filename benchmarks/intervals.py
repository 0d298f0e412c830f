"""How often the 95 % intervals that each command states hold the unit's model, over simulated nights.

    python -m benchmarks.intervals --seeds 200                    # the table in docs/benchmarks.md
    python -m benchmarks.intervals --seeds 20 --only solve thermal

The unit's parameters are lines against temperature, with the shipped scatter from run to run (once without); the night
is the published one. Where a command states a standard error and no interval, it is taken as 1.96 of it on each side.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hil.analysis.against import Comparison
from hil.analysis.allan.fit import NoiseFit, octaves
from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Campaign
from hil.reconcile import reconcile
from hil.reconcile.scattering import what_scatters
from hil.solve import solve_campaign
from hil.solve.both_sensors import common_and_differential
from hil.solve.document import solution_document
from tests.hil.analysis.allan.noise_series import rates
from tests.hil.analysis.thermal.nights import RUN_TO_RUN, rotor_night, scaled

TRUTH = {
    "BA": (20.0, 5.0),
    "BB": (-5.0, 30.0),
    "GSA": (55.0, 10.0),
    "GSB": (-25.0, -4.0),
    "MUA": (5.0, 0.0),
    "MUB": (-7.0, 0.0),
}
NOISE = {"N": 1.0, "B": 0.3, "K": 0.02}
_HALF_DEGC = 44.85  # over which a line changes by its second number
_NORMAL = 1.96
_SCATTER = float(np.sqrt(0.5 * (RUN_TO_RUN["MUA"] ** 2 + RUN_TO_RUN["MUB"] ** 2)))
Held = Iterator[tuple[str, bool]]


def night(seed: int, run_to_run: dict[str, float] = RUN_TO_RUN) -> Campaign:
    """Return the night of sensor 2."""
    curves = {name: (lambda t, c=c: c[0] + c[1] * scaled(t)) for name, c in TRUTH.items()}
    return rotor_night(np.random.default_rng(seed), curves, run_to_run=run_to_run)


def truth(name: str, degC: float) -> float:
    """Return the parameter of the unit's model at a temperature."""
    return TRUTH[name][0] + TRUTH[name][1] * float(scaled(np.array(degC)))


def two_sensors(seed: int) -> Campaign:
    """Return a night of two sensors alike."""
    one, other = night(seed).sensors[2], night(seed + 100_000).sensors[2]
    first = replace(other, conditions=replace(other.conditions, sensor=replace(other.conditions.sensor, number=1)))
    return Campaign("two", "simulated", {1: first, 2: one}, simulated=True)


def solve(seed: int, run_to_run: dict[str, float] = RUN_TO_RUN) -> Held:
    """Single runs and means: `hil solve`, and the report and the live page, which print the same."""
    one = night(seed, run_to_run)
    document = solution_document(one, solve_campaign(one))
    at = {run: mean["temperature_degC"] for mean in document["repeats"]["2"]["means"] for run in mean["runs"]}
    for each in document["solutions"]:
        for name, of in each["parameters"].items():
            yield "a single run", of["low"] <= truth(name, at[each["run"]]) <= of["high"]
    for mean in document["repeats"]["2"]["means"]:
        for name, of in mean["parameters"].items():
            yield "a mean", of["low"] <= truth(name, mean["temperature_degC"]) <= of["high"]


def quiet(seed: int) -> Held:
    """The same where nothing changes from run to run."""
    yield from solve(seed, {})


def both(seed: int) -> Held:
    """Half the sum and the difference of two sensors."""
    found = common_and_differential(two_sensors(seed))
    assert found is not None
    for kind, of, share in (("half the sum", found.common, 1.0), ("the difference", found.differential, 0.0)):
        for mean in of.means:
            for name, value in mean.values.items():
                assert mean.temperature_degC is not None
                off = abs(value.value - share * truth(name, mean.temperature_degC))
                yield f"{kind} of two sensors", off <= value.half_width


def thermal(seed: int) -> Held:
    """Coefficients of curves; where the form is richer than the line that it is, its further coefficients are 0."""
    (sensor,) = thermal_document(fit_thermal(night(seed)))["sensors"]
    for name, each in sensor["parameters"].items():
        if each["order"] is not None and each["order"] >= (TRUTH[name][1] != 0.0):
            for power, of in enumerate(each["coefficients"]):
                expected = truth(name, each["reference_degC"]) if power == 0 else TRUTH[name][1] / _HALF_DEGC
                yield "a coefficient against temperature", of["low"] <= expected * (power < 2) <= of["high"]


def against(seed: int) -> Held:
    """What changed between two nights of a unit that did not change: within the interval of its degrees of freedom."""
    for each in Comparison(night(seed), night(seed + 100_000)).differences:
        yield "a difference between nights", abs(each.difference.value) <= each.difference.half_width


def scatter(seed: int) -> Held:
    """What MU scatters by, where it is named."""
    for each in what_scatters(night(seed)).document()["sizes"]:
        if each["id"] == "MU_rr":
            yield "MU from run to run", each["low"] <= _SCATTER <= each["high"]


def missing(seed: int) -> Held:
    """MU that the contractor's model lacks, where it is named without a slope, and what it scatters by."""
    for each in reconcile(night(seed), "collins-4", prove=False).document()["effects"]:
        for of in each["parameters"]:
            known = {"MUA": TRUTH["MUA"][0], "MUB": TRUTH["MUB"][0], "s_mu": _SCATTER}
            if each["id"] in ("MU_real", "MU_rr") and of["name"] in known and "degC" not in of["unit"]:
                yield f"{each['id']}: {of['name'][:2]} in the model", of["low"] <= known[of["name"]] <= of["high"]


def allan(seed: int) -> Held:
    """N, B and K of a record of 4096 samples."""
    series = rates(np.random.default_rng(seed), 1 << 12, n=NOISE["N"], b=NOISE["B"], k=NOISE["K"])
    fit = NoiseFit(octaves([series], 1.0))
    for name, value in NOISE.items():
        yield name, fit.terms[name].low <= value <= fit.terms[name].high


COMMANDS: dict[str, tuple[str, Callable[[int], Held]]] = {
    "solve": ("`hil solve`, report, live page", solve),
    "quiet": ("the same, nothing changes from run to run", quiet),
    "both": ("`hil solve`, `both_sensors`", both),
    "thermal": ("`hil thermal`", thermal),
    "against": ("`hil report --against`", against),
    "allan": ("`hil allan`", allan),
    "scatter": ("`hil scatter`", scatter),
    "reconcile": ("`hil reconcile`", missing),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--only", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    given = parser.parse_args()
    print("| command | interval of | hold the unit's model | intervals |\n|---|---|---|---|")
    for command in given.only:
        title, ask = COMMANDS[command]
        held: dict[str, list[bool]] = {}
        for seed in range(given.seeds):
            for kind, inside in ask(seed):
                held.setdefault(kind, []).append(bool(inside))
        for kind, all_of in held.items():
            print(f"| {title} | {kind} | {np.mean(all_of):.1%} | {len(all_of)} |", flush=True)


if __name__ == "__main__":
    main()
