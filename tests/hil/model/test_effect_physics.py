"""What each effect does as physics asks: signs heating and cooling, decays, memory, order, aliases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import VARIANCE_EFFECTS, effect_by_id
from hil.model.effects.columns import flattened
from hil.model.effects.document import shape_in_words
from hil.model.effects.history import averaged_decay, joined, loop_side, play, setpoint_step
from hil.model.forms import named_form
from hil.solve.identifiability import orthonormal, project_out
from tests.hil.model.effect_conditions import TEMPERATURES, campaign, moved, one_run, rotor_base, triad_poses

histories = st.lists(st.floats(-60.0, 90.0), min_size=1, max_size=60).map(np.array)


def with_columns(conditions: Conditions, **columns: FloatArray) -> Conditions:
    """Return the conditions with some columns replaced."""
    return replace(conditions, columns={**conditions.columns, **columns})


def beside(form: str, identifier: str, conditions: Conditions) -> float:
    """Return the fraction of an effect's norm that a form's parameters do not absorb."""
    base = orthonormal(flattened(named_form(form, conditions).columns(conditions)))
    columns = flattened(_columns(effect_by_id(identifier), conditions))
    return float(np.linalg.norm(project_out(base, columns)) / np.linalg.norm(columns))


def _columns(effect: Effect, conditions: Conditions) -> FloatArray:
    return effect.columns(conditions, rotor_base(conditions), effect.shape_grid(conditions)[0])


def test_temperature_rate_bias_changes_sign_between_heating_and_cooling() -> None:
    """K dT/dt: the same ramp the other way gives the opposite bias, and none when it stands still."""
    heating = with_columns(one_run(), dTdt_degC_per_min=np.array([0.5, 0.0, -0.5]))
    columns = effect_by_id("bias_Tdot").columns(heating, None, {})
    assert np.allclose(columns[0], 0.5 * np.eye(2))
    assert np.allclose(columns[0], -columns[2])
    assert not columns[1].any()


def test_lagging_thermometer_reads_the_rates_of_a_temperature_that_is_already_past() -> None:
    """The rates are those at T + lag·dT/dt: slope of every term times dT/dt per minute of lag."""
    conditions = with_columns(one_run(), dTdt_degC_per_min=np.array([0.5, -0.5, 0.5]))
    base = rotor_base(conditions)
    assert base.bias_slope is not None
    assert base.k_slope is not None
    later = base.bias + 0.5 * base.bias_slope + np.einsum("nca,na->nc", base.k + 0.5 * base.k_slope, conditions.f_g)
    now = base.bias + np.einsum("nca,na->nc", base.k, conditions.f_g)
    columns = effect_by_id("T_lag").columns(conditions, base, {})
    assert np.allclose(columns[0, :, 0], (later - now)[0])
    assert np.allclose(columns[1, :, 0], -(later - now)[1])


def test_soak_remainder_follows_sign_and_size_of_the_step_and_decays() -> None:
    """The setpoint's step times exp(-t/τ) averaged over the collect; nothing before the first step."""
    conditions = campaign(temperatures=(0.0, 20.0, -20.0), runs_each=2)
    since = np.tile(np.repeat([600.0, 1320.0], 3), 3)
    conditions = with_columns(conditions, time_since_setpoint_s=since)
    left = effect_by_id("soak_insufficient").columns(conditions, None, {"tau_min": 12.0})[:, 0, 0]
    assert np.allclose(left[:6], 0.0)
    assert np.allclose(left[12:], -2.0 * left[6:12])
    assert np.allclose(left[9:12], left[6:9] * np.exp(-1.0))


def test_warm_up_averages_its_decay_over_the_collect() -> None:
    """The mean of exp(-t/τ) over the collect, compared with quadrature; at duration zero the instant's value."""
    conditions = with_columns(one_run(), time_since_power_on_s=np.array([60.0, 400.0, 3000.0]))
    left = effect_by_id("warmup").columns(conditions, None, {"tau_min": 5.0})[:, 0, 0]
    t = np.array([60.0, 400.0, 3000.0])[:, None] + np.linspace(0.0, 60.0, 2001)[None, :]
    assert np.allclose(left, np.trapezoid(np.exp(-t / 300.0), dx=60.0 / 2000, axis=1) / 60.0, rtol=1e-6)
    instant = averaged_decay(np.array([60.0]), np.array([0.0]), 300.0)
    assert instant[0] == pytest.approx(np.exp(-0.2))


