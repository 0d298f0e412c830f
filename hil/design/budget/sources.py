"""What can be wrong with a self-calibration: each source's effect on the rates, to first order and exactly.

    scene = Scene(conditions, axes, base, sigma)
    for source in sources(UncertaintySection(), slope_degC_per_min=0.03):
        source.columns(scene)              # (n, c, k): change of the rates per unit of each of its k components
        source.changes(scene, draws)       # (d, n, c): the same for d draws of the components (d, k), exactly

Everything happens in the bench frame 1-2-3, where gravity G and earth rate W of each collect are turned, scaled or
shifted; the rates are K·f + w of the result. The two columns of the budget come from these two methods, which share no
arithmetic: the first is cross products, the second turns the vectors.

Sensitivities that come out for RD-GC-86-1's collects: an error of the earth rate leaves BA, GSB and MUA alone; a tilt
that is not known adds GSA·G3 to MUB; a drift in the order 1-2-3 enters MU three times as strongly as the bias.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from hil.campaign import Conditions, FloatArray
from hil.config.site import UncertaintySection
from hil.model.effects.base import Base
from hil.model.effects.geometry import unit_vectors
from hil.model.equation import pickoff_rates
from hil.model.model_file import Model
from hil.solve.beside_terms import within_runs

_STILL_RAD = 1e-6  # a turn smaller than this is no move: the unit stays where it was


@dataclass(frozen=True)
class Scene:
    """One self-calibration of one sensor as it is assumed to be: n collects.

    `axes` (n, 3, 3) are the sensor's axes in the bench frame, one row each; `base` gives B (n, c) and K (n, c, 3) at
    each collect; `sigma` (n, c) are the standard errors of averages, deg/hr, NaN where there is no rate, that weigh
    them, and `noise_times` (c,) is how many times as large their noise is.
    """

    conditions: Conditions
    axes: FloatArray
    base: Base
    sigma: FloatArray
    noise_times: FloatArray | float = 1.0

    @property
    def noise(self) -> FloatArray:
        """The noise of the averages, (n, c), deg/hr, NaN where there is no rate."""
        return np.asarray(self.sigma * self.noise_times)

    @property
    def gravity(self) -> FloatArray:
        """G in the bench frame at each collect, shape (n, 3), g."""
        return np.asarray(np.einsum("nab,na->nb", self.axes, self.conditions.f_g))

    @property
    def earth_rate(self) -> FloatArray:
        """W in the bench frame at each collect, shape (n, 3), deg/hr."""
        return np.asarray(np.einsum("nab,na->nb", self.axes, self.conditions.w_deg_per_hr))

    @property
    def minutes(self) -> FloatArray:
        """The middle of each collect, minutes from the middle of the self-calibration, shape (n,)."""
        middle = self.conditions.start_s + 0.5 * self.conditions.duration_s
        return np.asarray((middle - middle.mean()) / 60.0)

    @property
    def channels(self) -> int:
        """How many rates there are at each collect."""
        return len(self.conditions.sensor.channels)

    def rates(self, gravity: FloatArray, earth_rate: FloatArray, bias: ArrayLike = 0.0) -> FloatArray:
        """Return R (..., n, c) for G and W (..., n, 3) in the bench frame; without a bias it is linear in both."""
        axes = _each_row(self.axes).T
        f_g, w = ((_flat(vectors) @ axes).reshape(vectors.shape) for vectors in (gravity, earth_rate))
        return pickoff_rates(bias, self.base.k, f_g, w[..., self.conditions.sensor.channel_axes])


class Source(ABC):
    """One source of error: `size` is one standard deviation of each of its independent components, in `unit`.

    `varies` tells how often a new error is drawn: with every "run", so that repeats average it out, or never: it is the
    "bench"'s. `origin` says where the size comes from.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    unit: ClassVar[str]
    varies: ClassVar[str]
    per_unit: ClassVar[float] = 1.0  # what `columns` and `changes` reckon in, per `unit`
    is_ramp: ClassVar[bool] = False  # grows in proportion to the time between collects
    needs_axes: ClassVar[bool] = False  # acts in the bench frame, so that it must be known how the sensor lay
    needs_north: ClassVar[bool] = False  # an error of the earth rate, of which something must have been given

    def __init__(self, size: float, origin: str) -> None:
        self.size, self.origin = size, origin

    @abstractmethod
    def columns(self, scene: Scene) -> FloatArray:
        """Return the change of the rates per unit of each component, shape (n, c, k), deg/hr."""

    @abstractmethod
    def changes(self, scene: Scene, draws: FloatArray) -> FloatArray:
        """Return the exact change of the rates for components (d, k), shape (d, n, c), deg/hr."""


