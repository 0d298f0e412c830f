"""Before a night is spent: which effects a sweep can see, at what size, which look alike, and what would help.

    sights = visibility(conditions, built_in_model("matrix-6"))
    sights.effects[0].kept, sights.effects[0].members, sights.effects[0].smallest

No rates are needed: it is linear algebra on the conditions (`hil.solve.identifiability`). Sizes are those that the
search over the whole catalogue finds with the stated probability (`hil.design.visibility.promise`). Effects that act on
the base's terms need their sizes: from the model, or else typical ones. What an effect does not show, it leaks into the
base's parameters: that is told too.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import compress
from types import MappingProxyType

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.design.visibility.promise import Asked, Rows, Smallest, found_from
from hil.model import Model
from hil.model.effects.base import Base, Effect, Parameter, effect_columns
from hil.model.effects.catalogue import NO_EARTH_RATE, NO_VALUES, askable, named, of_its_history
from hil.model.effects.columns import flattened
from hil.model.effects.prior import UNSEEN, log_in_one, name_odds, shapes_tried
from hil.model.equation import pickoff_rates
from hil.model.forms import default_form, named_form
from hil.solve.identifiability import CANNOT_BE_SEEN, Visible, classes, orthonormal, overlap_table, visible, whitener
from hil.solve.temperatures import fitted_form, law_not_told, same_temperature, told_parameters

AT_EACH = ", calibrated at each temperature"
_VARIES_DEGC = 20.0
_MOST_SHAPES = 12  # of those that are searched, evenly chosen: a map needs no finer search
_TYPICAL_ROTOR = {"BA": 15.0, "BB": -10.0, "GSA": 60.0, "GSB": -25.0, "MUA": 5.0, "MUB": 5.0}
_TYPICAL_SLOPE = (0.2, 0.85)


@dataclass(frozen=True)
class NoiseLevel:
    """What averages scatter by: within a run (white, per collect), and from run to run (bias, and a rotor's GS and MU).

    The defaults are the report's quiet cells and its pooled run-to-run scatter. `source` says whose it is: "assumed",
    "its repeats", or theirs beyond an assumed noise of collects: what changes from run to run decides. What repeats
    show within chance counts, as in every ± of `hil solve`. Where channels are measured, a collect's is the median of
    all, and `channels_deg_per_hr` that of each; so is `run_scatter` that of each parameter, and the others their rms.
    """

    collect_deg_per_hr: float = 0.93
    run_bias_deg_per_hr: float = 1.8
    run_mu_deg_per_hr_per_g: float = 0.0
    run_gs_deg_per_hr_per_g: float = 0.0
    source: str = "assumed"
    channels_deg_per_hr: Mapping[str, float] = field(default_factory=dict)
    at_one_temperature_deg_per_hr: Mapping[str, float] = field(default_factory=dict)
    run_scatter: Mapping[str, float] = field(default_factory=dict)

    def from_run_to_run(self, names: Sequence[str]) -> FloatArray:
        """Return what each of some base parameters scatters by from run to run, (p,), deg/hr or deg/hr/g."""
        usual = {"MU": self.run_mu_deg_per_hr_per_g, "GS": self.run_gs_deg_per_hr_per_g}
        of_bias = {name: self.run_bias_deg_per_hr for name in names if name.startswith("B")}
        return np.array([self.run_scatter.get(n, of_bias.get(n, usual.get(n[:2], 0.0))) for n in names])


@dataclass(frozen=True)
class Sight:
    """How an effect is seen: the fraction of its norm the base leaves, its class, and its smallest visible sizes.

    Of its class are what looks the same, and what would in any shape of it but cannot be tried: this is `unasked`, with
    what would tell it apart.
    """

    effect: Effect
    kept: float
    members: tuple[str, ...]
    smallest: tuple[Smallest, ...]
    leaks: Mapping[str, float]  # base parameter: its shift where the effect has its typical size, in standard errors
    unasked: Mapping[str, str]

    @property
    def best(self) -> Smallest:
        """The parameter that shows best, measured against its typical size."""
        return min(self.smallest, key=lambda one: (one.value / one.parameter.size, one.easiest / one.parameter.size))

    @property
    def least(self) -> float:
        """Its smallest visible size over the largest typical one: in any shape, or, where that is more, the easiest."""
        largest = max(self.best.parameter.typical[1], 1e-300)
        return (self.best.value if self.best.value <= largest else self.best.easiest) / largest

    @property
    def in_sight(self) -> bool:
        """Whether it is found at a size that occurs."""
        return self.visible and self.least <= 1.0

    @property
    def visible(self) -> bool:
        """Whether the base leaves enough of it to be seen at all."""
        return self.kept >= CANNOT_BE_SEEN


@dataclass(frozen=True)
class Sights:
    """The map of one sensor. `overlaps` (k, k) is in the order of `effects`; `reasons` says what cannot be asked."""

    form: str
    effects: tuple[Sight, ...]
    overlaps: FloatArray
    reasons: Mapping[str, str]
    noise: NoiseLevel

    def sight(self, identifier: str) -> Sight | None:
        """Return how one effect is seen; None where it cannot be asked about."""
        return next((sight for sight in self.effects if sight.effect.id == identifier), None)


def visibility(
    conditions: Conditions,
    model: Model | None = None,
    noise: NoiseLevel | None = None,
    sigma: FloatArray | None = None,
    sensors: int = 1,
    as_zero: Sequence[str] = (),
    values: Mapping[str, float] = MappingProxyType({}),
) -> Sights:
    """Return what collects under these conditions can see beside a model's own parameters.

    Without a model it is the fullest that the collects are meant for, with temperature terms where temperature varies.
    `sigma` (n, c) gives standard errors known for each average (NaN: not measured) instead of the noise level's, and
    `values` what parameters are known to be, where a model has none. Parameters that were taken `as_zero` are none of
    the model's: what acts through them in any run shows in none.
    """
    noise = noise or NoiseLevel()
    fitted = full = default_form(conditions)
    of_base, at_each, follow = full.columns(conditions), np.zeros((len(conditions), 0)), ""
    degC = conditions.columns.get("temperature_degC", np.full(1, np.nan))
    if model is not None:
        fitted = fitted_form(model, conditions)
    elif full.name == "matrix-6" and np.ptp(degC) > _VARIES_DEGC:
        thermal = named_form("matrix-6-thermal", conditions)
        if law_not_told(thermal, conditions):  # nor is it a finding of hil reconcile that values follow temperature
            station = same_temperature(conditions)
            at_each, follow = np.equal.outer(station, np.unique(station)[1:]), AT_EACH
        else:
            fitted = thermal
    base = base_values(conditions, model, values)
    asked, reasons = askable(conditions, base)
    every_laid = [_laid(effect, conditions, base) for effect in asked]
    acts = [any(np.any(of_shape) for of_shape in columns) for _, _, columns, _ in every_laid]
    turns = bool(np.any(np.nan_to_num(conditions.w_channels_deg_per_hr)))
    lacks = NO_VALUES if turns or not np.any(base.k) else NO_EARTH_RATE
    reasons |= {effect.id: lacks for effect, does in zip(asked, acts, strict=True) if not does}
    asked, laid = tuple(compress(asked, acts)), [*compress(every_laid, acts)]
    if sigma is None:
        sigma = np.full((len(conditions), len(conditions.sensor.channels)), noise.collect_deg_per_hr)
    whiten = whitener(conditions, sigma, of_base, noise.from_run_to_run(full.names))
    told = fitted.without(as_zero)
    # What is as zero may be anything in each run.
    own = of_base[..., [full.names.index(name) for name in full.names if name in as_zero]]
    of_run = np.equal.outer(conditions.run, np.unique(conditions.run))
    of_told = told.columns(conditions)
    by_place = ((of_told, at_each), (own, of_run))
    several = [np.einsum("ncp,nr->ncpr", of, at).reshape(*of.shape[:2], -1) for of, at in by_place]
    whitened = whiten @ flattened(np.concatenate([of_told, *several], -1))
    absorbed, inverse = orthonormal(whitened), np.asarray(np.linalg.pinv(whitened, rcond=1e-9))
    seen: list[list[Visible]] = []
    leaks: list[dict[str, float]] = []
    many: list[int] = []
    for parameters, _, columns, tried in laid:
        sizes = np.array([parameter.size for parameter in parameters])
        grids = [whiten @ of_shape for of_shape in columns]
        seen.append([visible(grid, absorbed, sizes) for grid in grids])
        many.append(round(tried * np.mean([one.kept > UNSEEN for one in seen[-1]])))
        leaks.append(_leaks(inverse, np.array(grids) * sizes, told.names))
    overlaps = overlap_table(seen)
    kept = [float(np.median([one.kept for one in several])) for several in seen]
    groups = classes(overlaps * np.outer(np.array(kept) >= CANNOT_BE_SEEN, np.array(kept) >= CANNOT_BE_SEEN))
    members = {index: tuple(asked[other].id for other in group) for group in groups for index in group}
    # What these collects do not show is no other name for what they do, nor another shape of it.
    odds = name_odds((effect for effect, shown in zip(asked, many, strict=True) if shown), conditions)
    every = [
        Asked(
            effect,
            *laid[index][:2],
            seen[index],
            math.log(odds.get(named(effect).id, 1.0) / max(many[index], 1)) + log_in_one(effect, sensors),
        )
        for index, effect in enumerate(asked)
    ]
    smallest = found_from(every, Rows(whiten, absorbed, sigma))
    sights = [
        Sight(effect, kept[index], (*members[index], *beside), smallest[index], leaks[index], beside)
        for index, effect in enumerate(asked)
        for beside in [_unasked(effect, conditions, laid[index][1], members[index])]
    ]
    return Sights(fitted.name + follow, tuple(sights), overlaps, reasons, noise)


def _laid(
    effect: Effect, conditions: Conditions, base: Base
) -> tuple[tuple[Parameter, ...], list[Mapping[str, float]], list[FloatArray], int]:
    """Return what is asked about: parameters, of all shapes a few, their columns (n·c, p), and how many all are."""
    tried = [*shapes_tried(effect, conditions, lambda *_: base)]
    if not tried:
        shape = effect.shape_grid(conditions)[0]
        tried = [(shape, effect_columns(effect, conditions, base, shape))]
    picks = np.linspace(0, len(tried) - 1, min(len(tried), _MOST_SHAPES)).round().astype(int)
    few = [tried[k] for k in np.unique(picks)]  # from all over the grid
    every, told = effect.parameters_for(conditions), [*told_parameters(effect, conditions)]
    columns = [flattened(of_shape[:, :, told]) for _, of_shape in few]
    return tuple(every[k] for k in told), [shape for shape, _ in few], columns, len(tried)


def _unasked(
    effect: Effect, conditions: Conditions, shapes: Sequence[Mapping[str, float]], but: Collection[str]
) -> dict[str, str]:
    """Return what a search could not tell from an effect in any of its shapes, with what would tell it apart."""
    of_each = [{of.effect.id: of.remedy for of in of_its_history(named(effect), conditions, each)} for each in shapes]
    shared = set[str].intersection(*map(set, of_each)) - set(but)
    return {name: remedy for name, remedy in of_each[0].items() if name in shared}


def base_values(
    conditions: Conditions, model: Model | None, values: Mapping[str, float] = MappingProxyType({})
) -> Base:
    """Return the base terms that effects act on: a model's, else known `values`, typical of a rotor sensor, or zero."""
    if model is not None and model.has_values(conditions.sensor):
        return model.base_for(conditions)
    form, typical = default_form(conditions), _TYPICAL_ROTOR if conditions.sensor.is_rotor else {}
    bias, k = form.terms(conditions, np.array([values.get(name, typical.get(name, 0.0)) for name in form.names]))
    slope = np.broadcast_to(np.array(_TYPICAL_SLOPE) if conditions.sensor.is_rotor else 0.0, bias.shape)
    rates = pickoff_rates(bias, k, conditions.f_g, np.nan_to_num(conditions.w_channels_deg_per_hr))
    return Base(bias, k, rates, slope, np.zeros_like(k))


def _leaks(inverse: FloatArray, typical: FloatArray, names: Sequence[str]) -> dict[str, float]:
    """Return by how many standard errors a typical effect (k, N, p) moves parameters, by more in half of k shapes."""
    errors = np.sqrt(np.sum(inverse**2, axis=1))
    shifts = np.median(np.linalg.norm(inverse @ typical, axis=2), axis=0)
    return {
        name: float(shift / error)
        for name, shift, error in zip(names, shifts, errors, strict=False)
        if error > 0.0 and shift > 1e-6 * error
    }
