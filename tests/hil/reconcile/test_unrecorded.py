"""What was not recorded withholds a name or is stood in for; one odd cause does not stand in for several usual ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, FloatArray, Series
from hil.campaign.stand_ins import with_stand_ins
from hil.model.effects.series import JumpInCollect, SettlingInCollect
from hil.model.effects.thermal import InsufficientSoak, WarmUp
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.scattering import what_scatters
from hil.report.content import gather, to_do
from tests.hil.analysis.thermal.nights import rotor_night
from tests.hil.model.effect_conditions import ROTOR
from tests.hil.reconcile.hidden_effects import (
    EIGHT,
    Rows,
    base_rates,
    both,
    campaign_of,
    hidden_campaign,
    lay_out,
    noise,
)
from tests.hil.solve.runs_of_a_unit import campaign as runs_at_their_temperatures


def with_columns(campaign: Campaign, **columns: FloatArray | None) -> Campaign:
    """The campaign with columns added, replaced, or (None) left out."""
    collects = campaign.sensors[2]
    present = {k: v for k, v in {**collects.conditions.columns, **columns}.items() if v is not None}
    conditions = replace(collects.conditions, columns=present)
    own = Collects(conditions, collects.rates_deg_per_hr, collects.rates_se_deg_per_hr)
    return replace(campaign, sensors={2: own})


def names(result: Reconciliation) -> set[str]:
    """The first effect's id with those of its rivals."""
    first = result.effects[0]
    return {first.id} | {rival.id for rival in first.confusable_with}


def warm(rows: Rows) -> np.ndarray:
    """A bias that follows temperature, which rises through the night."""
    return both(rows.temperature - 20.0, 0.12, -0.1)


@pytest.mark.slow
def test_the_setpoint_stands_in_for_a_temperature_that_was_not_recorded() -> None:
    """Said in the notes. The setpoint is not the temperature: drift fits about as well, but no name is certain."""
    campaign = with_columns(hidden_campaign(7, warm, thermal=False), temperature_degC=None, dTdt_degC_per_min=None)
    result = reconcile(campaign, "matrix-6", prove=False)
    assert "bias_T" in names(result)
    assert result.verdict == "ambiguous"
    assert any("setpoint_degC stands in for it" in note for note in result.notes)


@pytest.mark.slow
def test_a_law_of_temperature_in_any_form_is_as_sure_as_the_rivals_of_its_name() -> None:
    """A bias on a straight line may follow the case instead, whose temperature nobody recorded."""
    first = reconcile(runs_at_their_temperatures(24, 3, seed=11, scatter=0.5), "matrix-6", prove=False).effects[0]
    case = next(rival for rival in first.confusable_with if rival.id == "demod")
    assert first.id == "bias_T"
    assert first.kind == "ambiguous"
    assert case.probability == pytest.approx(0.1 * first.probability)


@pytest.mark.slow
def test_without_any_temperature_a_rising_bias_is_never_named() -> None:
    """Ageing, drift or a temperature that nobody wrote down: ambiguous, and the temperature is what to record."""
    unknown = dict.fromkeys(hidden_campaign(7).sensors[2].conditions.columns)
    result = reconcile(with_columns(hidden_campaign(7, warm, thermal=False), **unknown), "matrix-6")
    assert result.verdict == "ambiguous"
    assert "bias_T" in names(result)
    assert names(result) & {"drift", "ageing"}
    assert sum([result.effects[0].probability, *(r.probability for r in result.effects[0].confusable_with)]) <= 1.0
    assert result.next_experiment is not None
    assert result.next_experiment["impossible"] is False or "record" in result.next_experiment["why"]


def test_a_condition_is_recognised_under_another_spelling() -> None:
    """Volts of a supply, an rms vibration, the rotor's period: what effects ask for by names of their own."""
    plain = hidden_campaign(7)
    supply = plain.sensors[2].conditions.columns["supply_V"]
    spelled = with_columns(plain, supply_V=None, unit_supply_volts=supply, vibration_g_rms=supply, rotor_period=supply)
    columns = with_stand_ins(spelled).sensors[2].conditions.columns
    assert {"supply_V", "vibration_rms_g", "spin_period_us"} <= set(columns)
    assert np.array_equal(columns["supply_V"], supply)
    assert with_stand_ins(plain) is plain


