"""The identities that tie the printed cells of a row together, each with the tolerance that printing allows.

Table 1, with G = (1, 0, 0) and the equations of RD-GC-86-1 (5), (6), (9)-(12): the contractor's bias less the matrix
bias is +MUB*G1 on axis A and -MUA*G1 on axis B, in every run and so in the mean; and the three standard deviations of
the same runs form a triangle. Table A-1: eqs. (A-27)-(A-33) give one bias seven ways. Single digits are checked, too:
runs that were written down to 0.01 have a mean that is a multiple of 0.01/n, so the digits tell n; and three such runs
can have only certain sigmas (with n - 1) beside a given mean.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.analysis.published.printed import PrintedRow

DEFAULT_RESOLUTION = 0.01
"""What single runs are taken to have been written down to, deg/hr, where the digits do not tell."""

G1_UNCERTAINTY = 0.0015
"""How far G1 may be from 1 g: the report prints no G; Table A-1's tilts reach 55 mrad."""

_PRINTED_RUNS = 1.5  # roundings of three single values, each half a digit
_SLACK = 1e-9  # decimal digits are not exact in binary
_RESOLUTIONS = (0.1, 0.01, 0.001)
_MOST_RUNS = 8
_ENOUGH = 0.85  # of the means must lie on a lattice before one is believed

Values = Mapping[str, float]


@dataclass(frozen=True)
class Identity:
    """A statement about the cells `roles` of a row; `kind` is what rows have in common.

    `gap` gives what is left over for given values, 0 where the identity holds exactly; `tolerance` how much rounding
    allows. `linear` says that a value for any one cell can be found that closes it.
    """

    name: str
    kind: str
    roles: tuple[str, ...]
    gap: Callable[[Values], float]
    tolerance: Callable[[Values], float]
    linear: bool = True

    def holds(self, values: Values) -> bool:
        """Whether the identity closes within its tolerance."""
        return abs(self.gap(values)) <= self.tolerance(values) + _SLACK


def identities_of_1(row: PrintedRow, resolution: float | None, runs: int | None) -> Iterator[Identity]:
    """Yield the identities of one temperature and axis; `runs` is the number of runs that the lattice is judged for."""
    axis = row.axis
    sign, mu, bias = (1.0, "MUB", "BA") if axis == "A" else (-1.0, "MUA", "BB")
    digit = resolution or DEFAULT_RESOLUTION
    yield Identity(
        f"{bias}_collins - {bias}_matrix = {'' if sign > 0 else '-'}{mu}*G1",
        "collins - matrix = MU*G1",
        ("contractor", "matrix", "mu"),
        lambda v: v["contractor"] - v["matrix"] - sign * v["mu"],
        lambda v: digit + G1_UNCERTAINTY * abs(v["mu"]),
    )
    sigmas = ("sigma_contractor", "sigma_matrix", "sigma_mu")
    if all(role in row.cells for role in sigmas):
        yield Identity(
            f"sigma triangle |sC - sM| <= s{mu} <= sC + sM",
            "sigma triangle",
            sigmas,
            lambda v: max(
                abs(v[sigmas[0]] - v[sigmas[1]]) - v[sigmas[2]], v[sigmas[2]] - (v[sigmas[0]] + v[sigmas[1]]), 0.0
            ),
            lambda v: _PRINTED_RUNS * digit,  # noqa: ARG005 - every tolerance is asked in the same way
            linear=False,
        )
    if resolution is not None and runs is not None:
        yield from _lattices(row, resolution, runs)


def _lattices(row: PrintedRow, resolution: float, runs: int) -> Iterator[Identity]:
    means = ("contractor", "matrix", "mu")
    half = {role: cell.half_digit for role, cell in row.cells.items()}
    yield Identity(
        f"means are multiples of {resolution:g}/{runs}",
        "number of runs in the digits",
        means,
        lambda v: max(off_lattice(v[role], half[role], resolution, runs) for role in means),
        lambda v: 0.0,  # noqa: ARG005
        linear=False,
    )
    if runs != 3:  # more runs can have any sigma
        return
    for role in means:
        if f"sigma_{role}" in row.cells and off_lattice(row.cells[role].value, half[role], resolution, runs) == 0.0:
            yield _possible_sigma(row, role, resolution)


def _possible_sigma(row: PrintedRow, role: str, resolution: float) -> Identity:
    sigma = f"sigma_{role}"
    cell = row.cells[sigma]
    return Identity(
        f"{cell.what} is possible for 3 runs at {resolution:g}",
        "sigma possible for 3 runs",
        (role, sigma),
        lambda v: sigma_gap(v[role], v[sigma], resolution),
        lambda v: 1.02 * cell.half_digit,  # noqa: ARG005
        linear=False,
    )