def test_nothing_has_decayed_before_the_event_or_where_its_time_is_unknown() -> None:
    """A time before the event, or an empty cell, contributes nothing."""
    assert np.array_equal(averaged_decay(np.array([-5.0, np.nan]), np.array([60.0, 60.0]), 10.0), [0.0, 0.0])


def test_gas_convection_builds_up_after_an_index_move() -> None:
    """It begins at nothing and ends as a linear acceleration sensitivity."""
    conditions = with_columns(
        one_run(), time_since_index_s=np.array([0.0, 60.0, 1e6]), temperature_degC=np.full(3, 20.0)
    )
    conditions = replace(conditions, duration_s=np.zeros(3), f_g=np.tile([0.0, 0.0, 1.0], (3, 1)))
    columns = effect_by_id("convection").columns(conditions, None, {"tau_min": 1.0})[:, 0, 2]
    assert columns[0] == 0.0
    assert columns[1] / columns[2] == pytest.approx(1.0 - np.exp(-1.0))


@given(histories, st.floats(0.1, 30.0))
def test_play_operator_never_lags_by_more_than_its_half_width(history: FloatArray, half_width: float) -> None:
    """|T - play(T)| ≤ half-width, and the output moves only when it is pushed."""
    output = play(history, half_width)
    assert np.all(np.abs(history - output) <= half_width + 1e-9)
    still = np.abs(history[1:] - output[:-1]) <= half_width
    assert np.allclose(output[1:][still], output[:-1][still])


@given(histories, st.floats(0.5, 30.0))
def test_play_operator_does_not_care_how_fast_its_history_was_gone_through(history: FloatArray, half: float) -> None:
    """Rate independence: points between, on the way, change nothing."""
    between = np.interp(np.arange(0.0, len(history) - 1 + 1e-9, 0.25), np.arange(len(history)), history)
    assert np.allclose(play(between, half)[::4], play(history, half))


@given(histories, st.floats(0.5, 30.0))
def test_hysteresis_is_antisymmetric(history: FloatArray, half: float) -> None:
    """The mirrored temperature history gives the mirrored loop."""
    time = np.arange(len(history), dtype=np.float64)
    assert np.allclose(loop_side(-history, time, half), -loop_side(history, time, half))


def test_hysteresis_remembers_the_side_it_came_from_at_zero_ramp() -> None:
    """Up and back to 20 °C: +1 coming from below, -1 from above, however long it waits; a shallow turn half-way."""
    history = np.array([0.0, 20.0, 20.0, 60.0, 20.0, 20.0, 25.0])
    side = loop_side(history, np.arange(7.0), 5.0)
    assert np.allclose(side, [0.0, 1.0, 1.0, 1.0, -1.0, -1.0, 0.0])


def test_hysteresis_is_searched_from_no_colder_than_the_record_needs() -> None:
    """It said that a unit came from -80 °C, where nothing was below -25: a half width below the first does as much."""
    one = one_run()
    cold = replace(one, columns={**one.columns, "temperature_degC": np.linspace(-25.2, 60.0, len(one))})
    effect = effect_by_id("hyst")
    for shape in effect.shape_grid(cold):
        assert shape["from_degC"] >= -25.2 - shape["half_width_degC"] - 1.0
        before = {**shape, "from_degC": min(shape["from_degC"], -80.0) if shape["from_degC"] < -25.0 else 20.0}
        assert np.allclose(effect.columns(cold, None, shape), effect.columns(cold, None, before))
        assert "which nobody recorded" in shape_in_words(shape)


def test_hysteresis_uses_the_order_of_time_not_of_rows() -> None:
    """Rows in any order give each row its own place on the loop; rows without temperature none."""
    history = np.array([0.0, 20.0, np.nan, 60.0, 20.0])
    shuffle = np.array([3, 0, 4, 2, 1])
    straight = loop_side(history, np.arange(5.0), 5.0)
    assert np.allclose(loop_side(history[shuffle], np.arange(5.0)[shuffle], 5.0), straight[shuffle])
    assert straight[2] == 0.0


