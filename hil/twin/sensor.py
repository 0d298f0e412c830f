"""One simulated sensor: its coefficients at a temperature, its geometry, its run-to-run scatter."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drivers.frames.roles import SensorRole
from hil.campaign import FloatArray
from hil.config.bench import Bench
from hil.config.simulation import SimulationSection
from hil.errors import InputError
from hil.model import Model
from hil.model.curve import Constant
from hil.model.equation import pickoff_rates
from hil.model.forms import value_form
from hil.model.model_file import unit_terms
from hil.model.stated_noise import SensorNoise
from hil.twin.motion import Leg
from hil.twin.scatter import COLLECTS, RUNS, drawn_base

_COLDEST_DEGC, _HOTTEST_DEGC, _STEP_DEGC = -90.0, 150.0, 0.02


def simulation_of(bench: Bench) -> SimulationSection:
    """Return what a bench says of its simulation; raise `InputError` where it says nothing."""
    if bench.simulation is None:
        raise InputError(f"{bench.source or bench.name}: there is no simulation section, so nothing to simulate")
    return bench.simulation


class SimulatedSensor:
    """The truth about one sensor. Arrays over n temperatures; c channels in the order of `sensor.channels`.

    Raises `InputError` where the stream's description lacks one of its channels, or has an axis that it lacks.
    """

    def __init__(self, bench: Bench, number: int, role: SensorRole, model: Model) -> None:
        settings = simulation_of(bench)
        self.sensor = bench.sensor(number)
        self.model = model
        for name in self.sensor.channels:
            if name not in role.rates:
                raise InputError(
                    f"{bench.source or bench.name}: sensors.{number}: the IMU description {bench.imu.description} has "
                    f"no channel {name}; it has {', '.join(role.rates)}"
                )
        self.rate_fields = tuple(role.rates[name] for name in self.sensor.channels)
        self.acceleration_fields = dict(role.accelerations)
        self.temperature_field = role.temperature
        self.spin_field = role.conditions.get("spin_period_us")
        for axis in self.acceleration_fields:
            if axis not in self.sensor.axes:
                raise InputError(f"{bench.imu.description}: sensor {number} has no axis {axis} on bench {bench.name}")
        self.acceleration_axes = np.array([self.sensor.axes.index(axis) for axis in self.acceleration_fields], int)
        self.noise, self._seed = model.noise.get(number, SensorNoise()), settings.seed
        changed: dict[str, Any] = {} if settings.noise.run_to_run else {"run_to_run": {}, "correlation": {}}
        if "angle_random_walk" not in self.noise.model_fields_set:  # it may hold only scatter: the bench's is added
            changed["angle_random_walk"] = Constant(unit="deg/sqrt(hr)", value=settings.noise.angle_random_walk)
        self.noise = self.noise.model_copy(update=changed)
        self.scattering = self.noise.scatter_for(self.sensor, slow=settings.noise.slow)
        self.runs: dict[int, dict[str, float]] = {}
        """By how much each base parameter differs in a self-calibration from the model's value."""
        self._stays: dict[int, FloatArray] = {}
        self._form = value_form(model.form, self.sensor)
        bias, k = unit_terms(self._form, self.sensor)
        self._per_unit = np.concatenate([bias, k.reshape(-1, len(self._form.names))])
        self._table = self._tabulate()

    @property
    def channels(self) -> int:
        """How many rate channels there are."""
        return len(self.rate_fields)

    def coefficients(self, temperature_degC: FloatArray) -> FloatArray:
        """Return bias and K at temperatures (n,), °C, as (n, 4c), deg/hr and deg/hr/g; K row by channel."""
        at = (np.clip(temperature_degC, _COLDEST_DEGC, _HOTTEST_DEGC) - _COLDEST_DEGC) / _STEP_DEGC
        below = np.minimum(at.astype(np.int64), len(self._table) - 2)
        share = (at - below)[:, None]
        return np.asarray(self._table[below] * (1.0 - share) + self._table[below + 1] * share)

    def rates(self, coefficients: FloatArray, f_g: FloatArray, w_channels: ArrayLike = 0.0) -> FloatArray:
        """Return R, shape (n, c), for rows of `coefficients`, f of shape (3,) or (n, 3) and w of (c,) or (n, c)."""
        c = self.channels
        k = coefficients[:, c:].reshape(len(coefficients), c, 3)
        return pickoff_rates(coefficients[:, :c], k, f_g, w_channels)

    def begin_stay(self, session: int, leg: Leg, temperature_degC: float) -> None:
        """Draw the scatter of a stay, and of its self-calibration, which is the same again after a resume."""
        number, noise = self.sensor.number, self.noise
        if leg.run not in self.runs:
            sizes, factor = noise.run_to_run, noise.correlation_factor()
            self.runs[leg.run] = drawn_base(self._seed, (RUNS, leg.run, number), sizes, factor, temperature_degC)
        sizes, key = self.noise.collect_to_collect, (COLLECTS, session, leg.number, number)
        own = drawn_base(self._seed, key, sizes, np.eye(len(sizes)), temperature_degC)  # done again it is another
        both = [self.runs[leg.run].get(name, 0.0) + own.get(name, 0.0) for name in self._form.names]
        self._stays[leg.number] = self._per_unit @ both

    def scatter_coefficients(self, leg: Leg) -> FloatArray:
        """Return the scatter of a stay as one row like those of `coefficients`, shape (4c,)."""
        return self._stays.get(leg.number, np.zeros(4 * self.channels))

    def _tabulate(self) -> FloatArray:
        # Dense enough that a straight line between two rows is the curve: evaluating the curves costs too much a poll.
        temperatures = np.arange(_COLDEST_DEGC, _HOTTEST_DEGC + _STEP_DEGC / 2, _STEP_DEGC)
        # A fitted model knows nothing outside its range; the simulated unit then keeps what it has at the edge.
        curves = self.model.sensors.get(self.sensor.number, {}).values()
        ranges = [curve.valid_degC for curve in curves if curve.valid_degC is not None]
        low, high = max((r[0] for r in ranges), default=-np.inf), min((r[1] for r in ranges), default=np.inf)
        base = self.model.base_at(self.sensor, np.clip(temperatures, low, high))
        return np.concatenate([base.bias, base.k.reshape(len(temperatures), -1)], axis=1)
