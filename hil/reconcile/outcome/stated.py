"""What the written model states of noise, and in words: what is ordinary, white noise, and flicker that series show."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from hil.campaign import Campaign, Conditions
from hil.files.numbers import rounded
from hil.model import Model
from hil.model.curve import Constant, Curve, Table
from hil.model.effects.base import VarianceEffect
from hil.model.effects.columns import HOUR_S
from hil.model.effects.inside import OF_NORMAL, OFTEN
from hil.model.effects.noise import BiasInstability, TurnOnBias
from hil.model.effects.prior import ALPHA
from hil.model.forms import bias_names
from hil.model.stated_noise import ScatterTerm, SensorNoise
from hil.reconcile.inside import Wander, wandering
from hil.reconcile.outcome.scatter import FoundScatter
from hil.solve.precision import to_record
from hil.solve.repeats import MISSTATED, SensorRepeats
from hil.solve.temperatures import level_degC, same_temperature
from procedures.words import listed, significant

_WHITE = "deg/sqrt(hr)"
_OF_A_MEDIAN = 1.25  # times as uncertain as a mean is a median of normal numbers
_FLICKER = 2.0  # times as much as averages scatter inside a run, from which on what wanders is none


def with_ordinary(model: Model, noise: Sequence[Mapping[str, Any]], conditions: Mapping[int, Conditions]) -> Model:
    """Return the model whose noise also states what is ordinary, and more than it and the standard errors explain.

    Each bias is drawn anew in every run, or in every collect, beside what is drawn already. Of a sensor without
    standard errors what collects of its quietest channel scatter by is its white noise.
    """
    sections, white = dict(model.noise), _white_unstated(noise)
    for number, (size, se) in white.items():
        root_hr = float(np.sqrt(np.median(conditions[number].duration_s) / HOUR_S))
        walk = Constant(unit=_WHITE, value=root_hr * size, se=root_hr * se)
        sections[number] = sections.get(number, SensorNoise()).model_copy(update={"angle_random_walk": walk})
    for each in noise:
        own = conditions[each["sensor"]]
        name = bias_names(own.sensor)[list(own.sensor.channels).index(each["channel"])]
        for key, size, se in beyond_chance(each, *white.get(each["sensor"], ())):
            section = sections.get(each["sensor"], SensorNoise())
            stated = getattr(section, key)
            grown = _grown(stated.get(name), size, se, own)
            sections[each["sensor"]] = section.model_copy(update={key: {**stated, name: grown}})
    return model.model_copy(update={"noise": sections})


def _white_unstated(noise: Sequence[Mapping[str, Any]]) -> dict[int, tuple[float, float]]:
    """Return what collects scatter by, and its error, deg/hr, in the quietest channel of sensors that state no errors.

    Or in all of them, rms, where none differs from it beyond chance.
    """
    out = {}
    for number in sorted({each["sensor"] for each in noise if each["stated_deg_per_hr"] is None}):
        own = [each for each in noise if each["sensor"] == number]
        told = [[each[f"collect_to_collect_{of}deg_per_hr"] for of in ("", "se_")] for each in own]
        if not any(None in of for of in told):
            quietest, alike = min(told), np.sqrt(np.mean(np.square(told), axis=0)).tolist()
            differ = any(_beside_white(*each, *quietest)[1] is not None for each in told)
            out[number] = tuple(quietest if differ else alike)
    return out


def wanders(
    model: Model, campaign: Campaign, noise: Sequence[Mapping[str, Any]], inside: Sequence[Mapping[str, Any]]
) -> dict[int, Wander]:
    """Return what the series show of the noise of each sensor of which a model states none.

    Nor is anything noise of a sensor in most collects of which something has a name, as found `inside` them. What would
    scatter averages by much more than they do is no flicker: its samples are only filtered.
    """
    out, often = {}, {each["sensor"] for each in inside if each["collects"] > OFTEN * each["asked"]}
    for number in campaign.sensors:
        stated = model.noise.get(number, SensorNoise()).model_fields_set
        if number in often or stated & {"angle_random_walk", "bias_instability"}:
            continue
        own = wandering(campaign, number)
        seen = [each["observed_deg_per_hr"] or np.inf for each in noise if each["sensor"] == number]
        if own is not None and own.within <= _FLICKER * min(seen, default=np.inf):
            out[number] = own
    return out


def beside(noise: Sequence[Mapping[str, Any]], wanders: Mapping[int, Wander]) -> list[dict[str, Any]]:
    """Return what averages scatter by beyond what the flicker of their sensor does."""
    out = []
    for each in noise:
        named = any(effect["id"] == BiasInstability.id for effect in each["scatter"])
        own, left = None if named else wanders.get(each["sensor"]), dict(each)
        for called, known in (("run_offset", own.between), ("collect_to_collect", own.within)) if own else ():
            size, se = left[f"{called}_deg_per_hr"], left[f"{called}_se_deg_per_hr"]
            if size is not None:
                left[f"{called}_deg_per_hr"] = more = float(np.sqrt(max(size**2 - known**2, 0.0)))
                left[f"{called}_se_deg_per_hr"] = se * size / more if se is not None and size - known > se else None
        out.append(left)
    return out


def with_white_noise(
    model: Model, campaign: Campaign, otherwise: float = 0.0, wanders: Mapping[int, Wander] = MappingProxyType({})
) -> Model:
    """Return the model with the white noise that the standard errors show at each temperature, where it states none.

    Of sensors whose noise `wanders`, what neighbours in their series show, and flicker. `otherwise`, deg/√hr, is what
    it is of a sensor without stated errors; 0: nobody knows.
    """
    sections = dict(model.noise)
    for number, rows in campaign.sensors.items():
        section, own = sections.get(number, SensorNoise()), rows.conditions
        white = rows.rates_se_deg_per_hr * np.sqrt(own.duration_s / 3600.0)[:, None]
        flicker = wanders.get(number)
        if flicker is not None:
            own, white = flicker.conditions, flicker.white.copy()
        white[~np.isfinite(white) | (white <= 0.0)] = np.nan
        usual = float(np.nanmedian(white)) if np.isfinite(white).any() else otherwise
        if "angle_random_walk" in section.model_fields_set or usual <= 0.0:
            continue
        white, station, level = np.nan_to_num(white, nan=usual), same_temperature(own), level_degC(own)
        at = [station == k for k in np.unique(station[station >= 0])]
        every = [white, *(white[here] for here in at)]
        apart = [OF_NORMAL * float(np.median(np.abs(of - np.median(of)))) for of in every]  # one may be huge
        usual_se, *se = [_OF_A_MEDIAN * each / of.size**0.5 for each, of in zip(apart, every, strict=True)]
        curve: Curve = Constant(unit=_WHITE, value=usual, se=usual_se)
        if level is not None and len(at) > 1:
            known = [float(np.nanmean(level[here])) for here in at]
            value = [float(np.median(of)) for of in every[1:]]
            curve = Table(unit=_WHITE, table={"temperature_degC": known, "value": value, "se": se})
        noise: dict[str, Any] = {"angle_random_walk": curve}
        if flicker is not None:
            name, size = BiasInstability.id, Constant(unit="deg/hr", value=flicker.size, se=flicker.se)
            term = next((term for term in section.scatter if term.effect == name), ScatterTerm(effect=name))
            term = term.model_copy(update={"parameters": {BiasInstability.parameters[0].name: size}})
            noise["scatter"] = (*(each for each in section.scatter if each.effect != name), term)
        sections[number] = section.model_copy(update=noise)
    return model.model_copy(update={"noise": sections})


def beyond_chance(
    channel: Mapping[str, Any], white: float | None = None, white_se: float = 0.0
) -> Iterator[tuple[str, float, float]]:
    """Yield what a channel scatters by that no model stated: the key of a noise section, the size and its error.

    What collects scatter by is that only beyond standard errors; of rates without any beyond `white` noise, deg/hr.
    """
    for key, called in (("run_to_run", "run_offset"), ("collect_to_collect", "collect_to_collect")):
        size, se = channel[f"{called}_deg_per_hr"], channel[f"{called}_se_deg_per_hr"]
        if key == "collect_to_collect" and channel["stated_deg_per_hr"] is None and size:
            size, se = _beside_white(size, se or 0.0, white, white_se) if white else (0.0, None)
        if se is not None and size > se:
            yield key, size, se


def _beside_white(size: float, se: float, white: float, white_se: float) -> tuple[float, float | None]:
    """Return what collects scatter by beyond white noise, and its error, deg/hr each; None where chance explains it."""
    squares, error = size**2 - white**2, 2.0 * float(np.hypot(size * se, white * white_se))
    more = float(np.sqrt(max(squares, 0.0)))
    return more, 0.5 * error / more if squares > error > 0.0 else None


def not_repeated(noise: Iterable[Mapping[str, Any]], shown: Mapping[int, SensorRepeats], model: Model) -> str:
    """Name the channels that differ from run to run though no run was repeated; empty where none does.

    Beyond the model that was read, or as it states: asked again with what was written, these collects tell no more.
    That may be temperature as well as the runs themselves, and no repeat tells `hil solve` of it.
    """
    differ = {(of["sensor"], of["channel"]) for of in noise if _differs(of)}
    for number, each in shown.items():
        stated = model.noise.get(number, SensorNoise()).run_to_run
        biases = [name for name in each.names if name.startswith("B")]
        differ |= {(number, channel) for channel, bias in zip(each.times_of, biases, strict=False) if bias in stated}
    single = {number for number, each in shown.items() if not each.repeated}
    return _named({"sensor": n, "channel": channel} for n, channel in sorted(differ) if n in single)


def not_between_repeats(noise: Iterable[Mapping[str, Any]]) -> str:
    """Name the channels that differ from run to run, and beyond chance less so between runs of one temperature."""
    return _named(of for of in noise if of.get("repeats_p_value", 1.0) < ALPHA and _differs(of))


def _differs(channel: Mapping[str, Any]) -> bool:
    """Whether a channel has an offset of each run beyond chance."""
    return any(key == "run_to_run" for key, *_ in beyond_chance(channel))


def _named(channels: Iterable[Mapping[str, Any]]) -> str:
    return listed(names) if (names := [f"{of['channel']} of sensor {of['sensor']}" for of in channels]) else ""


def lacking(filed: Campaign, scatter: Iterable[FoundScatter], noise: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return what nobody recorded and what changes from run to run may follow: what was found, or an offset.

    An offset of each run is like a turn-on bias.
    """
    changing: list[tuple[int, VarianceEffect]] = [(size.sensor, size.effect) for size in scatter]
    changing += [(of["sensor"], TurnOnBias()) for of in noise if _differs(of)]
    return sorted({need for n, effect in changing for need in to_record(filed.sensors[n].conditions, effect)})


