"""Which sealed cases are made: nothing hidden, one effect, two, one outside the catalogue, the report's, hard ones.

An effect is asked for only where the base leaves a tenth of its norm or more: what the base takes in whole is not the
search's to find. What it hardly leaves has rows of its own, at a size that a unit may really have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from benchmarks.blind.cases import AS_IT_IS, Noise, alike, kept_share, make_case
from benchmarks.blind.night import Design
from benchmarks.blind.physics import CATALOGUE, OUTSIDE

UP_AND_DOWN = (-29.7, -6.8, 23.4, 48.9, 60.0, 37.8, 6.3, -14.4)
THREE = Design()
"""The published night: three collects, temperatures upward."""
FOUR = Design(temperatures_degC=UP_AND_DOWN, positions=("1", "2", "3", "4"))
HEADINGS = replace(FOUR, headings_deg=(30.0, 120.0, 210.0))
EIGHT = Design(temperatures_degC=(-20.0, 0.0, 20.0, 60.0), runs_per_temperature=2, positions=("1", "2", "3", "4"))
HOLES = replace(FOUR, missing=0.3)
THERMAL = "matrix-6-thermal"
SETTINGS = ((THREE, THERMAL), (FOUR, THERMAL), (HEADINGS, THERMAL), (FOUR, "matrix-6"))
"""What the singles and doubles are measured with, in turn."""
PLAIN = Noise()
KINDS = ("plain", "white", "heavy", "walk", "run_mu", "cold", "row_ar")
SIZES = (4.0, 6.0, 8.0, 12.0)
_LEAST_KEPT = 0.1
_ALIKE = 0.9


@dataclass(frozen=True)
class Job:
    """One sealed case to be reconciled. `row` is the table's row that it counts in."""

    row: str
    seed: int
    hidden: tuple[str, ...] = ()
    d: float = 8.0
    model: str = THERMAL
    design: Design = FOUR
    noise: Noise = PLAIN
    alpha: float = 0.05
    form: str = "night"  # night, triad, quiet triad, or log: one that was measured
    log: str = ""
    follow: bool = False
    times_white: float = 3.0  # rms of a hidden effect on the scatter
    without: tuple[str, ...] = ()  # columns that the file lacks


@lru_cache
def shares(design: Design, model: str) -> dict[str, float]:
    """What share of each catalogue effect's norm the base leaves on a design."""
    return {name: kept_share(name, model, design) for name in CATALOGUE}


@lru_cache
def overlap(first: str, second: str, model: str, design: Design) -> float:
    """How alike two effects are beside the base: above .9 they are one thing to anybody, and no pair."""
    cosines = [alike(make_case(seed, (first, second), 1.0, model=model, design=design), model) for seed in range(3)]
    return float(np.median(cosines))


def visible(design: Design, model: str) -> list[str]:
    """The catalogue's effects that this design can show beside this model."""
    return [n for n, kept in shares(design, model).items() if kept >= _LEAST_KEPT and n not in AS_IT_IS]


def nulls(cases: int) -> list[Job]:
    """Nothing is missing, by kind of noise."""
    jobs = [
        Job(f"nothing, {kind}", 100_000 + 5_000 * k + i, noise=Noise(kind=kind))
        for k, kind in enumerate(KINDS)
        for i in range(cases)
    ]
    jobs += [Job("nothing, three collects", 11_000 + i, design=THREE) for i in range(cases)]
    jobs += [Job("nothing, 8 runs", 12_000 + i, model="matrix-6", design=EIGHT) for i in range(cases)]
    return jobs + [Job("nothing, 30 % missing", 13_000 + i, design=HOLES) for i in range(cases)]


def singles(cases: int) -> list[Job]:
    """One catalogue effect, at four sizes; designs and effects in turn."""
    return [_turn(Job(f"one effect, d = {d:g}", 20_000 + i, d=d), i, _stride) for d in SIZES for i in range(cases)]


def doubles(cases: int) -> list[Job]:
    """Two catalogue effects at d = 8 each."""

    def pair(names: list[str], i: int) -> tuple[str, ...]:
        pairs = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]
        return pairs[(7 * i) % len(pairs)]

    jobs = [_turn(Job("two effects, d = 8 each", 30_000 + i), i, pair) for i in range(3 * cases)]
    return [job for job in jobs if overlap(*job.hidden, job.model, job.design) < _ALIKE][:cases]


def hardly_kept(cases: int) -> list[Job]:
    """Effects that the base takes in almost whole: nothing can be asked but that no false name is given."""
    names = [n for n, kept in shares(FOUR, THERMAL).items() if 0.005 < kept < _LEAST_KEPT]
    return [
        Job("hardly kept by the base", 35_000 + i, (n,), 60.0 * shares(FOUR, THERMAL)[n])
        for i in range(cases)
        for n in [names[i % len(names)]]
    ]


def outside(cases: int) -> list[Job]:
    """Effects that no catalogue entry describes."""
    return [Job(name, 40_000 + i, (name,), 10.0) for name in OUTSIDE for i in range(cases)]


def report(cases: int) -> list[Job]:
    """The report's own case: the contractor's model, MU hidden, three and four collects."""
    mu = Job("", 0, ("MU_real",), 30.0, "collins-4")
    return [
        replace(mu, row=row, seed=50_000 + i, design=design)
        for row, design in (("MU, three collects", THREE), ("MU, four collects", FOUR))
        for i in range(cases)
    ]


def hard(cases: int) -> list[Job]:
    """Rows missing, a wrong sign, a wrong heading, an exchanged label, several troubles at once."""
    kinds = (
        Job("supply, 30 % missing", 62_000, ("supply",), design=HOLES),
        Job("earth, three headings", 25_000, ("earth",), design=HEADINGS),
        Job("frame, three headings", 63_000, ("frame",), design=HEADINGS),
        Job("labels exchanged in one run", 64_000, ("swap",)),
        Job("supply, cold rows 3 x noisier", 65_000, ("supply",), noise=Noise(kind="cold")),
        Job("supply and ageing", 66_000, ("supply", "ageing")),
        Job("warm-up, heavy tails", 67_000, ("warmup",), noise=Noise(kind="heavy")),
        Job("supply, 8 runs", 68_000, ("supply",), model="matrix-6", design=EIGHT),
    )
    return [replace(kind, seed=kind.seed + i) for kind in kinds for i in range(cases)]


def triads(cases: int) -> list[Job]:
    """Three-axis units in hand-placed poses: nothing, and a full g-sensitivity, against bias only."""
    kinds = (
        Job("triad, nothing", 70_000),
        *(Job(f"triad, g_sensitivity, d = {d:g}", 71_000, ("g_sensitivity",), d) for d in SIZES),
    )
    return [replace(kind, seed=kind.seed + i, model="constant", form="triad") for kind in kinds for i in range(cases)]


def _stride(names: list[str], i: int) -> tuple[str, ...]:
    """One name, so that a few cases already reach all over the list."""
    return (names[(5 * i) % len(names)],)


def _turn(job: Job, i: int, choose: Callable[[list[str], int], tuple[str, ...]]) -> Job:
    """The job with the i-th design and, of what that design shows, the next effects."""
    design, model = SETTINGS[i % len(SETTINGS)]
    return replace(job, design=design, model=model, hidden=choose(visible(design, model), i // len(SETTINGS)))


GROUPS: dict[str, Callable[[int], list[Job]]] = {
    "nulls": nulls,
    "singles": singles,
    "doubles": doubles,
    "hardly": hardly_kept,
    "outside": outside,
    "report": report,
    "hard": hard,
    "triads": triads,
}