def test_two_candidates_for_one_condition_are_not_guessed_between() -> None:
    """Which of two supplies feeds the unit is the laboratory's to say."""
    plain = hidden_campaign(7)
    supply = plain.sensors[2].conditions.columns["supply_V"]
    two = with_columns(plain, supply_V=None, supply_5V=supply, supply_28V=supply)
    assert "supply_V" not in with_stand_ins(two).sensors[2].conditions.columns


@pytest.mark.slow
def test_one_run_that_stands_alone_may_be_a_state_or_scatter() -> None:
    """A bearing's other state and a turn-on bias are the same in one run: ambiguous, and it is said what parts them.

    Unless power is known to have been on from the run before to the one after.
    """
    alone = hidden_campaign(7, lambda r: both(r.run == 6, 9.0, -9.0))
    result = reconcile(with_columns(alone, time_since_power_on_s=None), "matrix-6-thermal")
    assert result.verdict == "ambiguous"
    assert {"jump", "turnon"} <= names(result)
    assert result.next_experiment is not None
    assert "separates jump from turnon" in result.next_experiment["why"]
    start_s = alone.sensors[2].conditions.start_s
    result = reconcile(with_columns(alone, time_since_power_on_s=start_s + 600.0), "matrix-6-thermal")
    assert result.verdict == "named"
    assert "jump" in names(result)
    assert "turnon" not in names(result)


@pytest.mark.slow
def test_a_rotor_beside_a_constant_has_an_acceleration_sensitivity() -> None:
    """GS and MU together are the restricted g-sensitivity, not a magnet of eighteen times the usual size."""
    result = reconcile(hidden_campaign(7, thermal=False), "constant", prove=False)
    assert [effect.id for effect in result.effects] == ["g_sensitivity"]
    values = {p["name"]: p["value"] for p in result.effects[0].parameters}
    assert values["GAA"] == pytest.approx(60.0, abs=2.0)
    assert values["GBA"] == pytest.approx(25.0, abs=2.0)