def _grown(stated: Curve | None, size: float, se: float, conditions: Conditions) -> Curve:
    """Return a size that was stated and one that came to it as one, in square: what follows temperature still does."""
    temperature = conditions.columns.get("temperature_degC", np.zeros(len(conditions)))
    before = 0.0 if stated is None else float(np.sqrt(np.nanmean(stated.at(temperature) ** 2)))
    if stated is None or before <= 0.0:
        return Constant(unit="deg/hr", value=size, se=se)
    return stated.scaled(float(np.hypot(1.0, size / before)))


def scatter_in_words(noise: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say where the averages scatter by more than standard errors and model explain, one sentence per channel."""
    return [
        f"sensor {n['sensor']}, {n['channel']}: about {n['under']}, the averages scatter {_more(n)}, by "
        f"{n['observed_deg_per_hr']:.3g} deg/hr"
        for n in noise
        if _times(n) > MISSTATED
    ]


def at_most(noise: Sequence[Mapping[str, Any]]) -> str:
    """Say by how much more than is explained the channel scatters that does so most; empty where none does."""
    most = max(noise, key=_times, default=None)
    return _more(most) if most and _times(most) > MISSTATED else ""


def _more(channel: Mapping[str, Any]) -> str:
    say = "and the model say" if channel["explained_deg_per_hr"] > 1.01 * channel["stated_deg_per_hr"] else "say"
    return f"{significant(_times(channel))} times as much as their standard errors {say}"


def _times(channel: Mapping[str, Any]) -> float:
    """Return how many times what is explained the averages scatter by: 0 where chance explains it, or nothing is."""
    known = channel["explained_deg_per_hr"] if channel["scatter"] or [*beyond_chance(channel)] else None
    return float((channel["observed_deg_per_hr"] or 0.0) / known) if known else 0.0


def stated_in_words(noise: Sequence[Mapping[str, Any]], wanders: Mapping[int, Wander]) -> list[str]:
    """Say in a sentence what the improved model's noise states beyond that of the model that was read."""
    unstated = _white_unstated(noise)
    every = [(each, *own) for each in noise for own in beyond_chance(each, *unstated.get(each["sensor"], ()))]
    more = "; ".join(
        f"sensor {each['sensor']}, {each['channel']}: {rounded(size, se)} deg/hr from {key.replace('_', ' ')}"
        for each, key, size, se in every
    )
    unlike = {each["sensor"] for each, key, *_ in every if key == "collect_to_collect"}
    errors = "the standard errors and " * any(each["stated_deg_per_hr"] is not None for each in noise)
    errors += "white noise and " * bool(unstated)
    about = " and ".join(dict.fromkeys(each["under"] for each in noise))
    said = f"the noise of model.yaml states what averages scatter by beyond {errors}{about}"
    inside = [f"{each}, which model.yaml states" for each in flicker_in_words(wanders)]
    white = [
        f"sensor {number}: no standard errors are stated; the white noise of model.yaml is what collects "
        f"{'of the quietest channel ' * (number in unlike)}scatter by, {rounded(size, se)} deg/hr in a collect"
        for number, (size, se) in unstated.items()
    ]
    return [*([f"{said}: {more}"] if more else []), *white, *inside]


def flicker_in_words(wanders: Mapping[int, Wander]) -> list[str]:
    """Say of which sensors the series show flicker, and how much."""
    return [
        f"the series of sensor {number} show flicker: a bias instability of {rounded(own.size, own.se)} deg/hr"
        for number, own in wanders.items()
    ]
