"""In spec, out of spec, or nobody can tell: seeded units in, out and on the line, and how often chance decides."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.against import Comparison, _not_comparable
from hil.analysis.in_spec import _ALONE, _NO_TEMPERATURE, _ONCE, _UNEVEN, InSpec, Word, in_spec_of, judge
from hil.analysis.night_verdict import night_verdict
from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Campaign
from hil.config.limits import Limits, ParameterLimits
from hil.errors import InputError
from hil.solve import repeats, solve_campaign
from hil.solve.repeats import SensorRepeats
from hil.solve.temperatures import NOT_SETTLED
from hil.solve.uncertain import MeanAt, Spread, means_at
from procedures.verdict import Judgement, Verdict
from tests.hil.analysis.thermal.nights import rotor_night

GOOD = Judgement(Verdict.PASS, "fine")
CURVES = {"BA": lambda t: 20.0 + 0.1 * t, "MUB": lambda t: -7.5 + 0.0 * t}
SCATTER = {"BA": 1.0, "MUB": 4.0}


def night(seed: int = 1, runs: int = 3, temperatures: int = 5, **curves: float) -> Campaign:
    """Five temperatures, or fewer; BA 17 … 26 deg/hr, MUB -7.5 deg/hr/g, or as given; white noise of .6 and SCATTER."""
    of = CURVES | {name: (lambda t, value=value: value + 0.0 * t) for name, value in curves.items()}
    at = (-30.0, 0.0, 20.0, 40.0, 60.0)[:temperatures]
    return rotor_night(np.random.default_rng(seed), of, temperatures_degC=at, runs=runs, run_to_run=SCATTER, white=0.6)


def limits(of: Mapping[str, Mapping[str, str]], **more: object) -> Limits:
    """Limits of sensor 2."""
    return Limits.model_validate({"title": "t", "origin": "o", "sensors": {2: dict(of)}, **more})


def judged(campaign: Campaign, of: Limits, earlier: Campaign | None = None) -> InSpec:
    """What `hil solve` says of it."""
    solutions = solve_campaign(campaign)
    comparison = None if earlier is None else Comparison(campaign, earlier)
    return judge(of, repeats(campaign, solutions), solutions, night_verdict("complete", solutions), comparison)


def test_limits_of_two_sensors_judge_the_one_that_was_measured(tmp_path: Path) -> None:
    """Of the other nobody can tell; a sensor that neither has is a mistake in the file."""
    one = night()
    found = in_spec_of(tmp_path, one, solve_campaign(one), "rd-gc-86-1")
    assert found is not None
    assert {each.reason for each in found.characteristics if each.sensor == 1} == {"no run could tell it"}
    assert {each.word for each in found.characteristics if each.sensor == 2 and each.parameter == "BA"} >= {Word.IN}
    assert found.word is Word.UNKNOWN
    other = replace(one, sensors={3: one.sensors[2]})
    with pytest.raises(InputError, match="there is no such sensor"):
        in_spec_of(tmp_path, other, solve_campaign(one), "rd-gc-86-1")


@pytest.mark.slow
def test_what_scatters_more_at_one_temperature_is_nobody_s_to_judge_by_one_uncertainty() -> None:
    """The value alone may still decide, where the limits say so."""
    one = night(runs=6)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[:18, 0] += np.repeat(np.random.default_rng(3).normal(0.0, 6.0, 6), 3)
    cold = replace(one, sensors={2: replace(one.sensors[2], rates_deg_per_hr=rates)})
    rule = limits({"BA": {"low": "0 deg/hr", "high": "50 deg/hr"}})
    assert judged(one, rule).word is Word.IN
    assert {each.reason for each in judged(cold, rule).characteristics} == {_UNEVEN}
    assert judged(cold, rule.model_copy(update={"decision": "simple acceptance"})).word is Word.IN


def test_scatter_without_a_temperature_is_nobody_s_to_judge() -> None:
    """Runs at five temperatures would count as repeats of one."""
    one = night()
    own = {name: of for name, of in one.sensors[2].conditions.columns.items() if not name.endswith("degC")}
    bare = replace(one.sensors[2], conditions=replace(one.sensors[2].conditions, columns=own))
    (found,) = judged(replace(one, sensors={2: bare}), limits({"MUB": {"scatter": "12 deg/hr/g"}})).characteristics
    assert (found.word, found.reason) == (Word.UNKNOWN, _NO_TEMPERATURE)


def test_of_a_soak_that_had_not_ended_nobody_can_tell() -> None:
    """Of what rests on those runs, at any rule; and each line says whose its temperature is, and where the unit was."""
    one, rule = night(), limits({"BA": {"low": "90 deg/hr", "span": "90 deg/hr", "scatter": "90 deg/hr"}})
    rows = one.sensors[2].conditions
    own = rows.columns["temperature_degC"]
    told = {**rows.columns, "setpoint_degC": np.round(own, -1)}
    told["temperature_degC"] = np.where(rows.run <= 3, own + 3.0 * (rows.run - 1), own)
    moving = replace(one, sensors={2: replace(one.sensors[2], conditions=replace(rows, columns=told))})
    for how in ({}, {"decision": "simple acceptance"}):
        cold, *others, scatter, span = judged(moving, rule.model_copy(update=how)).characteristics
        assert {each.word for each in others} == {Word.OUT}
        for each in (cold, scatter, span):
            assert (each.word, each.reason) == (Word.UNKNOWN, f"runs 2–3: the thermometer is off, or {NOT_SETTLED}")
        assert cold.name.startswith("sensor 2, BA at -30.0 °C (as set, unit -30.")
        assert cold.document()["temperature_of"] == "setpoint_degC"
        assert cold.unit_degC == pytest.approx((-30.0, -24.0), abs=0.4)


def test_a_thermometer_that_may_be_off_is_no_soak_that_had_not_ended_for_certain() -> None:
    """It shows 7 °C more in one run of three: curves, and a comparison where it would be in a mean, say both."""
    one = night()
    rows = one.sensors[2].conditions
    own = rows.columns["temperature_degC"]
    told = {**rows.columns, "setpoint_degC": np.round(own, -1), "temperature_degC": own + 7.0 * (rows.run == 2)}
    off = replace(one, sensors={2: replace(one.sensors[2], conditions=replace(rows, columns=told))})
    said = f"the thermometer is off, or {NOT_SETTLED}"
    assert f"it is off, or {NOT_SETTLED}" in next(each.reason for each in solve_campaign(off) if each.run == 2)
    assert f"sensor 2: run 2: {said}: in none of these curves" in fit_thermal(off).sensors[2].notes
    mean = MeanAt(-30.0, (1, 2), {}, {})
    for why, short in ((f"runs 1, 3: it is off, or {NOT_SETTLED}", said), (f"the run: {NOT_SETTLED}", NOT_SETTLED)):
        assert _not_comparable(mean, mean, [{2: ["as it is", why]}, {}]) == f"run 2: {short}"


@pytest.mark.parametrize(
    ("of", "word"),
    [
        ({"BA": {"low": "5 deg/hr", "high": "40 deg/hr"}, "MUB": {"low": "-20 deg/hr/g"}}, Word.IN),
        ({"BA": {"low": "5 deg/hr", "high": "20 deg/hr"}}, Word.OUT),
        ({"MUB": {"high": "-17 deg/hr/g"}}, Word.OUT),
        ({"MUB": {"low": "-7.5 deg/hr/g"}}, Word.UNKNOWN),
        ({"MUB": {"low": "-9 deg/hr/g", "high": "-6 deg/hr/g"}}, Word.UNKNOWN),  # narrower than anybody can tell
        ({"MUB": {"scatter": "12 deg/hr/g"}}, Word.IN),
        ({"MUB": {"scatter": "1.5 deg/hr/g"}}, Word.OUT),
        ({"MUB": {"scatter": "4 deg/hr/g"}}, Word.UNKNOWN),
        ({"BA": {"span": "15 deg/hr"}}, Word.IN),
        ({"BA": {"span": "4 deg/hr"}}, Word.OUT),
        ({"BA": {"span": "9 deg/hr"}}, Word.UNKNOWN),
    ],
)
def test_in_out_and_on_the_line(of: dict[str, dict[str, str]], word: Word) -> None:
    """MUB's limit of -7.5 is where it is; a run's standard error is .6, and it is the scatter of 4 that decides."""
    assert judged(night(), limits(of)).word is word


def test_the_uncertainty_is_that_of_the_units_parameter() -> None:
    """-7.5 with a limit of -10 is four standard errors away, and not in spec: five means of three runs scatter by 4."""
    said = judged(night(), limits({"MUB": {"low": "-10 deg/hr/g"}}))
    assert said.word is Word.UNKNOWN
    assert all(each.interval and 3.0 < each.interval[1] - each.interval[0] < 16.0 for each in said.characteristics)
    alone = judged(night(runs=1), limits({"MUB": {"low": "-90 deg/hr/g", "scatter": "90 deg/hr/g"}}))
    assert {each.reason for each in alone.characteristics} == {_ALONE, _ONCE}


def test_a_mean_of_runs_is_judged_by_its_error_which_has_their_scatter() -> None:
    """As is a run of which a model states what it scatters by; how much the runs scattered nobody can tell from it."""
    rule = limits({"MUB": {"low": "-90 deg/hr/g", "scatter": "90 deg/hr/g"}})
    printed = replace(night(runs=1), rebuilt=True)
    stated = replace(night(runs=1), run_scatter={2: {"MUB": 4.0}})
    for one in (printed, stated):
        *values, scatter = judged(one, rule).characteristics
        assert {each.word for each in values} == {Word.IN}
        assert (scatter.word, scatter.reason) == (Word.UNKNOWN, _ONCE)


def test_simple_acceptance_takes_the_value() -> None:
    """A value on its limit is within; nothing is left that nobody can tell, repeats or not."""
    of = limits({"MUB": {"low": "-10 deg/hr/g", "high": "-3 deg/hr/g"}}, decision="simple acceptance")
    assert Counter(each.word for each in judged(night(runs=1), of).characteristics)[Word.UNKNOWN] == 0
    assert judged(night(2), of).word is Word.OUT
    assert judged(night(), limits({"MUB": {"low": "-99 deg/hr/g"}}, decision="simple acceptance")).word is Word.IN


def test_a_measurement_that_is_not_good_tells_nothing() -> None:
    """Beside what it would say; and a run that is not good tells nothing at its temperature."""
    good, of = night(), limits({"MUB": {"high": "-17 deg/hr/g"}})
    for verdict in (Verdict.INCONCLUSIVE, Verdict.FAIL):
        bad = replace(good, verdicts={2: Judgement(verdict, "the soak had not ended")})
        said = judged(bad, of)
        assert said.word is Word.UNKNOWN
        assert f"the measurement is {verdict}: 1 of 15 solutions; the first is sensor 2, run 2" in said.reason
        assert "of 5 limits would be broken" in said.reason
        # A run that FAILs is in no mean; an INCONCLUSIVE one is, which therefore tells nothing.
        doubted = "" if verdict is Verdict.FAIL else "run 2: not good (INCONCLUSIVE or FAIL)"
        assert said.characteristics[0].reason == doubted
    assert judged(replace(good, verdicts={2: Judgement(Verdict.MARGINAL, "slow")}), of).word is Word.OUT
    unsolved = judge(of, {}, [], night_verdict("complete", []))
    assert (unsolved.word, unsolved.characteristics[0].reason) == (Word.UNKNOWN, "no run could tell it")


def test_a_run_that_cannot_tell_a_parameter_says_nothing_against_its_mean() -> None:
    """Collect 2 of run 2 has no channel A: BA's mean is of the two others, MUA's holds what the run tells of it."""
    good, of = night(), limits({"BA": {"low": "-90 deg/hr"}, "MUA": {"low": "-90 deg/hr/g"}})
    rates = good.sensors[2].rates_deg_per_hr.copy()
    rates[4, 0] = np.nan
    said = judged(replace(good, sensors={2: replace(good.sensors[2], rates_deg_per_hr=rates)}), of).characteristics
    first = {each.parameter: each for each in reversed(said)}
    assert (first["BA"].word, first["BA"].reason) == (Word.IN, "")
    assert (first["MUA"].word, first["MUA"].reason) == (Word.UNKNOWN, "run 2: not good (INCONCLUSIVE or FAIL)")


def test_a_temperature_measured_once_that_nothing_can_be_held_against_tells_nothing() -> None:
    """One wrong collect would look the same; the scatter is told by the temperatures that have repeats."""
    of, thrice = limits({"BA": {"high": "40 deg/hr", "scatter": "90 deg/hr"}}), night(temperatures=4)
    rows = thrice.sensors[2].rows(~np.isin(thrice.sensors[2].conditions.run, (2, 3)))
    rates = rows.rates_deg_per_hr.copy()
    rates[:3] += [60.0, 0.0]
    one = replace(thrice, sensors={2: replace(rows, rates_deg_per_hr=rates)})
    said = judged(one, of)
    assert said.word is Word.UNKNOWN
    assert ["measured once" in each.reason for each in said.characteristics] == [True] + [False] * 4
    assert {each.word for each in said.characteristics[1:]} == {Word.IN}
    assert judged(one, limits({"BA": {"high": "40 deg/hr"}}, decision="simple acceptance")).word is Word.OUT


@pytest.mark.slow
def test_a_change_is_judged_against_an_earlier_campaign_of_the_unit() -> None:
    """In, out, and not known: without one, with itself, with one that is not good, with another unit's."""
    of = limits({"BA": {"change": "6 deg/hr"}})
    now, before, moved = night(1), night(2), night(3, BA=40.0)
    assert judged(now, of, before).word is Word.IN
    assert judged(now, of, moved).word is Word.OUT
    bad = replace(before, verdicts={1: Judgement(Verdict.FAIL, "it moved")})
    other = (
        replace(now, identity={"model": "M", "serial": "1"}),
        replace(before, identity={"model": "M", "serial": "2"}),
    )
    said = [judged(now, of), judged(now, of, now), judged(now, of, bad), judged(other[0], of, other[1])]
    assert {each.word for each in said} == {Word.UNKNOWN}
    reasons = [each.characteristics[0].reason for each in said]
    for reason, words in zip(reasons, ("no earlier", "compared with itself", "is FAIL", "two units"), strict=True):
        assert words in reason


