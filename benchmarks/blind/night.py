"""A measured night, made from first principles: when each collect happens, in which orientation, how warm.

Rows are collects of one two-channel sensor with axes A, B, S. Everything is plain numpy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EARTH_RATE_DEG_PER_HR = 15.041067
INDEX_ANGLE_DEG = {"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0, "5": 45.0, "6": 135.0}
PUBLISHED_DEGC = (-29.7, -14.4, -6.8, 6.3, 23.4, 37.8, 48.9, 60.0)


@dataclass(frozen=True)
class Design:
    """What is measured: temperatures in the order visited, runs at each, positions in order, headings by run."""

    temperatures_degC: tuple[float, ...] = PUBLISHED_DEGC
    runs_per_temperature: int = 3
    positions: tuple[str, ...] = ("1", "2", "3")
    headings_deg: tuple[float, ...] = (30.0,)
    latitude_deg: float = 34.6
    collect_s: float = 60.0
    restabilisation_s: float = 2700.0
    tilt_rad: tuple[float, float] = (0.001, -0.016)  # G2 and G3 over g
    missing: float = 0.0
    missing_cold: float = 0.0  # beside that, of the rows below 0 °C: not at random
    jitter: float = 0.0  # every wait is longer or shorter by up to this share
    power_cycles: int = 0  # how often the unit loses its supply between two runs, anywhere in the night
    rest_s: float = 0.0  # between two temperatures the unit stands switched off for so long


@dataclass
class Night:
    """The rows. Vectors have shape (n,), `f` and `w` (n, 3) along A, B, S."""

    design: Design
    run: np.ndarray
    order: np.ndarray  # 0, 1, 2 … within the run
    position: np.ndarray
    start_s: np.ndarray
    setpoint: np.ndarray
    previous_setpoint: np.ndarray
    since_setpoint_s: np.ndarray
    since_power_s: np.ndarray  # since the supply last came on
    case: np.ndarray
    rotor: np.ndarray
    rotor_slope: np.ndarray  # °C/min
    heading: np.ndarray
    supply: np.ndarray
    spin_us: np.ndarray  # period of the rotor
    vibration: np.ndarray  # g, rms at the unit
    slew: np.ndarray  # rad, from the orientation before
    f: np.ndarray
    w: np.ndarray
    theta: np.ndarray
    g: np.ndarray  # (G1, G2, G3)

    def __len__(self) -> int:
        return len(self.run)


def turned(theta: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Components along A, B, S of bench-frame vectors (n, 3) at index angle theta: one rotation about axis 2."""
    s, c = np.sin(theta), np.cos(theta)
    return np.stack([vector[:, 0] * s + vector[:, 2] * c, vector[:, 1], vector[:, 0] * c - vector[:, 2] * s], 1)


def bench_rate(design: Design, heading_deg: np.ndarray) -> np.ndarray:
    """Earth rate along axes 1, 2, 3 of the bench at each heading, deg/hr, (n, 3)."""
    latitude, heading = np.deg2rad(design.latitude_deg), np.deg2rad(heading_deg)
    level = np.cos(latitude)
    up = np.full(len(heading), np.sin(latitude))
    return np.asarray(EARTH_RATE_DEG_PER_HR * np.stack([up, level * np.cos(heading), level * np.sin(heading)], 1))