def wrong_signs(rows: Rows) -> np.ndarray:
    """Both level components of the earth rate were used with the wrong sign."""
    theta = np.deg2rad([{"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}[p] for p in rows.position])
    level = 15.041067 * np.cos(np.deg2rad(34.6))
    h = np.deg2rad(rows.heading)
    return -2.0 * level * np.stack([np.sin(h) * np.cos(theta), np.cos(h)], 1)


@pytest.mark.slow
def test_two_wrong_signs_of_the_earth_rate_lead_over_an_error_of_fifty_times_the_usual_size() -> None:
    """The vertical component, which no collect shows, does not speak against it."""
    campaign = hidden_campaign(7, wrong_signs, thermal=False, headings=(30.0, 120.0, 210.0))
    result = reconcile(campaign, "matrix-6", prove=False)
    assert result.effects[0].id == "frame"
    assert result.effects[0].probability > 0.5


@pytest.mark.slow
def test_two_usual_causes_are_weighed_against_one_that_is_not() -> None:
    """MU and a GS that thins out with heat: convection is both at once, at twelve times its size, and does not lead."""

    def hidden(rows: Rows) -> np.ndarray:
        heat = 0.08 * (rows.temperature - 25.0) * rows.f[:, 0]
        return np.stack([-heat - 4.0 * rows.f[:, 2], 0.7 * heat - 3.2 * rows.f[:, 2]], 1)

    plain = hidden_campaign(7, hidden, thermal=False, mu=False)
    since = np.full(len(plain.sensors[2]), 30.0)
    result = reconcile(with_columns(plain, time_since_index_s=since), "collins-4", prove=False)
    assert result.effects[0].id == "MU_real"
    (other,) = result.effects[1:]  # across GS, as this does, a phase turns it; what weakens does not
    assert other.kind == "ambiguous"
    both_of_it = {other.id: other.probability} | {rival.id: rival.probability for rival in other.confusable_with}
    assert both_of_it["GS_T"] > 0.05
    assert both_of_it["convection"] < 0.05


@pytest.mark.slow
def test_values_that_jump_from_setpoint_to_setpoint_are_no_law_of_temperature() -> None:
    """A bias of its own at each of eight temperatures, up and down: whatever is said, not that it is called bias_T."""
    levels = np.array([-6.0, 5.0, -4.0, 6.0, -5.0, 7.0, -6.0, 5.0])

    def hidden(rows: Rows) -> np.ndarray:
        return both(levels[(rows.run - 1) // 2], 1.0, -0.8)

    result = reconcile(hidden_campaign(7, hidden, thermal=False), "matrix-6", prove=False)
    assert all(effect.id != "bias_T" for effect in result.effects)


@pytest.mark.parametrize("effect", [SettlingInCollect(), JumpInCollect()], ids=lambda effect: effect.id)
def test_bursts_are_neither_settling_nor_a_step(effect: SettlingInCollect | JumpInCollect) -> None:
    """A sample in twelve of eight times the noise, sixty samples a collect: the stated rate holds."""
    rng = np.random.default_rng(3)
    p_values = []
    for _ in range(300):
        rates = rng.normal(0.0, 7.0, (60, 2))
        rates += rng.normal(0.0, 60.0, (60, 2)) * (rng.random((60, 2)) < 0.08)
        p_values += [finding.p_value for finding in effect.test(Series(np.arange(60.0), rates), ROTOR)]
    assert np.mean(np.array(p_values) < 0.001) < 0.004


@pytest.mark.slow
def test_a_step_that_is_a_step_of_temperature_too_is_ambiguous() -> None:
    """In one rising sweep `from run 9 on` and `above 14.8 degC` are one column: another order of temperatures tells."""
    result = reconcile(hidden_campaign(7, lambda r: both(r.run > 8, 12.0, -11.0), thermal=False), "matrix-6")
    assert result.effects[0].id == "jump"
    assert result.verdict == "ambiguous"
    assert any(rival.id.startswith("empirical: B × temperature_degC>") for rival in result.effects[0].confusable_with)
    assert result.next_experiment is not None
    assert "another order" in result.next_experiment["why"]


@pytest.mark.slow
def test_a_step_in_the_middle_of_a_plateau_is_no_step_of_temperature() -> None:
    """From run 8 on, the second of its temperature's two."""
    result = reconcile(hidden_campaign(7, lambda r: both(r.run > 7, 12.0, -11.0), thermal=False), "matrix-6")
    assert [effect.id for effect in result.effects] == ["jump"]
    assert result.verdict == "named"
    assert result.effects[0].shape_in_words == "from run 8 on"


@pytest.mark.slow
def test_poses_are_not_asked_for_where_only_the_order_in_time_tells() -> None:
    """A bias that follows temperature, or ages: whatever is proposed is another time, not another position."""
    night = {"temperatures": tuple(np.arange(-30.0, 61.0, 6.0)), "runs_each": 1}
    campaign = hidden_campaign(7, lambda r: both(r.start_s / r.start_s.max(), 40.0, -40.0), thermal=False, **night)
    result = reconcile(campaign, "matrix-6", prove=False)
    assert result.next_experiment is not None
    assert "Collect" not in result.next_experiment.get("what", "")
    assert "upside down" not in result.next_experiment.get("what", "")


def power_cycled(temperatures_per_cycle: int) -> Campaign:
    """A bias of its own after each power-on, every so many temperatures, with the clock since power-on recorded."""
    cycle_of_run = (np.arange(17) - 1) // (2 * temperatures_per_cycle)
    levels = 9.0 * np.random.default_rng(5).normal(size=(17, 2))
    campaign = hidden_campaign(7, lambda rows: levels[cycle_of_run[rows.run]], thermal=False)
    known = campaign.sensors[2].conditions
    first = [known.start_s[cycle_of_run[known.run] == c].min() for c in cycle_of_run[known.run]]
    return with_columns(campaign, time_since_power_on_s=known.start_s - np.array(first))


@pytest.mark.slow
def test_a_bias_that_changes_with_the_power_cycle_is_a_turn_on_bias() -> None:
    """Two temperatures in each cycle: what changes is the cycle, not the temperature."""
    result = reconcile(power_cycled(2), "matrix-6", prove=False)
    assert [effect.id for effect in result.effects] == ["turnon"]
    assert result.verdict == "named"


@pytest.mark.slow
def test_a_name_of_the_only_sensor_is_as_probable_in_it() -> None:
    """Turn-on bias scatters averages or has a value for each cycle: both are in it (it had been .67 of .998)."""
    rows = lay_out(np.random.default_rng(3), (-10.0, 45.0, -10.0, 45.0), 3)
    cycle = (rows.run - 1) // 3
    rates = base_rates(rows, thermal=False) + noise(rows, np.random.default_rng(12), run_bias=0.0)
    rates[:, 0] += np.array([0.0, 3.0, -2.5, 1.5])[cycle]
    began_s = np.array([rows.start_s[cycle == each].min() for each in cycle])
    cycled = with_columns(campaign_of(rows, rates), time_since_power_on_s=rows.start_s - began_s + 1800.0)
    (effect,) = reconcile(cycled, "matrix-6", prove=False).effects
    assert (effect.id, effect.of_sensor) == ("turnon", {2: pytest.approx(effect.probability)})


@pytest.mark.slow
def test_a_power_cycle_per_temperature_cannot_be_told_from_the_temperature() -> None:
    """One cycle at each: ambiguous with bias_T, and several cycles at one temperature are to be measured."""
    result = reconcile(power_cycled(1), "matrix-6", prove=False)
    assert result.verdict == "ambiguous"
    assert {"turnon", "bias_T"} <= names(result)
    assert result.next_experiment is not None
    assert "power cycles" in result.next_experiment["why"]


def test_what_decays_may_be_the_temperature_of_a_unit_without_a_thermometer() -> None:
    """The setpoint stands in: a bias that follows how the unit warms itself, or nears it, decays all the same."""
    plain = hidden_campaign(7)
    alone = with_stand_ins(with_columns(plain, temperature_degC=None, dTdt_degC_per_min=None))
    for effect in (WarmUp(), InsufficientSoak()):
        assert effect.aliases_for(alone.sensors[2].conditions) == {"bias_T": 1.0}
        assert effect.aliases_for(plain.sensors[2].conditions) == {}


def test_a_first_plateau_may_have_been_reached_from_any_laboratory() -> None:
    """Rooms of 18.5 to 27.5 °C: one of those that are tried has the first step of 50 °C right to some per cent."""
    rows = hidden_campaign(7).sensors[2].conditions
    first = rows.columns["setpoint_degC"][0]
    for room_degC in (18.5, 21.0, 23.0, 25.0, 27.5):
        steps = [tried["from_degC"] - first for tried in InsufficientSoak().shape_grid(rows)]
        assert min(abs(step / (room_degC - first) - 1.0) for step in steps) < 0.035


@pytest.mark.slow
def test_the_written_term_has_the_room_that_it_was_found_for() -> None:
    """Cold rows that stand as far from the setpoint as the laboratory was: the model that is written has them."""
    plain = hidden_campaign(7, quiet=0.3)
    rows = plain.sensors[2]
    shape = {"tau_min": 25.0, "from_degC": 26.0}
    soaking = InsufficientSoak().columns(rows.conditions, None, shape) @ np.array([2.0, -1.8])
    campaign = replace(plain, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + soaking)})
    result = reconcile(campaign, "matrix-6-thermal", prove=False)
    (term,) = (each for each in result.model_after.terms if each.effect == "soak_insufficient")
    assert term.shape["from_degC"] == 26.0
    assert "the unit coming from 26 °C" in result.effects[0].shape_in_words
    left = campaign.sensors[2].rates_deg_per_hr - result.model_after.rates(rows.conditions)
    assert float(np.sqrt(np.mean(left[:8] ** 2))) < 2.0


@pytest.mark.slow
def test_a_remainder_follows_temperature_where_the_bias_is_no_straight_line() -> None:
    """The unit's thermometer was not recorded: b is dB/dT, of another size and sign in the heat than in the cold.

    With one b for all temperatures a curve over the time, a jump and a walk stood beside it.
    """
    plain = hidden_campaign(3, thermal=False, quiet=0.3, temperatures=EIGHT[::2])
    rows = plain.sensors[2]
    shape = {"tau_min": 18.0, "from_degC": 20.0}
    left = InsufficientSoak().columns(rows.conditions, None, shape)[:, 0, 0]
    setpoint = rows.conditions.columns["setpoint_degC"] - 25.0
    bias = [slope * (setpoint - left) + curve * (setpoint - left) ** 2 for slope, curve in ((2.0, -0.04), (-1.0, 0.03))]
    campaign = replace(plain, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + np.stack(bias, 1))})
    alone = with_columns(campaign, temperature_degC=None, dTdt_degC_per_min=None)
    found = reconcile(alone, "matrix-6", prove=False).effects
    assert {effect.id for effect in found} == {"bias_T", "soak_insufficient"}


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize(
    ("columns", "lacks"),
    [
        ((), True),
        (("setpoint_degC",), True),
        (("a copy of it", "setpoint_degC"), True),
        (("one number",), True),
        (("temperature_degC", "setpoint_degC"), False),
    ],
)
def test_what_changes_from_run_to_run_may_follow_a_temperature_that_nobody_recorded(
    columns: tuple[str, ...], lacks: bool
) -> None:
    """Then somebody has to act: a bias anew in every run is no noise before the unit's thermometer was looked at."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng)
    offsets = 4.0 * rng.normal(size=(rows.run.max() + 1, 2))[rows.run]
    one = campaign_of(rows, base_rates(rows, thermal=False) + noise(rows, rng, run_bias=0.0) + offsets)
    known = {
        "temperature_degC": rows.temperature,
        "setpoint_degC": rows.setpoint,
        "a copy of it": rows.setpoint,
        "one number": np.full(len(rows), 23.0),
    }
    there = {name if name in one.sensors[2].conditions.columns else "temperature_degC": known[name] for name in columns}
    plain = with_columns(one, **dict.fromkeys(one.sensors[2].conditions.columns))
    result = reconcile(with_columns(plain, **there), "matrix-6", prove=False)
    assert result.verdict == "none"
    assert result.to_record == what_scatters(with_columns(plain, **there)).to_record == ["temperature_degC"] * lacks
    assert ("a record of temperature_degC in every collect" in what_to_do(result)[1]) is lacks
    content = gather(with_columns(plain, **there))
    advice = "ecord temperature_degC in every collect, which what changes from run to run may follow"
    assert any(advice in each for each in to_do(content)) is lacks
    assert any(advice in each for each in content.sensors[0].shown.sentences()) is lacks


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize("runs", [1, 2])
def test_what_changes_from_run_to_run_is_told_from_temperature_by_repeats_alone(runs: int) -> None:
    """MU reseats: with one run at each temperature it may follow that, whichever model asks and in every command."""
    curves = {"GSA": lambda t: 55.0 + 0.0 * t, "MUA": lambda t: 5.0 + 0.0 * t, "MUB": lambda t: -6.0 + 0.0 * t}
    made, places = {"MUA": 4.0, "MUB": 4.0}, ("1", "3", "2", "2", "3", "1")
    rng, degC = np.random.default_rng(1), (-30.0, 0.0, 30.0, 60.0)
    one = rotor_night(rng, curves, temperatures_degC=degC, runs=runs, run_to_run=made, positions=places)
    scattering = what_scatters(one)
    for model in ("matrix-6", "collins-4"):
        result = reconcile(one, model, prove=False)
        found = next(each for each in result.effects if each.id == "MU_rr")
        other = [(rival.id, rival.probability) for rival in found.confusable_with if rival.id == "MU_T"]
        assert found.kind == ("ambiguous" if runs == 1 else "named")
        assert other == ([("MU_T", found.probability)] if runs == 1 else [])
        asked = result.next_experiment or {}
        assert ("a second run at a temperature that has one" in str(asked.get("why"))) is (runs == 1)
    assert scattering.named == (() if runs == 1 else ("MU_rr",))
    assert ("something moves the mean, MUA, MUB temperature dependence (" in " ".join(scattering.sentences())) is (
        runs == 1
    )


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_standard_errors_that_are_too_large_are_to_be_seen_to() -> None:
    """Nobody had to act where they were ten times what repeats and residuals show; and nothing scatters."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng)
    one = campaign_of(rows, base_rates(rows, thermal=False) + noise(rows, rng, run_bias=0.0), stated=9.0)
    result, found = reconcile(one, "matrix-6", prove=False), what_scatters(one)
    assert "standard errors: repeats and residuals show others (notes)" in what_to_do(result)[1]
    assert "nothing certainly scatters: white noise (" in " ".join(found.sentences())  # and of no run an offset
    assert "State the standard errors of sensor 2" in " ".join(to_do(gather(one)))
