"""More sealed cases: other layouts, sizes and noise, effects on the scatter, steps anywhere, mistakes in the data.

A group is a list of rows; each row is one job that is made again with fresh seeds, and may turn with the case's number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from benchmarks.blind.cases import Noise
from benchmarks.blind.jobs import EIGHT, FOUR, HEADINGS, THERMAL, THREE, UP_AND_DOWN, Job, singles, visible
from benchmarks.blind.poses import MISTAKES
from benchmarks.blind.real import ADDED, logs

ORDINARY = Noise(rho=0.0)
"""White noise as stated and an independent offset of each run: no finding."""
MATRIX = "matrix-6"
JITTERED = replace(FOUR, jitter=0.4)
COLD_HOLES = replace(FOUR, missing=0.05, missing_cold=0.5)
CYCLED = replace(FOUR, power_cycles=5)
CUT_OFF = replace(FOUR, power_cycles=2)
QUARTER = replace(FOUR, temperatures_degC=4 * UP_AND_DOWN, rest_s=2.7 * 86400.0)  # 96 runs
YEAR = replace(FOUR, temperatures_degC=16 * UP_AND_DOWN, rest_s=2.7 * 86400.0)  # 384 runs
EVERY_SIZE = (4.0, 6.0, 8.0, 12.0, 25.0, 50.0, 100.0, 200.0)
TIMES_WHITE = (2.0, 3.0, 4.0)
SLOW_HOURS = (0.3, 1.0, 3.0, 10.0, 30.0, 60.0)
COLUMNS = (
    "supply_V",
    "spin_period_us",
    "vibration_rms_g",
    "case_degC",
    "setpoint_degC",
    "dTdt_degC_per_min",
    "time_since_power_on_s",
    "time_since_setpoint_s",
    "time_since_index_s",
)
_NEEDED = {"supply": "supply_V", "spin": "spin_period_us", "vre": "vibration_rms_g"}
"""Effects that follow what one column alone has."""
_STRIDE = 1_000


def _rows(base: int, cases: int, *rows: Job, turn: Callable[[Job, int], Job] | None = None) -> list[Job]:
    """Each row with `cases` fresh seeds from `base` on, and what `turn` makes of the row for the i-th case."""
    assert cases <= _STRIDE, f"{cases} cases: a row has {_STRIDE} seeds of its own"
    made = [replace(row, seed=base + _STRIDE * k + i) for k, row in enumerate(rows) for i in range(cases)]
    return [turn(job, i % cases) for i, job in enumerate(made)] if turn else made


def _any_effect(job: Job, i: int) -> Job:
    """One of the effects that the job's design shows."""
    names = visible(FOUR, THERMAL)
    return replace(job, hidden=(names[(5 * i) % len(names)],))


