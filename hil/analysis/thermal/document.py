"""The result of `hil thermal` as one document (schema hil.thermal/1), and its findings in words."""

from typing import Any

from hil.analysis.thermal.choice import FALSE_ALARM, Improvement
from hil.analysis.thermal.estimate import Estimates
from hil.analysis.thermal.fit import DESCRIBES, ParameterFit, SensorFit, ThermalFit
from hil.campaign.stand_ins import temperature_of
from hil.files.document import picked, plain
from hil.solve.document import not_solved
from hil.solve.omissions import what_is_wrong
from hil.solve.uncertain import CONFIDENCE
from procedures.words import counted, listed, percent, significant

SCHEMA = "hil.thermal/1"
_NOT_SHOWN = "modelling against temperature is not shown to predict a temperature that was left out"
_BY_REPEATS = " by its repeats"
_OTHERWISE = (
    "; hil reconcile may show more, for it foretells runs at temperatures that others have, and knows what is typical"
)
_HARDLY = 0.1  # of what rates are wrong by with constants: who takes less away has hardly improved a unit


def thermal_document(result: ThermalFit) -> dict[str, Any]:
    """Return what `hil thermal --json` prints: finite numbers, null where a thing is not known."""
    return {
        "schema": SCHEMA,
        **picked(result.campaign, "campaign=title source simulated warnings"),
        **what_is_wrong(result.campaign),
        **not_solved(result.campaign),
        "method": (
            "form chosen by leave-one-temperature-out, from every self-calibration with what repeats show in its "
            "uncertainty"
        ),
        "confidence": CONFIDENCE,
        "false_alarm": FALSE_ALARM,
        "sensors": [_sensor(each) for each in result.sensors.values()],
        "not_fitted": [{"sensor": number, "why": why} for number, why in result.not_fitted.items()],
    }


def _sensor(fit: SensorFit) -> dict[str, Any]:
    stations = fit.layout.stations
    return {
        "sensor": fit.number,
        "model": fit.layout.form.name,
        "range_degC": list(fit.layout.range_degC),
        "temperatures_degC": stations.centre_degC.tolist(),
        "temperature_of": temperature_of(fit.layout.collects.conditions),
        "both_directions_degC": stations.centre_degC[stations.both_directions].tolist(),
        "parameters": {name: _parameter(each, fit) for name, each in fit.parameters.items()},
        "rates": {
            "unit": "deg/hr",
            "scatter_of_one_collect": fit.rate_noise_deg_per_hr,
            **_improvement(fit.improvement),
        },
        "verdict": (judged := {"improves": fit.improvement.is_certain, "words": verdict_in_words(fit)}),
        **judged,
        "notes": list(fit.notes),
    }


def _parameter(each: ParameterFit, fit: SensorFit) -> dict[str, Any]:
    choice, found, hysteresis = each.choice, each.coefficients, each.hysteresis
    is_polynomial, centre_degC = choice.form.order is not None, fit.layout.stations.centre_degC
    return {
        **picked(each, "unit form"),
        "order": choice.form.order,
        "reference_degC": fit.layout.middle_degC if is_polynomial else None,
        "range_degC": list(fit.layout.range_degC),
        "coefficients": [
            {
                "value": value,
                "se": se,
                "low": value - width,
                "high": value + width,
                "unit": each.unit + ("" if power == 0 or not is_polynomial else f"/degC{power if power > 1 else ''}"),
                **({"power": power} if is_polynomial else {"temperature_degC": temperature}),
            }
            for power, (value, se, width, temperature) in enumerate(
                zip(*plain([found.values, found.se, found.half_width, centre_degC]), strict=False)
            )
        ],
        "values": [
            {"temperature_degC": temperature, "value": value, "se": se, "sd": se}
            for temperature, value, se in zip(*plain([centre_degC, each.values.values, each.values.se]), strict=True)
        ],
        "leave_one_out_error": choice.errors[each.form],
        "leave_one_out_error_constant": choice.errors["constant"],
        **picked(choice, "leave_one_out_errors=errors steps"),
        **picked(
            each, "repeatability changes p_value chance_constant chance_form", "largest_linear_change=largest_change"
        ),
        "hysteresis": hysteresis and _hysteresis(hysteresis, each.unit),
        "improvement": _improvement(each.improvement),
        **picked(each, "finding confirmed=is_confirmed"),
        "verdict": (words := parameter_in_words(each)),
        "words": words,
    }


def _hysteresis(found: Estimates, unit: str) -> dict[str, Any]:
    value, se, width = map(float, (*found.values, *found.se, *found.half_width))
    low, high = value - width, value + width
    told = plain({"from_below_less_from_above": value, "se": se, "low": low, "high": high})
    return {"unit": unit, **told, "seen": low > 0.0 or high < 0.0}