def test_a_history_given_apart_is_the_same_as_one_piece() -> None:
    """The last rows' columns do not depend on whether the rows before them came along or were joined on."""
    conditions = campaign()
    head, tail = _rows(conditions, slice(0, 40)), _rows(conditions, slice(40, None))
    effect, shape = effect_by_id("hyst"), {"half_width_degC": 5.0}
    whole = effect.columns(conditions, None, shape)
    assert np.array_equal(effect.columns(joined(head, tail), None, shape)[40:], whole[40:])


def test_setpoint_steps_are_found_from_temperatures_where_no_setpoint_was_recorded() -> None:
    """The plateaus' mean temperatures step as the setpoints did."""
    conditions = campaign()
    without = replace(conditions, columns={k: v for k, v in conditions.columns.items() if k != "setpoint_degC"})
    assert np.allclose(setpoint_step(without), setpoint_step(conditions), atol=0.5)
    assert setpoint_step(conditions)[-1] == pytest.approx(TEMPERATURES[-1] - TEMPERATURES[-2])


@pytest.mark.parametrize(("order", "bias", "mu"), [(("1", "2", "3"), -0.5, 1.5), (("1", "3", "2"), 0.0, 0.0)])
def test_drift_leaks_into_bias_and_mu_by_the_order_of_the_collects(
    order: tuple[str, ...], bias: float, mu: float
) -> None:
    """In order 1-2-3 a drift d gives dBA = -d/2 and dMUB = +3d/2; in order 1-3-2 neither."""
    conditions = one_run(order)
    effect = effect_by_id("drift")
    rates = moved(_columns(effect, conditions), (1.0, 0.0)).ravel()
    form = named_form("matrix-6", conditions)
    solved = dict(zip(form.names, np.linalg.solve(flattened(form.columns(conditions)), rates), strict=True))
    assert solved["BA"] == pytest.approx(bias, abs=1e-9)
    assert solved["MUB"] == pytest.approx(mu, abs=1e-9)


def test_a_missing_collect_does_not_move_the_others_of_its_run() -> None:
    """The drift's place in the run is counted by time."""
    conditions = campaign()
    kept = np.ones(len(conditions), dtype=bool)
    kept[4] = False  # collect 2 of run 2
    effect = effect_by_id("drift")
    shape = effect.shape_grid(conditions)[0]
    whole = effect.columns(conditions, None, shape)
    assert np.allclose(effect.columns(_rows(conditions, kept), None, shape), whole[kept])


def test_even_contrast_and_mu_are_the_same_in_three_collects_and_apart_with_the_fourth() -> None:
    """The report's ambiguity: kSS fS² looks like MUB fS until the spin axis points down."""
    three, four = one_run(), one_run(("1", "2", "3", "4"))
    for conditions, left in ((three, 0.0), (four, np.sqrt(0.5))):
        base = orthonormal(flattened(named_form("matrix-6", conditions).columns(conditions)))
        even = flattened(effect_by_id("k2").columns(conditions, None, {}))[:, 2:3]
        assert np.linalg.norm(project_out(base, even)) / np.linalg.norm(even) == pytest.approx(left, abs=1e-9)


def test_even_terms_do_not_change_when_the_unit_is_turned_over() -> None:
    """Collect 4 is collect 3 upside down: MU changes sign, k2 does not."""
    conditions = one_run(("3", "4"))
    mu = effect_by_id("MU_real").columns(conditions, None, {})
    even = effect_by_id("k2").columns(conditions, None, {})
    assert np.allclose(mu[0], -mu[1])
    assert np.allclose(even[0], even[1])


@pytest.mark.parametrize("identifier", ["supply", "demod", "bias_grad", "vre", "warmup", "ageing", "hyst", "bias_T"])
def test_what_is_constant_over_a_campaign_is_absorbed_by_the_bias(identifier: str) -> None:
    """Where its driver does not change, an effect cannot be told from a bias."""
    conditions = campaign(temperatures=(20.0,), runs_each=2)
    frozen = {name: np.full(len(conditions), 20.0) for name in conditions.columns}
    frozen["supply_V"] = np.full(len(conditions), 28.0)
    conditions = replace(conditions, columns=frozen, start_s=np.full(len(conditions), 1000.0))
    effect = effect_by_id(identifier)
    shape = {**effect.shape_grid(conditions)[0]}
    if identifier == "supply":
        shape["nominal_V"] = 27.0
    base = orthonormal(flattened(named_form("constant", conditions).columns(conditions)))
    columns = flattened(effect.columns(conditions, None, shape))
    assert np.linalg.norm(project_out(base, columns)) < 1e-9