class Noise(Source):
    """The noise of every average, independent of all others. Its components are in standard errors of the averages."""

    id, title, unit, varies = "noise", "noise of the averages", "standard errors", "run"

    def each(self, scene: Scene) -> FloatArray:
        """Return the size of each average's own component, (n, c), deg/hr."""
        return np.nan_to_num(scene.noise)

    def columns(self, scene: Scene) -> FloatArray:
        n, c = scene.sigma.shape
        return np.asarray(np.diag(self.each(scene).ravel()).reshape(n, c, n * c))

    def changes(self, scene: Scene, draws: FloatArray) -> FloatArray:
        return np.asarray(draws.reshape(-1, *scene.sigma.shape) * self.each(scene))


class Instability(Noise):
    """What longer averaging does not take away: flicker, independent in every average, 0.664 B in size."""

    id, title, unit = "instability", "bias instability", "deg/hr"
    per_unit = 0.664  # the floor of the Allan deviation: sqrt(2 ln 2 / pi)

    def each(self, scene: Scene) -> FloatArray:
        return np.full_like(scene.sigma, self.per_unit)


class Stated(Source):
    """What a model states that averages scatter by beside their own noise: the catalogue's scatter, or by run.

    Of those that were `measured` what scatters inside a run is in their noise.
    """

    id, title, unit, varies = "stated", "scatter that the model states", "times as stated", "run"

    def __init__(self, model: Model, *, measured: bool) -> None:
        super().__init__(1.0, f"model {model.title}")
        self.model, self.measured = model, measured

    def columns(self, scene: Scene) -> FloatArray:
        """Return a root of the covariance (n·c, n·c) of what it states: it is linear, and so the same in draws."""
        n, c = scene.sigma.shape
        parts = self.model.stated_scatter(scene.conditions)
        covariance = sum((part.covariance(scene.conditions) for part in parts), np.zeros((n * c, n * c)))
        covariance -= np.diag(within_runs(scene.conditions, parts).ravel()) * self.measured
        size, directions = np.linalg.eigh(covariance)
        return np.asarray((directions * np.sqrt(np.maximum(size, 0.0))).reshape(n, c, n * c))

    def changes(self, scene: Scene, draws: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("nck,dk->dnc", self.columns(scene), draws))


class _Turn(Source):
    """Something turns about axes (n, 3, k) of the bench frame, by an angle each: the bench, the unit, or north."""

    per_unit = np.pi / 180.0
    unit = "deg"
    needs_axes = True
    turns_gravity: ClassVar[bool] = True

    @abstractmethod
    def about(self, scene: Scene) -> FloatArray:
        """Return the axes, one for each component, shape (k, n, 3); zero in a collect that does not turn."""

    def columns(self, scene: Scene) -> FloatArray:
        """Return the rates of what turning adds: axis x vector."""
        gravity = np.cross(self.about(scene), scene.gravity) * self.turns_gravity
        changed = scene.rates(gravity, np.cross(self.about(scene), scene.earth_rate))
        return np.moveaxis(changed, 0, -1) * self.per_unit

    def changes(self, scene: Scene, draws: FloatArray) -> FloatArray:
        """Return the rates with the vectors turned about one axis after the other, less those without."""
        gravity, earth_rate = scene.gravity[None], scene.earth_rate[None]
        for axis, angle in zip(self.about(scene), draws.T * self.per_unit, strict=True):
            earth_rate = _turned(earth_rate, axis, angle)
            gravity = _turned(gravity, axis, angle) if self.turns_gravity else gravity
        return scene.rates(gravity - scene.gravity, earth_rate - scene.earth_rate)