def test_a_change_has_the_uncertainty_of_the_difference_that_is_compared() -> None:
    """Of both means' own: the comparison's ±, and the guard band by its degrees of freedom, are of one difference."""
    now, before = night(1), night(2, runs=2)
    said = judged(now, limits({"BA": {"change": "6 deg/hr"}}), before).characteristics
    compared = [each for each in Comparison(now, before).differences if each.parameter == "BA"]
    for change, one in zip(said, compared, strict=True):
        assert change.interval is not None
        assert one.difference.sd == pytest.approx(np.hypot(*(each.sd for each in one.means)))
        assert np.ptp(change.interval) == pytest.approx(2.0 * one.difference.expanded(2.0))
        assert min(each.freedom for each in one.means) < one.difference.freedom
        assert one.difference.freedom <= sum(each.freedom for each in one.means) * (1.0 + 1e-12)


UNITS = 1500


@pytest.mark.parametrize(
    ("temperatures", "runs", "beyond"),
    [(1, 3, 4.0), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((8, 3, 4.0), (8, 3, 0.0), (4, 2, 1.0)))],
)
def test_a_unit_on_the_limit_is_called_in_spec_as_rarely_as_stated(temperatures: int, runs: int, beyond: float) -> None:
    """2.3 % at k = 2, of a value's limit and of a scatter's; out of spec no more often; each parameter is a unit."""
    rng, count = np.random.default_rng(11), temperatures * runs
    values = rng.normal(0.0, np.hypot(beyond, 1.0), (count, UNITS))
    names = {f"B{unit}": "deg/hr" for unit in range(UNITS)}
    at = [(20.0 * k, tuple(range(k * runs + 1, (k + 1) * runs + 1))) for k in range(temperatures)]
    errors, group = np.ones_like(values), np.repeat(np.arange(temperatures), runs)
    spread = Spread.of(values, errors, group)
    shown = SensorRepeats.of(names, spread, means_at(names, values, errors, group, at[:], spread))
    shown = replace(shown, means=shown.means[:1], told_by="temperature_degC")
    of = ParameterLimits(high=0.0, scatter=float(np.hypot(beyond, 1.0)))
    rule = limits({"BA": {"high": "1 deg/hr"}})
    found = judge(rule.model_copy(update={"sensors": {2: dict.fromkeys(names, of)}}), {2: shown}, [], GOOD)
    for kind in ("value", "scatter"):
        words = Counter(each.word for each in found.characteristics if each.of == kind)
        for word in (Word.IN, Word.OUT):
            assert words[word] / UNITS < 0.0228 + 4.0 * np.sqrt(0.0228 / UNITS), (kind, word)
    if temperatures * beyond > 1:  # where the repeats decide, it is the stated rate and no less
        assert words[Word.IN] / UNITS > 0.01
        assert sum(each.word is Word.IN for each in found.characteristics if each.of == "value") / UNITS > 0.01


def test_the_document_is_finite_and_has_every_characteristic() -> None:
    """Null where there is no limit or nobody can tell; brief is what a night records."""
    said = judged(night(), limits({"MUB": {"low": "-10 deg/hr/g", "change": "3 deg/hr/g", "span": "30 deg/hr/g"}}))
    document = said.document()
    assert [each["characteristic"] for each in document["characteristics"]] == [*["value"] * 5, "span", "change"]
    first, last = document["characteristics"][0], document["characteristics"][-1]
    assert (first["limit_low"], first["limit_high"], first["unit"]) == (-10.0, None, "deg/hr/g")
    assert first["low"] < first["value"] < first["high"]
    assert (last["value"], last["low"], last["verdict"]) == (None, None, "cannot tell")
    assert document["decision"] == "guard band of 2 standard uncertainties (Student's t)"
    assert said.brief().items() <= document.items()
