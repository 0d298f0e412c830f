"""The catalogue as a whole: complete, consistent, linear, finite on odd data, and saying what it cannot be asked."""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from hil.campaign import Conditions, Sensor
from hil.errors import InputError
from hil.model.effects.base import Base, Described, Effect, VarianceEffect
from hil.model.effects.catalogue import (
    BASE_EFFECTS,
    EFFECTS,
    FORM_EFFECTS,
    SERIES_EFFECTS,
    VARIANCE_EFFECTS,
    askable,
    effect_by_id,
    entries,
    named,
    of_its_history,
    why_not,
)
from hil.model.effects.columns import flattened
from hil.model.effects.document import shape_in_words
from hil.model.effects.empirical import EmpiricalTerm
from hil.model.effects.noise import Ageing
from hil.model.effects.prior import scatter_log_odds
from hil.model.effects.scatter import drawn
from hil.model.forms import named_form
from hil.solve.identifiability import orthonormal, project_out
from tests.hil.model.effect_conditions import (
    ROTOR,
    campaign,
    one_run,
    power_cycled,
    rotor_base,
    triad_base,
    triad_poses,
)

TWO_AXES = Sensor(3, ("X", "Y", "Z"), {"P": "Z", "Q": "X"})


def _named(entry: Described) -> str:
    return f"{type(entry).__name__}"


def _odd(name: str) -> tuple[Conditions, Base]:
    full = campaign()
    match name:
        case "one run":
            conditions = one_run()
        case "one collect":
            conditions = one_run(("3",))
        case "no condition columns":
            conditions = campaign(every_column=False)
        case "empty cells":
            holed = {key: np.where(np.arange(len(full)) % 3 == 0, np.nan, v) for key, v in full.columns.items()}
            conditions = replace(full, columns=holed)
        case "earth rate unknown":
            conditions = replace(full, w_deg_per_hr=np.zeros_like(full.w_deg_per_hr))
        case "samples of no duration":
            conditions = replace(full, duration_s=np.zeros(len(full)))
        case "triad":
            return triad_poses(), triad_base(triad_poses())
        case "two channels that are no rotor":
            poses = triad_poses()
            base = triad_base(poses)
            pair = replace(poses, sensor=TWO_AXES)
            return pair, Base(base.bias[:, :2], base.k[:, :2], base.rates[:, :2])
        case _:
            conditions = full
    return conditions, rotor_base(conditions)


ODD = [
    "full",
    "one run",
    "one collect",
    "no condition columns",
    "empty cells",
    "earth rate unknown",
    "samples of no duration",
    "triad",
    "two channels that are no rotor",
]


@pytest.mark.parametrize("data", ODD)
def test_columns_are_finite_and_fit_their_parameters_on_odd_data(data: str) -> None:
    """Shape (n, c, p), one finite column per named parameter, at every value of the shape parameters."""
    conditions, base = _odd(data)
    asked, reasons = askable(conditions, base)
    assert {effect.id for effect in asked} | set(reasons) == {effect.id for effect in EFFECTS}
    for effect in asked:
        parameters = effect.parameters_for(conditions)
        assert len({parameter.name for parameter in parameters}) == len(parameters)
        assert all(effect.accepts(parameter.name) for parameter in parameters), effect.id
        assert all(0.0 < parameter.size < np.inf for parameter in parameters), effect.id
        for shape in effect.shape_grid(conditions):
            columns = effect.columns(conditions, base, shape)
            assert columns.shape == (len(conditions), len(conditions.sensor.channels), len(parameters)), effect.id
            assert np.all(np.isfinite(columns)), (effect.id, shape)