class Tilt(_Turn):
    """The bench leans about its axes 2 and 3 after its level was measured, and gravity and earth rate lean in it."""

    id, title, varies = "tilt", "level of the bench (axes 2 and 3)", "bench"

    def about(self, scene: Scene) -> FloatArray:
        return _constant(scene, np.eye(3)[1:])


class Accelerometer(Tilt):
    """G2 and G3 were measured wrong, so that the bench leans otherwise than is assumed."""

    id, title, unit = "accelerometer", "accelerometer errors in G2 and G3", "g"
    per_unit = 1.0  # at 1 g a component of as many g is an angle of as many radians


class Heading(_Turn):
    """North lies otherwise than is assumed: the earth rate turns about the vertical."""

    id, title, varies, turns_gravity = "heading", "earth rate, by the heading", "bench", False
    needs_north = True

    def about(self, scene: Scene) -> FloatArray:
        return unit_vectors(scene.gravity)[None]


class Latitude(Heading):
    """The latitude is otherwise than is assumed: the earth rate turns about the east."""

    id, title = "latitude", "earth rate, by the latitude"

    def about(self, scene: Scene) -> FloatArray:
        """Return north x up; zero where there is no earth rate, or only a vertical one."""
        up = unit_vectors(scene.gravity)
        north = scene.earth_rate - np.sum(scene.earth_rate * up, axis=1, keepdims=True) * up
        return np.cross(unit_vectors(north), up)[None]


class EarthRate(Source):
    """The earth rate is otherwise wrong, in each component alike: a rounded table, a base that creeps."""

    id, title, unit, varies = "earth_rate", "earth rate, each component", "deg/hr", "bench"
    needs_axes = needs_north = True

    def columns(self, scene: Scene) -> FloatArray:
        each = _constant(scene, np.eye(3))
        return np.moveaxis(scene.rates(np.zeros_like(each), each), 0, -1)

    def changes(self, scene: Scene, draws: FloatArray) -> FloatArray:
        more = np.repeat(draws[:, None, :], len(scene.axes), axis=1)
        return scene.rates(np.zeros_like(more), more)


class Gravity(Source):
    """Gravity is larger than the g in which coefficients are stated."""

    id, title, unit, varies = "gravity", "size of gravity", "g", "bench"

    def columns(self, scene: Scene) -> FloatArray:
        return scene.rates(unit_vectors(scene.gravity), np.zeros_like(scene.gravity))[..., None]

    def changes(self, scene: Scene, draws: FloatArray) -> FloatArray:
        size = np.linalg.norm(scene.gravity, axis=1, keepdims=True)
        moved = scene.gravity * ((size + draws[:, :, None]) / size)
        return scene.rates(moved - scene.gravity, np.zeros_like(moved))


class Index(_Turn):
    """Each move ends beside its position, about the axis that the unit turned about.

    A collect at the position of the one before shares its error, for nothing moved.
    """

    id, title, varies = "index", "index error of each move", "run"

    def about(self, scene: Scene) -> FloatArray:
        """Return, for each move, its axis in the collects that it brought the unit to."""
        turns = [Rotation.from_matrix(after.T @ before).as_rotvec() for before, after in pairwise(scene.axes)]
        moves = [turn for turn in turns if np.linalg.norm(turn) > _STILL_RAD]
        first = moves[0] if moves else np.array([0.0, 1.0, 0.0])
        about: list[FloatArray] = []
        for i, turn in enumerate([first, *turns]):
            if np.linalg.norm(turn) > _STILL_RAD:
                about.append(np.zeros((len(scene.axes), 3)))
                axis = turn / np.linalg.norm(turn)
                axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
            about[-1][i] = axis
        return -np.array(about)  # what stands still turns the other way, seen from the unit