def _two_nodes(step: float, seconds: np.ndarray, tau_case: float, tau_rotor: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of case and rotor after a step of the chamber, two first-order lags in cascade."""
    case = step * np.exp(-seconds / tau_case)
    rotor = (
        step
        * (tau_case * np.exp(-seconds / tau_case) - tau_rotor * np.exp(-seconds / tau_rotor))
        / (tau_case - tau_rotor)
    )
    return case, rotor


def make_night(design: Design, rng: np.random.Generator) -> Night:
    """Lay out the collects of a whole campaign, chronologically."""
    tau_case, tau_rotor = rng.uniform(600.0, 900.0), rng.uniform(400.0, 590.0)
    rows: dict[str, list[float | str]] = {name: [] for name in ("run", "order", "position", "start", "set", "prev")}
    rows |= {"since": [], "heading": [], "case": [], "rotor": [], "slope": [], "powered": []}
    clock, run, previous, powered = 0.0, 0, 20.0, 0.0
    cut = _cut_before(design, rng)
    for setpoint in design.temperatures_degC:
        clock += design.rest_s
        powered = clock if design.rest_s else powered
        clock += abs(setpoint - previous) / 3.0 * 60.0
        reached = clock
        for _ in range(design.runs_per_temperature):
            run += 1
            powered = clock if run in cut else powered
            clock += design.restabilisation_s * _waits(design, rng)
            heading = design.headings_deg[(run - 1) % len(design.headings_deg)]
            for order, position in enumerate(design.positions):
                clock += 30.0 * _waits(design, rng)
                mid = np.array([clock - reached + design.collect_s / 2.0])
                case, rotor = _two_nodes(previous - setpoint, mid, tau_case, tau_rotor)
                later = _two_nodes(previous - setpoint, mid + 60.0, tau_case, tau_rotor)[1]
                values = (run, order, position, clock, setpoint, previous, clock - reached, heading)
                for name, value in zip(rows, values, strict=False):
                    rows[name].append(value)
                rows["heading"][-1] = heading
                rows["powered"].append(clock - powered)
                rows["case"].append(float(case[0]))
                rows["rotor"].append(float(rotor[0]))
                rows["slope"].append(float((later - rotor)[0]))
                clock += design.collect_s
        previous = setpoint
    return _assemble(design, rows, rng)


def _waits(design: Design, rng: np.random.Generator) -> float:
    """How long a wait really is, in units of the one that was meant."""
    return rng.uniform(1.0 - design.jitter, 1.0 + design.jitter) if design.jitter else 1.0


def _cut_before(design: Design, rng: np.random.Generator) -> set[int]:
    """The runs before which the unit lost its supply; never the first."""
    runs = len(design.temperatures_degC) * design.runs_per_temperature
    if not design.power_cycles:
        return set()
    return set((2 + rng.choice(runs - 1, design.power_cycles, replace=False)).tolist())


def _assemble(design: Design, rows: dict[str, list[float | str]], rng: np.random.Generator) -> Night:
    column = {name: np.array(values) for name, values in rows.items()}
    n = len(column["run"])
    keep = rng.random(n) >= design.missing
    theta = np.deg2rad([INDEX_ANGLE_DEG[str(p)] for p in rows["position"]])
    g2, g3 = design.tilt_rad
    g = np.array([np.sqrt(1.0 - g2**2 - g3**2), g2, g3])
    setpoint = column["set"].astype(float)
    if design.missing_cold:
        keep &= (rng.random(n) >= design.missing_cold) | (setpoint >= 0.0)
    run = column["run"].astype(int)
    slew = np.abs(np.diff(theta, prepend=0.0))
    slew = np.minimum(slew, 2.0 * np.pi - slew)
    supply = 28.0 - 0.004 * setpoint + rng.normal(0.0, 0.12, run.max() + 1)[run] + rng.normal(0.0, 0.01, n)
    # Drawn last and from a stream of their own: what earlier seeds gave stays.
    other = np.random.default_rng(rng.integers(2**63))
    spin = 2500.0 * (1.0 + 1e-6 * other.normal(0.0, 300.0, run.max() + 1)[run] + 1e-6 * other.normal(0.0, 20.0, n))
    cooling = 0.15 + 0.25 * (setpoint < 20.0)  # the compressor runs
    vibration = cooling * np.exp(other.normal(0.0, 0.5, run.max() + 1)[run] + other.normal(0.0, 0.1, n))
    night = Night(
        design=design,
        run=run,
        order=column["order"].astype(int),
        position=column["position"].astype(str),
        start_s=column["start"].astype(float),
        setpoint=setpoint,
        previous_setpoint=column["prev"].astype(float),
        since_setpoint_s=column["since"].astype(float),
        since_power_s=column["powered"].astype(float),
        case=setpoint + column["case"].astype(float) + 2.0,
        rotor=setpoint + column["rotor"].astype(float) + 8.0,
        rotor_slope=column["slope"].astype(float),
        heading=column["heading"].astype(float),
        supply=supply,
        spin_us=spin,
        vibration=vibration,
        slew=slew,
        f=turned(theta, np.broadcast_to(g, (n, 3))),
        w=turned(theta, bench_rate(design, column["heading"].astype(float))),
        theta=theta,
        g=g,
    )
    return _rows(night, keep)


def _rows(night: Night, keep: np.ndarray) -> Night:
    """The night without the rows that were not measured."""
    values = {k: (v[keep] if isinstance(v, np.ndarray) and len(v) == len(keep) else v) for k, v in vars(night).items()}
    values["g"] = night.g
    return Night(**values)