def test_anisotropy_is_absorbed_while_the_index_axis_is_level_and_shows_when_it_is_not() -> None:
    """With a constant fB nothing excites it; a roll of the bench about axis 3 does."""
    level, rolled = one_run(("1", "2", "3", "4")), one_run(("1", "2", "3", "4"), g=(0.8, 0.6, 0.0))
    rolled = replace(rolled, run=level.run + 1, start_s=level.start_s + 5000.0)
    assert beside("matrix-6", "noniso", level) < 1e-9
    assert beside("matrix-6", "noniso", joined(level, rolled)) > 0.1


def test_earth_rate_error_hides_in_gs_mu_and_bias_at_one_heading_and_not_at_two() -> None:
    """A second heading turns W and not G."""
    one = one_run()
    other = replace(one, w_deg_per_hr=one_run().w_deg_per_hr)
    turned = np.array([[-8.54, 6.2, -10.7], [8.54, 6.2, 10.7], [-10.7, 6.2, 8.54]])
    other = replace(other, w_deg_per_hr=turned, run=one.run + 1, start_s=one.start_s + 5000.0)
    assert beside("matrix-6", "earth", one) < 1e-9
    assert beside("matrix-6", "earth", joined(one, other)) > 0.3


def test_accelerometer_error_is_a_tilt_of_the_other_sign() -> None:
    """The same columns: only a level or |G| can part them."""
    conditions = campaign(("1", "2", "3", "4"))
    base = rotor_base(conditions)
    tilt = effect_by_id("tilt").columns(conditions, base, {})
    assert np.array_equal(effect_by_id("accel").columns(conditions, base, {}), -tilt)


def test_common_index_error_is_a_turn_of_gravity_and_earth_rate_together() -> None:
    """All positions off by one small angle: the finite rotation's change of the rates, to first order."""
    conditions = campaign(("1", "2", "3", "4"), g=(0.9, 0.1, -0.4))
    base = rotor_base(conditions)
    angle = 1e-6
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    f, w = conditions.f_g @ turn.T, conditions.w_deg_per_hr @ turn.T
    change = np.einsum("nca,na->nc", base.k, f - conditions.f_g) + (w - conditions.w_deg_per_hr)[:, :2]
    columns = effect_by_id("index").columns(conditions, base, {})
    assert np.allclose(columns.sum(axis=2) * 1e3 * angle, change, rtol=1e-4, atol=1e-9)


def test_phase_error_keeps_the_length_of_every_pair() -> None:
    """A turn of (RA, RB) is at right angles to it."""
    conditions = campaign()
    base = rotor_base(conditions)
    turned = effect_by_id("phase").columns(conditions, base, {})[..., 0]
    assert np.allclose(np.sum(turned * base.rates, axis=1), 0.0)


def test_faster_spin_is_a_shorter_period() -> None:
    """A period 1 % short of nominal is dN/N = +1 % to first order: gain 1 adds 1 % of the rate."""
    conditions = with_columns(one_run(), spin_period_us=np.full(3, 9900.0))
    base = rotor_base(conditions)
    gain = effect_by_id("spin").columns(conditions, base, {"nominal_us": 10000.0})[..., 0]
    assert np.allclose(gain, base.rates * (10000.0 / 9900.0 - 1.0))


@pytest.mark.parametrize(
    ("identifier", "columns", "shape", "expected"),
    [
        ("bias_T", {"temperature_degC": [25.0, 35.0, 15.0]}, {}, [0.0, 10.0, -10.0]),
        (
            "bias_grad",
            {"case_degC": [30.0, 20.0, 25.0], "temperature_degC": [20.0, 30.0, 25.0]},
            {},
            [10.0, -10.0, 0.0],
        ),
        ("demod", {"case_degC": [25.0, 45.0, 5.0]}, {}, [0.0, 20.0, -20.0]),
        ("supply", {"supply_V": [28.0, 28.28, 27.72]}, {"nominal_V": 28.0}, [0.0, 1.0, -1.0]),
        ("vre", {"vibration_g": [0.0, 0.1, 0.2]}, {}, [0.0, 0.01, 0.04]),
    ],
)
def test_drivers_count_in_the_units_of_their_coefficients(
    identifier: str, columns: dict[str, list[float]], shape: dict[str, float], expected: list[float]
) -> None:
    """°C, %, g²: the first coefficient's column in channel A, and none of it in channel B."""
    conditions = replace(one_run(), columns={name: np.array(values) for name, values in columns.items()})
    found = effect_by_id(identifier).columns(conditions, None, shape)
    assert found[:, 0, 0] == pytest.approx(expected)
    assert not found[:, 1, 0].any()