class Drift(Source):
    """A steady drift of each rate from the first collect to the last, about its value in the middle."""

    id, title, unit, varies, is_ramp = "drift", "steady drift of the rates", "deg/hr/min", "run", True

    def columns(self, scene: Scene) -> FloatArray:
        return scene.minutes[:, None, None] * np.eye(scene.channels)

    def changes(self, scene: Scene, draws: FloatArray) -> FloatArray:
        return np.asarray(scene.minutes[:, None] * draws[:, None, :])


class Soak(Source):
    """The unit's temperature still changes during the collects, and the biases with it."""

    id, title, unit, varies, is_ramp = "soak", "soak that is not complete", "degC/min", "run", True

    def __init__(self, size: float, origin: str, bias_slope: float) -> None:
        super().__init__(size, origin)
        self.bias_slope = bias_slope

    def columns(self, scene: Scene) -> FloatArray:
        return np.repeat(self.bias_slope * scene.minutes[:, None, None], scene.channels, axis=1)

    def changes(self, scene: Scene, draws: FloatArray) -> FloatArray:
        warmer = draws * scene.minutes
        return np.repeat(self.bias_slope * warmer[..., None], scene.channels, axis=-1)


_STATED = (Tilt, Accelerometer, Heading, Latitude, EarthRate, Gravity, Index, Drift)
"""Those whose size the bench file's `uncertainties` have under the source's own id."""


def stated_by(model: Model | None, conditions: Conditions, *, measured: bool) -> tuple[Source, ...]:
    """Return what a model states that these collects scatter by, as a source; none where it states nothing."""
    return (Stated(model, measured=measured),) if model is not None and model.stated_scatter(conditions) else ()


def sources(
    known: UncertaintySection, where: str, slope_degC_per_min: float, slope_origin: str, noise_origin: str
) -> tuple[Source, ...]:
    """Return every source, sized as a bench file's `uncertainties` say; `where` names that file.

    `slope_degC_per_min` is one standard deviation of how fast the temperature still changes.
    """

    def origin(key: str) -> str:
        return f"{where}: uncertainties.{key}" if key in known.model_fields_set else f"default of uncertainties.{key}"

    return (
        Noise(1.0, noise_origin),
        Instability(known.bias_instability, origin("bias_instability")),
        *(kind(getattr(known, kind.id), origin(kind.id)) for kind in _STATED),
        Soak(slope_degC_per_min, f"{slope_origin}; {origin('bias_slope')}", known.bias_slope),
    )


def _turned(vectors: FloatArray, axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Turn vectors (1 or d, n, 3) about axes (n, 3) of length 1, or 0: not at all, by angles (d,) (Rodrigues)."""
    x, y, z = axis.T
    zero = np.zeros_like(x)
    across = _each_row(np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)).T
    once = _flat(vectors) @ across
    turned = _flat(vectors) + np.sin(angle)[:, None] * once + (1.0 - np.cos(angle))[:, None] * (once @ across)
    return np.asarray(turned.reshape(-1, *axis.shape))


def _flat(vectors: FloatArray) -> FloatArray:
    """Return (..., n, 3) as (..., 3n): many small products become one large one."""
    return vectors.reshape(*vectors.shape[:-2], -1)


def _each_row(matrices: FloatArray) -> FloatArray:
    """Return matrices (n, c, b), one for each collect, as one that acts on all collects at once, (n·c, n·b)."""
    n, c, b = matrices.shape
    together = np.zeros((n, c, n, b))
    together[np.arange(n), :, np.arange(n), :] = matrices
    return together.reshape(n * c, n * b)


def _constant(scene: Scene, axes: FloatArray) -> FloatArray:
    """Return bench axes (k, 3) at every collect, shape (k, n, 3)."""
    return np.broadcast_to(axes[:, None, :], (len(axes), len(scene.axes), 3))
