"""The result of `hil thermal` as one document (schema hil.thermal/1), and its findings in words."""

from functools import cache
from typing import Any

from hil.analysis.thermal.choice import FALSE_ALARM, Improvement
from hil.analysis.thermal.estimate import Estimates
from hil.analysis.thermal.fit import DESCRIBES, ParameterFit, SensorFit, ThermalFit
from hil.campaign.stand_ins import temperature_of
from hil.files.document import picked, plain
from hil.files.page import templates
from hil.solve.document import not_solved
from hil.solve.omissions import what_is_wrong
from hil.solve.uncertain import CONFIDENCE
from procedures.words import counted, listed, percent, significant

_HARDLY = 0.1  # of what rates are wrong by with constants: who takes less away has hardly improved a unit


def thermal_document(result: ThermalFit) -> dict[str, Any]:
    """Return what `hil thermal --json` prints: finite numbers, null where a thing is not known."""
    return {
        "schema": "hil.thermal/1",
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
    return str(_words().parameter(each))


def verdict_in_words(fit: SensorFit) -> str:
    """Say whether modelling in software improves the unit, by how much, and with what confidence."""
    return str(_words().verdict(fit))


@cache
def _words() -> Any:
    environment = templates(__package__)
    environment.globals |= {each.__name__: each for each in (counted, listed, percent, significant)}
    environment.globals |= {"FALSE_ALARM": FALSE_ALARM, "DESCRIBES": DESCRIBES, "HARDLY": _HARDLY}
    return environment.get_template("words.txt.j2").module