@pytest.mark.parametrize("data", ODD)
def test_covariances_are_symmetric_and_never_negative(data: str) -> None:
    """A variance effect's unit covariance is one of some random variable."""
    conditions, _ = _odd(data)
    for effect in VARIANCE_EFFECTS:
        if not effect.applies_to(conditions.sensor):
            continue
        assert len(effect.parameters) == 1
        for shape in effect.shape_grid(conditions):
            covariance = effect.covariance(conditions, shape)
            assert covariance.shape == (len(conditions) * len(conditions.sensor.channels),) * 2
            assert np.allclose(covariance, covariance.T)
            assert np.linalg.eigvalsh(covariance).min() >= -1e-9 * max(np.abs(covariance).max(), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("effect", VARIANCE_EFFECTS, ids=_named)
def test_draws_scatter_as_the_covariance_says(effect: VarianceEffect) -> None:
    """Over many draws, whatever the order of the rows: every covariance within 6 standard errors, none left out."""
    conditions = campaign(temperatures=(-10.0, 20.0), runs_each=2)
    conditions = conditions.rows(np.random.default_rng(3).permutation(len(conditions)))
    shape, rng, count = effect.shape_grid(conditions)[-1], np.random.default_rng(4), 1000
    parts = effect.scatter(conditions, shape)
    draws = np.array([drawn([parts], [conditions], rng)[0].ravel() for _ in range(count)])
    expected = effect.covariance(conditions, shape)
    size = np.diag(expected)
    error = np.sqrt((np.multiply.outer(size, size) + expected**2) / count)
    assert np.all(np.abs(draws.T @ draws / count - expected) <= 6.0 * error + 1e-12)


def test_a_bias_that_wanders_is_between_turn_on_and_white() -> None:
    """At lag tau its correlation is 1/e; over a time much longer than the campaign it is one bias of each channel."""
    conditions = campaign(temperatures=(0.0, 20.0), runs_each=2)
    markov = next(v for v in VARIANCE_EFFECTS if v.id == "markov")
    lag_hr = (conditions.start_s[-1] - conditions.start_s[0]) / 3600.0
    covariance = markov.covariance(conditions, {"tau_hr": lag_hr})[::2, ::2]
    assert covariance[0, -1] == pytest.approx(np.exp(-1.0), rel=1e-3)
    assert np.allclose(markov.covariance(conditions, {"tau_hr": 1e6})[::2, ::2], 1.0, atol=1e-4)
    assert not markov.covariance(conditions, {"tau_hr": 1e6})[::2, 1::2].any()


def test_every_effect_of_the_reference_is_in_the_catalogue(reference: Path) -> None:
    """All ids of effects.csv, in their family; what is added has an id of its own."""
    with (reference / "effects.csv").open(encoding="utf-8") as file:
        rows = {row["id"]: row["family"] for row in csv.DictReader(file)}
    families: dict[str, set[str]] = {}
    for entry in entries():
        families.setdefault(entry.id, set()).add(entry.family)
    assert {
        identifier: family for identifier, family in rows.items() if family not in families.get(identifier, ())
    } == {}
    added = set(families) - set(rows)
    ours = {
        "bias",
        "GS",
        "GS_gain",
        "MU_T",
        "g_sensitivity_T",
        "g_gain",
        "ageing",
        "saturation",
        "markov",
        "GS_rr",
        "G_rr",
        "MU_jump",
        "MU_hyst",
        "noise_T",
    }
    assert added == ours


@pytest.mark.parametrize("entry", list(entries()), ids=_named)
def test_every_entry_describes_itself(entry: Described) -> None:
    """Title, equation, signature, experiment, units; what it is confused with is in the catalogue; no double entry."""
    known = {other.id for other in entries()}
    assert re.fullmatch(r"[A-Za-z0-9_]+", entry.id)
    for text in (entry.title, entry.equation, entry.signature, entry.experiment, type(entry).__doc__):
        assert text
    assert entry.parameters
    assert set(entry.confusable_with) <= known - {entry.id}
    assert all(parameter.unit for parameter in entry.parameters)
    assert all(0.0 <= low <= high for p in entry.parameters for low, high in [p.typical, *p.typical_other.values()])


@pytest.mark.parametrize("effect", [*BASE_EFFECTS, *EFFECTS], ids=_named)
def test_what_an_effect_says_of_others_is_about_effects_on_averages(effect: Effect) -> None:
    """Its kin and the name it is known by are in the catalogue and not itself; odds and weights are positive."""
    for identifier in (*effect.kin, *([effect.known_as] if effect.known_as else [])):
        assert effect_by_id(identifier).id == identifier != effect.id
    assert min(effect.odds, *effect.kin.values(), 1.0) > 0.0
    assert named(named(effect)) is named(effect)
    assert effect.plain_form in {"constant", "line"}


def test_the_history_of_a_jump_depends_on_when_it_acts() -> None:
    """A step after the first run may be what only the first run shows."""
    conditions = campaign(("1", "2", "3"))
    runs, jump = np.unique(conditions.run), effect_by_id("jump")
    assert set(jump.kin_for(conditions, {"from_run": float(runs[1])})) == {"bias_T", "warmup", "soak_insufficient"}
    assert set(jump.kin_for(conditions, {"from_run": float(runs[2])})) == {"bias_T"}
    assert set(jump.kin_for(conditions, {"from_run": float(runs[1]), "from_collect": 2.0})) == {"bias_T"}
    alone = {"from_run": float(runs[2]), "runs_held": 1.0}
    assert set(jump.kin_for(conditions, alone)) == {"bias_T"}  # power was on before it and after it
    assert set(jump.kin_for(replace(conditions, columns={}), alone)) == {"bias_T", "turnon"}


@pytest.mark.parametrize("form", FORM_EFFECTS)
def test_built_in_models_are_the_sums_of_their_effects(form: str) -> None:
    """The columns of the form and of its effects span the same space."""
    conditions = triad_poses() if form == "triad-12" else campaign(("1", "2", "3", "4"), g=(0.97, 0.2, -0.1))
    own = orthonormal(flattened(named_form(form, conditions).columns(conditions)))
    effects = [effect_by_id(identifier).columns(conditions, None, {}) for identifier in FORM_EFFECTS[form]]
    theirs = orthonormal(np.concatenate([flattened(columns) for columns in effects], axis=1))
    assert own.shape == theirs.shape
    assert np.allclose(project_out(own, theirs), 0.0, atol=1e-9)


def test_no_id_stands_twice_among_effects_of_one_kind() -> None:
    """An id may be both an effect on averages and a test within collects, never two of a kind."""
    for kind in ((*BASE_EFFECTS, *EFFECTS), VARIANCE_EFFECTS, SERIES_EFFECTS):
        identifiers = [entry.id for entry in kind]
        assert len(identifiers) == len(set(identifiers))


@pytest.mark.parametrize("effect", EFFECTS, ids=_named)
def test_effects_do_not_change_what_they_are_given(effect: Effect) -> None:
    """Columns are computed from read-only conditions, and are the same when asked again."""
    conditions, base = (campaign(), rotor_base(campaign())) if effect.applies_to(ROTOR) else _odd("triad")
    if effect.id == "turnon":  # asked about only where the power was cycled
        conditions = power_cycled(conditions)
    for array in (conditions.f_g, conditions.w_deg_per_hr, base.rates, base.k, *conditions.columns.values()):
        array.flags.writeable = False
    if why_not(effect, conditions, base):
        pytest.fail(why_not(effect, conditions, base))
    shape = effect.shape_grid(conditions)[0]
    assert np.array_equal(effect.columns(conditions, base, shape), effect.columns(conditions, base, shape))


@pytest.mark.parametrize("effect", [one for one in EFFECTS if one.needs], ids=_named)
def test_an_effect_says_which_column_the_data_lacks(effect: Effect) -> None:
    """Absent and all-empty columns are both missing, by name."""
    conditions = campaign() if effect.applies_to(ROTOR) else triad_poses()
    base = rotor_base(conditions) if effect.applies_to(ROTOR) else triad_base(conditions)
    for need in effect.needs:
        names = need.split("|")
        without = {key: values for key, values in conditions.columns.items() if key not in names}
        assert need.replace("|", " or ") in why_not(effect, replace(conditions, columns=without), base)
        empty = {key: np.full(len(conditions), np.nan) if key in names else v for key, v in conditions.columns.items()}
        assert need in effect.missing(replace(conditions, columns=empty))
        assert effect.missing(conditions) == ()


def test_effects_that_act_on_the_base_refuse_to_be_asked_without_it() -> None:
    """Scale, phase, tilt … need values; a lag needs slopes by temperature."""
    conditions = campaign()
    asked, reasons = askable(conditions, None)
    needing = {effect.id for effect in EFFECTS if effect.needs_base and effect.applies_to(ROTOR)}
    assert needing <= set(reasons)
    assert not needing & {effect.id for effect in asked}
    with pytest.raises(InputError, match="scale acts on the terms of the base model"):
        effect_by_id("scale").columns(conditions, None, {})
    assert "depends on temperature" in why_not(effect_by_id("T_lag"), conditions, rotor_base(conditions, slopes=False))


@pytest.mark.parametrize("rotor", ["MU_real", "phase"])
def test_effects_know_which_sensors_they_exist_in(rotor: str) -> None:
    """MU and phase belong to a rotor; the full matrix may be asked of any sensor."""
    assert "does not exist" in why_not(effect_by_id(rotor), triad_poses(), triad_base(triad_poses()))
    assert not why_not(effect_by_id("g_sensitivity"), campaign(), rotor_base(campaign()))


class _Brought(Ageing):
    """One that imitates what only a rotor has, a bias over temperature, and what only a rotor is the same as."""

    kin = MappingProxyType({"MU_T": 1.0, "bias_T": 1.0})

    def aliases_for(self, conditions: Conditions) -> Mapping[str, float]:
        return {"GS_T": 1.0}


def test_what_cannot_be_in_a_sensor_is_no_rival_that_was_not_recorded() -> None:
    """A triad has neither MU nor GS, whether or not its temperature was recorded."""
    triad, rotor = triad_poses(every_column=False), campaign(every_column=False)
    assert [each.effect.id for each in of_its_history(_Brought(), triad, {})] == ["bias_T"]
    assert [each.effect.id for each in of_its_history(_Brought(), rotor, {})] == ["MU_T", "bias_T", "GS_T"]


def test_typical_sizes_follow_the_technology() -> None:
    """A rotor's range for the rotor; the named technology's, or the span of all, for another sensor."""
    effect = effect_by_id("bias_T")
    assert effect.parameters_for(one_run())[0].typical == (0.2, 2.0)
    mems = replace(triad_poses(), sensor=replace(triad_poses().sensor, technology="MEMS"))
    assert effect.parameters_for(mems)[0].typical == (1.0, 30.0)
    assert effect.parameters_for(triad_poses())[0].typical == (0.005, 30.0)


def test_an_empirical_term_is_a_parameter_times_what_was_logged() -> None:
    """MUA × supply: MUA's own column times the supply less its reference, and it comes back from its id."""
    conditions = campaign()
    term = effect_by_id(EmpiricalTerm("MUA", "supply_V").id)
    columns = term.columns(conditions, None, {"reference": 28.0})
    assert np.allclose(columns[:, 1, 0], -conditions.f_g[:, 2] * (conditions.columns["supply_V"] - 28.0))
    assert not columns[:, 0, 0].any()
    assert term.parameters_for(conditions)[0].unit == "deg/hr/g per supply_V"
    assert term.missing(one_run()) == ()
    assert term.missing(campaign(every_column=False)) == ("supply_V",)
    assert not term.applies_to(triad_poses().sensor)


@pytest.mark.parametrize("wrong", ["empirical:MUA", "empirical:*supply_V", "no_such_effect", "arw"])
def test_unknown_effects_are_refused_by_name(wrong: str) -> None:
    """The message names what was asked for."""
    with pytest.raises(InputError, match=re.escape(wrong)):
        effect_by_id(wrong)


def test_independent_scatter_of_mu_shows_in_collect_3_only() -> None:
    """MU_rr: with level axes only the rows with the spin axis vertical scatter, common within a run."""
    conditions = campaign(runs_each=1, temperatures=(0.0, 20.0))
    covariance = next(v for v in VARIANCE_EFFECTS if v.id == "MU_rr").covariance(conditions)
    assert np.allclose(np.diag(covariance), np.tile([0, 0, 0, 0, 1, 1], 2))


def test_white_noise_scatters_as_one_over_the_root_of_the_collect() -> None:
    """0.12 deg/√hr in 60 s is 0.93 deg/hr."""
    walk = next(v for v in VARIANCE_EFFECTS if v.id == "arw")
    variance = walk.covariance(one_run())[0, 0] * 0.12**2
    assert np.sqrt(variance) == pytest.approx(0.93, abs=0.005)


def test_bias_instability_has_the_allan_deviation_of_its_equation() -> None:
    """0.664 B at ten minutes and at an hour, as flicker noise has: the same at every averaging time."""
    rows = one_run(("1",)).rows(np.zeros(720, dtype=np.int64))
    rows = replace(rows, start_s=20.0 * np.arange(720.0), duration_s=np.zeros(720))
    covariance = next(v for v in VARIANCE_EFFECTS if v.id == "flicker").covariance(rows)[::2, ::2]
    for averaged in (30, 180):
        halves = np.concatenate([-np.ones(averaged), np.ones(averaged)]) / averaged
        variance = 0.5 * halves @ covariance[: 2 * averaged, : 2 * averaged] @ halves
        assert np.sqrt(variance) == pytest.approx(0.664, rel=0.05)


def test_turn_on_bias_is_common_to_a_power_cycle() -> None:
    """Rows of one power cycle share it, rows of another do not; runs stand in where power was not recorded."""
    conditions = campaign(temperatures=(0.0, 20.0), runs_each=2)
    since = np.where(np.arange(12) < 6, conditions.start_s, conditions.start_s - conditions.start_s[6] + 300.0)
    cycled = replace(conditions, columns={"time_since_power_on_s": since})
    turn_on: VarianceEffect = next(v for v in VARIANCE_EFFECTS if v.id == "turnon")
    assert np.array_equal(turn_on.covariance(cycled)[::2, ::2], np.kron(np.eye(2), np.ones((6, 6))))
    unknown = replace(conditions, columns={})
    assert np.array_equal(turn_on.covariance(unknown)[::2, ::2], np.kron(np.eye(4), np.ones((3, 3))))


def test_what_rows_lack_is_said_in_the_effects_own_words() -> None:
    """Of four power cycles on record a turn-on bias had needed "more runs or positions"."""
    conditions = campaign(temperatures=(0.0, 20.0), runs_each=2)
    cycled = replace(conditions, columns={**conditions.columns, "time_since_power_on_s": np.full(12, 300.0)})
    assert "needs three power cycles of several runs each" in why_not(effect_by_id("turnon"), cycled, None)
    assert why_not(effect_by_id("drift"), conditions.rows(np.array([0])), None).endswith("more runs or positions")


def test_base_motion_is_seen_alike_by_parallel_axes_only() -> None:
    """The B axis keeps its direction over the collects; A turns from down to up, so its share changes sign."""
    covariance = next(v for v in VARIANCE_EFFECTS if v.id == "base").covariance(one_run())
    rates = covariance.reshape(3, 2, 3, 2)
    assert rates[0, 1, 1, 1] > 0.9
    assert rates[0, 0, 1, 0] < -0.9


def test_all_pairs_of_effects_have_different_ids_and_titles() -> None:
    """No two entries of a kind can be mistaken for each other by their title."""
    for first, second in itertools.combinations(EFFECTS, 2):
        assert first.title != second.title


def test_a_bias_that_wanders_is_likelier_than_either_of_its_limits() -> None:
    """What these data cannot tell from a walk, or from a bias of each run, is the usual thing rather than its limit."""
    odds = scatter_log_odds(VARIANCE_EFFECTS)
    assert odds["markov"] == pytest.approx(odds["rrw"] + np.log(3.0))
    assert odds["markov"] == pytest.approx(odds["turnon"] + np.log(3.0))


def test_the_value_that_a_shape_is_about_is_said() -> None:
    """A supply's effect is of its nominal voltage, which each sensor's own rows give."""
    assert shape_in_words({"nominal_V": 28.3965}) == "nominal 28.4 V"
    assert shape_in_words({"nominal_us": 10000.0}) == "nominal 10000 µs"