def _any_scatter_size(job: Job, i: int) -> Job:
    return replace(job, times_white=TIMES_WHITE[i % len(TIMES_WHITE)], model=(MATRIX, THERMAL)[i // 3 % 2])


def layouts(cases: int) -> list[Job]:
    """Waits of other lengths, rows missing at random and in the cold, columns missing."""

    def fewer_columns(job: Job, i: int) -> Job:
        job = _any_effect(job, i)
        spare = [c for c in COLUMNS if c != _NEEDED.get(job.hidden[0])]
        return replace(job, without=tuple(spare[(i + 2 * k) % len(spare)] for k in range(3)))

    plain = Job("", 0)
    return [
        *_rows(
            200_000,
            cases,
            replace(plain, row="waits 40 % longer or shorter, one effect", design=JITTERED),
            replace(plain, row="half of the cold rows missing, one effect", design=COLD_HOLES),
            turn=_any_effect,
        ),
        *_rows(204_000, cases, replace(plain, row="three columns missing, one effect"), turn=fewer_columns),
        *_rows(
            206_000,
            cases,
            Job("nothing, waits 40 % longer or shorter", 0, design=JITTERED),
            Job("nothing, half of the cold rows missing", 0, design=COLD_HOLES),
            Job("nothing, no column but the temperature", 0, without=COLUMNS),
        ),
    ]


def every_size(cases: int) -> list[Job]:
    """One effect from what can hardly be seen to what cannot be overlooked."""
    rows = [Job(f"one effect of any size, d = {d:g}", 0, d=d) for d in EVERY_SIZE]
    jobs = _rows(210_000, cases, *rows)
    # The design, model and effect of the i-th case are those of the singles.
    likes = singles(cases)[:cases]
    return [
        replace(job, hidden=like.hidden, design=like.design, model=like.model)
        for job, like in zip(jobs, len(rows) * likes, strict=True)
    ]


def scatter(cases: int) -> list[Job]:
    """Each effect on the scatter alone, at two to four times the white noise, and beside an effect on the mean."""
    kinds = (
        "MU_rr",
        "GS_rr",
        "rrw",
        "hash",
        "frost",
        "flicker",
        "base",
        *(f"markov@{h:g} h" for h in (0.5, 2.0, 8.0, 40.0)),
    )
    alone = [Job(f"scatter: {name}", 0, (name,), noise=ORDINARY) for name in kinds]
    alone.append(Job("scatter: turnon", 0, ("turnon",), design=CYCLED, noise=ORDINARY))
    beside = [
        Job(f"scatter: {name} beside {mean}", 0, (name, mean), d=10.0, noise=ORDINARY)
        for name in ("MU_rr", "hash", "markov@2 h", "rrw")
        for mean in ("supply", "k2")
    ]
    return _rows(220_000, cases, *alone, *beside, turn=_any_scatter_size)


def slow(cases: int) -> list[Job]:
    """Nothing on the mean, a bias correlated over every length of time, and the correlated kinds of null."""
    wandering = [Job(f"slow noise, {h:g} h", 0, (f"markov@{h:g} h",), noise=ORDINARY) for h in SLOW_HOURS]
    by_run = [Job(f"nothing, offsets of runs correlated {rho:g}", 0, noise=Noise(rho=rho)) for rho in (0.6, 0.9, 0.97)]
    kinds = [Job(f"nothing, {kind} and unequal", 0, noise=Noise(kind=kind, unequal=0.5)) for kind in ("walk", "row_ar")]
    return _rows(250_000, cases, *wandering, *by_run, *kinds, turn=_any_scatter_size)


def unstated(cases: int) -> list[Job]:
    """Noise that the standard errors leave out: they are too small by 2 to 4, or there is white noise beside them."""
    kinds = {
        "errors stated half of the noise": Noise(rho=0.0, unequal=0.3, stated=0.5),
        "errors stated a quarter of the noise": Noise(rho=0.0, unequal=0.3, stated=0.25),
        "white noise twice what is stated, beside it": Noise(rho=0.0, unequal=0.5, extra=1.8),
        "white noise four times what is stated, beside it": Noise(rho=0.0, unequal=0.5, extra=3.6),
    }
    nothing = [Job(f"nothing, {name}", 0, noise=noise) for name, noise in kinds.items()]
    effect = [Job(f"one effect, {name}", 0, d=10.0, noise=noise) for name, noise in kinds.items()]
    return _rows(270_000, cases, *nothing) + _rows(275_000, cases, *effect, turn=_any_effect)


def steps(cases: int) -> list[Job]:
    """A step at any collect, and in the middle of a run, alone and beside another effect."""

    def either_model(job: Job, i: int) -> Job:
        return replace(job, model=(MATRIX, THERMAL)[i % 2], design=(FOUR, THREE)[i // 2 % 2])

    alone = [
        Job(f"a step {where}, d = {d:g}", 0, (name,), d, noise=ORDINARY)
        for name, where in (("jump@any collect", "at any collect"), ("jump@within a run", "within a run"))
        for d in (6.0, 8.0, 12.0)
    ]
    beside = [
        Job(f"a step at any collect and {name}, d = 8 each", 0, ("jump@any collect", name), noise=ORDINARY)
        for name in ("supply", "k2")
    ]
    return [*_rows(280_000, cases, *alone, turn=either_model), *_rows(288_000, cases, *beside)]


def power(cases: int) -> list[Job]:
    """Warm-ups that a loss of the supply begins anew."""
    rows = [Job(f"warm-up, power lost twice, d = {d:g}", 0, ("warmup",), d, design=CUT_OFF) for d in (6.0, 8.0, 12.0)]
    return _rows(300_000, cases, *rows, Job("nothing, power lost five times", 0, design=CYCLED, noise=ORDINARY))


def earth(cases: int) -> list[Job]:
    """Mistakes of the earth rate in the file: left out, wrong heading, wrong sign; one heading and three."""
    return _rows(
        310_000,
        cases,
        Job("earth rate left out, four collects, collins-4", 0, ("earth@left out",), model="collins-4"),
        Job("earth rate at a wrong heading, three headings", 0, ("earth@heading",), design=HEADINGS),
        Job("earth rate of a wrong sign, three headings", 0, ("frame@sign",), design=HEADINGS),
    ) + _rows(313_000, cases, *(_of_a_quiet_triad(mistake) for mistake in MISTAKES))


def _of_a_quiet_triad(mistake: str) -> Job:
    hidden = (mistake,) if mistake else ()
    return Job(f"quiet triad: {mistake or 'nothing'}", 0, hidden, model="constant", form="quiet triad")


def mistakes(cases: int) -> list[Job]:
    """Poses other than labelled, bad rows and runs, signs, clipped averages."""
    rows = {
        "another pose than labelled, one collect": "pose@collect",
        "another pose than labelled, one run": "pose@run",
        "a wrong label, f and w right": "label@alone",
        "labels exchanged in a run": "swap",
        "one to three bad rows": "row",
        "a bad run": "run",
        "a sign turned in one run": "sign@run",
        "a channel clipped": "clip",
    }
    jobs = [Job(row, 0, (name,), 10.0, noise=ORDINARY) for row, name in rows.items()]
    # Which way a channel points is seen by the earth rate alone, where it is not the same in all runs.
    seen = Job("a channel turned in sign, three headings", 0, ("frame@channel",), design=HEADINGS, noise=ORDINARY)
    return _rows(320_000, cases, *jobs, seen)


def short(cases: int) -> list[Job]:
    """Eight runs."""
    eight = Job("", 0, model=MATRIX, design=EIGHT, noise=ORDINARY)
    return _rows(
        330_000,
        cases,
        replace(eight, row="8 runs, nothing"),
        *(replace(eight, row=f"8 runs, {n}", hidden=(n,), d=10.0) for n in ("supply", "k2", "jump@any collect")),
        *(replace(eight, row=f"8 runs, {n}", hidden=(n,)) for n in ("MU_rr", "hash", "markov@2 h")),
    )


def long(cases: int, runs: str = "96 runs", base: int = 340_000) -> list[Job]:
    """A unit's season or year of nights."""
    year = Job("", 0, model=MATRIX, design=QUARTER if runs == "96 runs" else YEAR, noise=ORDINARY)
    return _rows(
        base,
        cases,
        replace(year, row=f"{runs}, nothing"),
        *(replace(year, row=f"{runs}, {n}", hidden=(n,), d=10.0) for n in ("supply", "ageing", "jump@any collect")),
        *(replace(year, row=f"{runs}, {n}", hidden=(n,)) for n in ("MU_rr", "turnon")),
    )


def year(cases: int) -> list[Job]:
    """The same over 384 runs."""
    return long(cases, "384 runs", 350_000)


def real(cases: int) -> list[Job]:
    """Measured logs as they are, and with an effect added; none where the logs are absent."""
    names = [path.name for path in logs()]
    asis = Job("", 0, d=0.0, model="constant", form="log")
    # One kind of unit has a weak g-sensitivity of its own, which is right where it is found.
    own = {name: ("g_sensitivity",) if name.startswith("mpu9150") else () for name in names}
    measured = [replace(asis, row=f"measured: {n}, as it is", hidden=own[n], log=n) for n in names]
    added = [
        Job(f"measured, {name} added, d = {d:g}", 0, (name,), d, "constant", form="log")
        for name in ADDED
        for d in (8.0, 12.0, 25.0)
    ]
    if not names:
        return []
    return measured + _rows(360_000, cases, *added, turn=lambda job, i: replace(job, log=names[i % len(names)]))


WIDER: dict[str, Callable[[int], list[Job]]] = {
    "layouts": layouts,
    "sizes": every_size,
    "scatter": scatter,
    "slow": slow,
    "unstated": unstated,
    "steps": steps,
    "power": power,
    "earth": earth,
    "mistakes": mistakes,
    "short": short,
    "long": long,
    "year": year,
    "real": real,
}