def test_ageing_counts_days_at_the_middle_of_the_collect() -> None:
    """A collect of two hours that begins 23 hours into the campaign is one day old."""
    late = replace(one_run(), start_s=np.full(3, 23 * 3600.0), duration_s=np.full(3, 7200.0))
    assert effect_by_id("ageing").columns(late, None, {})[:, 0, 0] == pytest.approx(1.0)


def test_a_jump_holds_from_its_run_on() -> None:
    """Nothing before, the whole step in its run and after, or between two collects of it; not before the first."""
    conditions = campaign(temperatures=(0.0, 20.0), runs_each=2)
    effect = effect_by_id("jump")
    assert np.array_equal(effect.columns(conditions, None, {"from_run": 3.0})[:, 0, 0], np.repeat([0, 0, 1, 1], 3))
    within = effect.columns(conditions, None, {"from_run": 1.0, "from_collect": 2.0})[:, 0, 0]
    assert np.array_equal(within, [0, 0, 1, *np.ones(9)])
    steps = [(shape["from_run"], shape["from_collect"]) for shape in effect.shape_grid(conditions)]
    assert sorted(steps) == [(run, after) for run in (1.0, 2.0, 3.0, 4.0) for after in (0.0, 1.0, 2.0)][1:]


def test_gas_convection_thins_out_with_heat() -> None:
    """In proportion to the gas's density: one at 25 °C, and falling as 1/T."""
    conditions = with_columns(
        one_run(), time_since_index_s=np.full(3, 1e6), temperature_degC=np.array([25.0, 25.0, 75.0])
    )
    conditions = replace(conditions, f_g=np.tile([0.0, 0.0, 1.0], (3, 1)))
    columns = effect_by_id("convection").columns(conditions, None, {"tau_min": 1.0})[:, 0, 2]
    assert columns == pytest.approx([1.0, 1.0, 298.15 / 348.15])


def test_retainer_noise_is_a_matter_of_the_cold_and_frost_of_zero() -> None:
    """Hash: nothing above 5 °C, unit density at -25, a quarter of the variance at -10. Frost: 5 °C wide about 0 °C."""
    conditions = with_columns(one_run(), temperature_degC=np.array([20.0, -25.0, -10.0]))
    noise, frost = (next(v for v in VARIANCE_EFFECTS if v.id == name) for name in ("hash", "frost"))
    assert np.diag(noise.covariance(conditions))[::2] == pytest.approx([0.0, 60.0, 15.0])
    conditions = with_columns(one_run(), temperature_degC=np.array([0.0, 5.0, 30.0]))
    assert np.diag(frost.covariance(conditions))[::2] == pytest.approx([1.0, np.exp(-1.0), 0.0], abs=1e-9)


def test_random_walk_grows_with_time() -> None:
    """The variance of a difference between two collects is the hours between them."""
    conditions = campaign()
    walk = next(v for v in VARIANCE_EFFECTS if v.id == "rrw").covariance(conditions)[::2, ::2]
    difference = walk[50, 50] + walk[10, 10] - 2.0 * walk[50, 10]
    assert difference == pytest.approx((conditions.start_s[50] - conditions.start_s[10]) / 3600.0)


def test_triad_scale_error_has_a_value_per_channel() -> None:
    """One rotor has one scale factor; three gyros have three."""
    conditions = triad_poses()
    names = [parameter.name for parameter in effect_by_id("scale").parameters_for(conditions)]
    assert names == ["e_X", "e_Y", "e_Z", "de_dT_X", "de_dT_Y", "de_dT_Z"]


def _rows(conditions: Conditions, rows: slice | np.ndarray) -> Conditions:
    return replace(
        conditions,
        collect=conditions.collect[rows],
        run=conditions.run[rows],
        position=conditions.position[rows],
        start_s=conditions.start_s[rows],
        duration_s=conditions.duration_s[rows],
        f_g=conditions.f_g[rows],
        w_deg_per_hr=conditions.w_deg_per_hr[rows],
        columns={name: values[rows] for name, values in conditions.columns.items()},
    )