def _improvement(found: Improvement) -> dict[str, Any]:
    return picked(
        found,
        "held_out_constant=constant held_out_modelled=modelled share_removed=share low high",
        "form_chosen_anew=chosen_anew confidence_that_it_helps=confidence",
    )


def parameter_in_words(each: ParameterFit) -> str:
    """Say what was found about one parameter."""
    errors, unit = each.choice.errors, each.unit
    if each.finding == "constant":
        largest = f"{significant(each.largest_change)} {unit}"
        few = (
            f"; it changes by {significant(each.sigmas)} of its standard errors, but {counted(each.repeats, 'repeat')} "
            f"{'does' if each.repeats == 1 else 'do'} not tell noise well enough to call that more than chance: repeat "
            "runs at a temperature (hil reconcile, which takes for noise what is typical, may call it dependent)"
        )
        return (
            f"not shown{_BY_REPEATS * each.repeated} to depend on temperature (p = {each.p_value:.2g}, "
            f"{counted(each.together, 'parameter')} asked together): a straight line changes less than {largest}"
            f"{few * bool(each.sigmas)}"
        )
    if each.finding == "undescribed":
        cubic = f"; a cubic {errors['cubic']:.3g}" if "cubic" in errors else ""
        chance = each.choice.chance_of_constant
        alone = f" (p = {chance:.2g} of this parameter alone)" if chance > FALSE_ALARM else ""
        return (
            "differs between temperatures beyond its noise, but no curve is shown to predict one left out better"
            f"{alone}: a constant misses it by {errors['constant']:.3g} {unit}{cubic}"
        )
    words = (
        f"{each.form}: it misses a temperature that was left out by {errors[each.form]:.3g} {unit}, a constant by "
        f"{errors['constant']:.3g}"
    )
    if each.improvement.chosen_anew:
        anew = f"; where the form, too, is chosen without that temperature, by {each.improvement.modelled:.3g}"
        words += anew + (": confirmed" if each.is_confirmed else ": not confirmed")
    if each.chance_form is not None and each.chance_form < DESCRIBES:
        words += "; the curve does not go through all values within their noise: its standard errors include that"
    return words


def verdict_in_words(fit: SensorFit) -> str:
    """Say whether modelling in software improves the unit, by how much, and with what confidence."""
    found, noise = fit.improvement, fit.rate_noise_deg_per_hr
    scatter = "what one collect scatters by is not known"
    if noise is not None:
        scatter = f"one collect scatters by {noise:.3g} deg/hr"
    numbers = (
        f"rates at a temperature that was left out are wrong by {found.constant:.3g} deg/hr with constants and by "
        f"{found.modelled:.3g} deg/hr with the curves ({_less(found.share)}; {_less(found.low)} to "
        f"{_less(found.high)} with the temperatures drawn again); {scatter}"
        f"{_confirmed(fit)}"
    )
    differing = [name for name, each in fit.parameters.items() if each.finding not in ("constant", "modelled")]
    differ = ""
    if differing:
        do = "differs" if len(differing) == 1 else "differ"
        differ = f"{listed(differing)} {do} between temperatures, but no curve is shown to foretell one"
    if all(each.choice.form.order == 0 for each in fit.parameters.values()):
        repeated = any(each.repeated for each in fit.parameters.values())
        reason = differ or f"no parameter is shown to depend on temperature{_BY_REPEATS * repeated}"
        return f"{_NOT_SHOWN}: {reason}; rates there are wrong by {found.constant:.3g} deg/hr, {scatter}{_OTHERWISE}"
    if found.is_certain:
        every = all(each.finding == "modelled" for each in fit.parameters.values())
        hardly = "hardly " * (found.share < _HARDLY)
        more = f"{f'; {differ}' * bool(differ)}{'' if every else _OTHERWISE}"
        more += "" if fit.layout.hysteresis else "; none was reached from both sides: it may be time (hil reconcile)"
        return f"modelling against temperature {hardly}improves this unit: {numbers}{more}"
    return f"{_NOT_SHOWN}: {numbers}{_OTHERWISE}"


def _less(share: float) -> str:
    """Say by how much less, or more, rates are wrong with curves than with constants."""
    return f"{percent(abs(share))} {'less' if share >= 0.0 else 'more'}"


def _confirmed(fit: SensorFit) -> str:
    """Say which of the chosen forms the temperatures that were left out confirm, one by one."""
    modelled = [each for each in fit.parameters.values() if each.finding == "modelled"]
    if not fit.improvement.chosen_anew:
        return "; too few temperatures to confirm the forms by choosing them again without one"
    held = ", ".join(each.name for each in modelled if each.is_confirmed) or "none"
    doubtful = ", ".join(each.name for each in modelled if not each.is_confirmed)
    return f"; confirmed one by one: {held}" + (f"; not confirmed: {doubtful}" if doubtful else "")