def identities_of_a1(row: PrintedRow) -> Iterator[Identity]:
    """Yield the identities of one run of Table A-1; they hold for any GSA, W and tilt.

    With m = MUB*G3 = A-28 - A-31 = A-32 - A-29, MUB*G1 = A-30 - A-33 and eps = (A-28 - A-29)/2 - m, what the GSA used
    is wrong by (times G1), A-33 = mean(A-28, A-29) - eps*G3/G1.
    """

    def identity(name: str, roles: tuple[str, ...], gap: Callable[[Values], float]) -> Identity:
        return Identity(name, name, roles, gap, lambda v: rounding(row, roles, gap, v))

    yield identity(
        "A-27 = mean(A-28, A-29)", ("A-27", "A-28", "A-29"), lambda v: v["A-27"] - 0.5 * (v["A-28"] + v["A-29"])
    )
    yield identity(
        "A-28 - A-31 = A-32 - A-29",
        ("A-28", "A-29", "A-31", "A-32"),
        lambda v: (v["A-28"] - v["A-31"]) - (v["A-32"] - v["A-29"]),
    )
    yield identity(
        "A-33 = mean(A-28, A-29) - eps*G3/G1", ("A-28", "A-29", "A-30", "A-31", "A-32", "A-33"), _off_pattern
    )


def tilt_of_a1(v: Values) -> dict[str, float | None]:
    """Return what a row of Table A-1 says about its set-up: MUB*G1, MUB*G3 (from A-31), their ratio, and eps."""
    along, across = v["A-30"] - v["A-33"], v["A-28"] - v["A-31"]
    eps = 0.5 * (v["A-28"] - v["A-29"]) - across
    return {"MUB_G1": along, "MUB_G3": across, "G3_over_G1": across / along if along else None, "eps": eps}


def rounding(row: PrintedRow, roles: tuple[str, ...], gap: Callable[[Values], float], values: Values) -> float:
    """Return the most that rounding of every cell to its last digit can add up to."""
    here, total = gap(values), 0.0
    for role in roles:
        half = row.cells[role].half_digit
        total += abs(gap({**values, role: values[role] + half}) - here)
    return total


def _off_pattern(v: Values) -> float:
    along = v["A-30"] - v["A-33"]
    if along == 0.0:  # no MU at all: then A-33 is the plain mean
        return v["A-33"] - 0.5 * (v["A-28"] + v["A-29"])
    gaps = []
    # Where contradict each other, that has its own line, and the one that fits the rest is taken here.
    for across in (v["A-28"] - v["A-31"], v["A-32"] - v["A-29"]):
        eps = 0.5 * (v["A-28"] - v["A-29"]) - across
        gaps.append(v["A-33"] - (0.5 * (v["A-28"] + v["A-29"]) - eps * across / along))
    return min(gaps, key=abs)


def off_lattice(mean: float, half_digit: float, resolution: float, runs: int) -> float:
    """Return how far a mean lies from the nearest multiple of resolution / runs, beyond its rounding; 0 if on it."""
    step = resolution / runs
    return max(abs(mean - step * round(mean / step)) - 1.02 * half_digit, 0.0)


def run_resolution(groups: Sequence[Sequence[float]], half_digit: float) -> float | None:
    """Return what the runs were written down to, judged by all printed means in groups of equal n; None if unknown."""
    total = sum(len(group) for group in groups)
    for resolution in _RESOLUTIONS:
        if resolution / 5 < 8 * half_digit:  # so fine a lattice would hold any number
            break
        on = sum(max(_count_on(group, half_digit, resolution, runs) for runs in range(1, 6)) for group in groups)
        if total >= 6 and on >= _ENOUGH * total:
            return resolution
    return None


def runs_told(means: Sequence[float], half_digit: float, resolution: float) -> int | None:
    """Return the smallest number of runs for which every mean lies on the lattice; None where there is none."""
    for runs in range(1, _MOST_RUNS + 1):
        if resolution / runs < 8 * half_digit:
            break
        if _count_on(means, half_digit, resolution, runs) == len(means):
            return runs
    return None


def sigma_gap(mean: float, sigma: float, resolution: float) -> float:
    """Return how far a sigma is from the nearest that three runs at `resolution` with this mean can have (n - 1).

    With deviations a/3, b/3 and -(a+b)/3 of the resolution, 9 sum(d²) = 2 (a² + ab + b²) and a = b = -S modulo 3,
    S the sum of the three runs: for every a the two nearest b are tried.
    """
    total = round(3 * mean / resolution)
    target = 9.0 * (sigma / resolution) ** 2  # a² + ab + b², which is half of 9 sum(d²) = 9 * 2 sigma²
    most = int(np.sqrt(4.0 / 3.0 * target)) + 4
    a = np.arange(-most, most + 1)
    a = a[(a + total) % 3 == 0].astype(np.float64)
    root = np.sqrt(np.maximum(target - 0.75 * a**2, 0.0)) - 0.5 * a
    nearest = 3.0 * np.floor((root + total) / 3.0) - total
    tried = np.stack([nearest, nearest + 3.0])
    found = resolution * np.sqrt((a**2 + a * tried + tried**2) / 9.0)
    return float(np.min(np.abs(found - sigma)))


def _count_on(means: Sequence[float], half_digit: float, resolution: float, runs: int) -> int:
    return sum(off_lattice(mean, half_digit, resolution, runs) == 0.0 for mean in means)
