"""What a sweep can see is said before it runs: classes, sizes, leaks, and what a change would bring."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, Conditions
from hil.config.bench import load_bench
from hil.config.sweep import load_sweep
from hil.design.conditions import planned_conditions
from hil.design.visibility.document import campaign_document, sweep_document, visibility_document, visibility_text
from hil.design.visibility.map import NoiseLevel, Sights, visibility
from hil.model import Model, built_in_model, load_model
from hil.model.effects.catalogue import EFFECTS
from hil.solve.changes import CHANGES, with_collect_4, with_order_1_3_2, with_second_heading
from procedures.plan import make_plan
from tests.hil.model.effect_conditions import ROTOR, TRIAD, campaign, of_each_position, triad_poses


@pytest.fixture(scope="module")
def published() -> dict[int, Conditions]:
    """The published sweep as planned on the simulated bench."""
    return planned_conditions(make_plan(load_sweep("rd-gc-86-1").procedure()), load_bench("simulated"))


def class_of(sights: Sights, identifier: str) -> set[str]:
    """Return the ids that an effect cannot be told from."""
    sight = sights.sight(identifier)
    assert sight is not None
    return set(sight.members)


def test_the_plan_becomes_the_conditions_of_its_collects(published: dict[int, Conditions]) -> None:
    """24 self-calibrations of three collects for both sensors, at the sweep's temperatures and times."""
    rows = published[2]
    assert len(rows) == 72
    assert set(published) == {1, 2}
    assert np.array_equal(np.unique(rows.run), np.arange(1, 25))
    assert rows.columns["setpoint_degC"][0] == pytest.approx(-29.72, abs=0.01)
    assert np.all(np.diff(rows.start_s) > 0.0)
    assert np.all(rows.duration_s == 60.0)
    # After 45 min at a plateau the sensor stands still near the setpoint, as the twin does; the next runs stiller.
    beside = rows.columns["temperature_degC"] - rows.columns["setpoint_degC"]
    assert np.abs(beside).max() < 4.0
    slopes = np.abs(rows.columns["dTdt_degC_per_min"]).reshape(8, 3, 3).mean(axis=2)
    assert np.all(slopes[:, 0] > 5.0 * slopes[:, 2])


def test_collins_form_cannot_tell_mu_from_even_terms_until_collect_4(published: dict[int, Conditions]) -> None:
    """The report's ambiguity: one class with three collects; with the fourth MU stands apart from k2."""
    three = visibility(published[2], built_in_model("collins-4"))
    assert {"MU_real", "k2", "tilt", "drift"} <= class_of(three, "MU_real")
    extended = with_collect_4(published[2])
    assert extended is not None
    four = visibility(extended, built_in_model("collins-4"))
    assert "k2" not in class_of(four, "MU_real")
    assert "drift" not in class_of(four, "MU_real")


def test_what_the_matrix_form_absorbs_is_said_to_be_invisible(published: dict[int, Conditions]) -> None:
    """Three collects and six parameters per set: nothing constant in time and temperature is left to see."""
    sights = visibility(published[2], built_in_model("matrix-6"))
    hidden = {sight.effect.id for sight in sights.effects if not sight.visible}
    assert {"MU_real", "GS", "k2", "noniso", "misalign", "tilt", "accel", "index", "earth", "frame", "mag"} <= hidden
    assert not {"bias_T", "bias_Tdot", "GS_T", "MU_T", "jump", "swap"} & hidden
    lost = sights.sight("k2")
    assert lost is not None
    assert np.isinf(lost.best.value)
    assert lost.leaks["MUB"] > 1.0  # what does not show, moves MU


def test_a_second_heading_brings_earth_rate_and_magnetics_into_sight(published: dict[int, Conditions]) -> None:
    """Gravity stays, earth rate and field turn."""
    turned = with_second_heading(published[2])
    assert turned is not None
    sights = visibility(turned, built_in_model("matrix-6"))
    for identifier in ("earth", "misalign", "mag"):
        sight = sights.sight(identifier)
        assert sight is not None
        assert sight.visible


@pytest.mark.slow
def test_what_is_asked_of_a_whole_life_stays_linear() -> None:
    """The rates of runs are whitened run by run: a thousand runs take no matrix of all of them."""
    life = campaign(temperatures=np.linspace(-30.0, 60.0, 8).tolist(), runs_each=125)
    tracemalloc.start()
    document = visibility_document({2: life}, "a life", built_in_model("matrix-6"), changes=CHANGES[:1])
    assert tracemalloc.get_traced_memory()[1] < 2e8  # one matrix of all rates with each other: 2.9e8
    tracemalloc.stop()
    assert "weighed on 384 runs of 1000" in visibility_text(document)


def test_less_noise_shows_smaller_effects() -> None:
    """Half the noise, about half the size, as smaller ones are as usual; the fraction kept is the design's alone."""
    conditions = campaign()
    loud, quiet = (visibility(conditions, noise=NoiseLevel(0.8 * k, 1.6 * k)) for k in (1.0, 0.5))
    for one, other in zip(loud.effects, quiet.effects, strict=True):
        assert one.kept == pytest.approx(other.kept)
        if one.visible:
            assert other.best.easiest == pytest.approx(0.5 * one.best.easiest, rel=0.1)


def test_order_1_3_2_keeps_a_drift_out_of_mu(published: dict[int, Conditions]) -> None:
    """It costs nothing, shows nothing new, and MU no longer moves with a drift."""
    before = visibility(published[2], built_in_model("matrix-6"))
    changed = with_order_1_3_2(published[2])
    assert changed is not None
    after = visibility(changed, built_in_model("matrix-6"))
    leaks = [sights.sight("drift").leaks.get("MUB", 0.0) for sights in (before, after)]  # type: ignore[union-attr]
    assert leaks[0] > 1.0
    assert leaks[1] < 0.05 * leaks[0]  # not zero: the bench is not level


def changed(sensors: dict[int, Conditions], model: Model | None = None) -> Any:
    """Return what changes would bring."""
    return visibility_document(sensors, "", model)["changes"]


@pytest.mark.slow
def test_changes_are_ranked_by_what_they_bring(published: dict[int, Conditions]) -> None:
    """For the contractor's form Collect 4 leads; more of the same tells next to nothing apart."""
    model = built_in_model("collins-4")
    found = changed({2: published[2]}, model)
    names = [one["change"] for one in found]
    assert names[0].startswith("add collect 4")
    assert ("MU_real", "k2") in found[0]["separated"]
    assert len(found[names.index("the same sweep twice")]["separated"]) < 2
    order = next(one for one in changed(published) if one["change"] == "take collect 3 before collect 2")
    kept = {n: (("drift", f"{kind}A"), ("drift", f"{kind}B")) for n, kind in (("2", "MU"), ("1", "GS"))}
    assert order["protected_in"] == kept


@pytest.mark.slow
def test_a_change_promises_what_the_map_of_the_changed_collects_says() -> None:
    """Of one run a fourth collect leaves something of a dozen effects, and shows none of a size that occurs."""
    rows = campaign(temperatures=(20.0,), runs_each=1)
    promised = {each["change"]: each["newly_visible"] for each in changed({2: rows})}
    for change in (change for change in CHANGES if change.name in promised):
        after = change.apply(rows)
        assert after is not None
        assert promised[change.name] == [sight.effect.id for sight in visibility(after).effects if sight.in_sight]
    assert promised["add collect 4 (spin axis down) to every run"] == []


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.name)
def test_a_changed_sweep_is_a_sweep(change: object, published: dict[int, Conditions]) -> None:
    """Unique collects in the order of time, |f| as it was, all columns of equal length; or the change does not fit."""
    for conditions in (published[2], campaign(every_column=False), triad_poses()):
        changed = change.apply(conditions)  # type: ignore[attr-defined]
        if changed is None:
            continue
        assert len(np.unique(changed.collect)) == len(changed)
        assert np.all(np.diff(changed.start_s) >= 0.0)
        assert np.allclose(np.linalg.norm(changed.f_g, axis=1), np.linalg.norm(conditions.f_g[0]))
        assert all(len(values) == len(changed) for values in changed.columns.values())
        assert len(changed) >= len(conditions)


def test_collect_4_is_collect_3_turned_over() -> None:
    """Gravity along the spin axis and along A change sign, B stays; earth rate alike; not offered twice."""
    conditions = campaign(g=(0.99, 0.1, -0.05))
    extended = with_collect_4(conditions)
    assert extended is not None
    third, fourth = extended.f_g[extended.position == "3"], extended.f_g[extended.position == "4"]
    assert np.allclose(fourth, third * [-1.0, 1.0, -1.0])
    assert with_collect_4(extended) is None
    assert with_collect_4(triad_poses()) is None


def test_a_size_beyond_all_that_is_searched_for_is_no_size(published: dict[int, Conditions]) -> None:
    """An effect that decays before the first collect shows at 1e22 at most: nobody has that, so it is never."""
    late = replace(published[2], start_s=published[2].start_s + 1e6)
    late.columns["time_since_power_on_s"] = np.full(len(late), 1e6)
    for conditions in (published[2], late):
        for sight in visibility(conditions).effects:
            for one in sight.smallest:
                assert one.value == np.inf or one.value <= 1e3 * one.parameter.typical[1]
    warmup = visibility(late).sight("warmup")
    assert warmup is None or np.isinf(warmup.best.value)


@pytest.mark.slow
def test_document_says_everything_a_program_needs(published: dict[int, Conditions]) -> None:
    """Every askable effect once with kept, class and smallest size; reasons for the others; JSON without NaN."""
    document = visibility_document(published, "sweep", load_model("rd-gc-86-1-truth"))
    text = json.dumps(document, allow_nan=False)
    assert json.loads(text)["schema"] == "hil.visibility/1"
    effects = document["effects"]
    assert isinstance(effects, list)
    asked = {effect["id"] for effect in effects}
    reasons = document["sensors"]["2"]["cannot_be_asked"]  # type: ignore[index]
    assert asked | set(reasons) == {effect.id for effect in EFFECTS}
    assert "needs supply_V" in reasons["supply"]
    for effect in effects:
        assert 0.0 <= effect["kept"] <= 1.0
        assert effect["id"] in effect["class"]
        smallest = effect["smallest_visible"]
        assert smallest["probability"] == 0.9
        least, most = smallest["easiest"]["value"], smallest["value"]
        assert most is None or least <= most * (1.0 + 1e-9)
    not_in_averages = set(document["not_in_averages"])  # type: ignore[call-overload]
    assert {"arw", "rrw", "beat"} <= not_in_averages
    assert not not_in_averages & (asked | set(reasons))  # such as a drift, which shows inside the collects, too


@pytest.mark.slow
@pytest.mark.parametrize(
    "conditions",
    [
        triad_poses(),
        triad_poses(3),
        triad_poses(every_column=False),
        campaign(temperatures=(20.0,), runs_each=1),
        campaign(("3",), temperatures=(20.0,), runs_each=1),
        campaign(every_column=False),
        replace(campaign(), w_deg_per_hr=np.zeros((72, 3))),
    ],
    ids=["triad", "three poses", "bare triad", "one run", "one collect", "bare", "no earth rate"],
)
def test_odd_data_gets_a_map_and_reasons(conditions: Conditions) -> None:
    """Every effect is either mapped or has a reason, and the document is JSON."""
    document = visibility_document({conditions.sensor.number: conditions}, "odd")
    json.dumps(document, allow_nan=False)
    entry = document["sensors"][str(conditions.sensor.number)]  # type: ignore[index]
    assert {effect["id"] for effect in entry["effects"]} | set(entry["cannot_be_asked"]) == {one.id for one in EFFECTS}


def test_what_no_column_lets_ask_is_in_the_class_of_what_it_looks_like() -> None:
    """Two temperatures tell demod from bias_T as little as no record of it, which is told with what to record."""
    rows = campaign(temperatures=(10.0, 40.0), runs_each=3)
    bare = replace(rows, columns={name: of for name, of in rows.columns.items() if name != "case_degC"})
    for conditions, lacks in ((bare, True), (rows, False)):
        document: Any = visibility_document({2: conditions}, "2", built_in_model("matrix-6"), changes=())
        effect = next(each for each in document["effects"] if each["id"] == "bias_T")
        assert effect["class"] == ["bias_T", "demod"]
        assert effect["unasked"] == ({"demod": "record case_degC"} if lacks else {})
        named_together = "so only the group can be named: bias_T, demod (record case_degC)\n"
        assert (named_together in visibility_text(document)) is lacks


def test_sensor_layouts_take_the_form_that_is_meant_for_them() -> None:
    """A rotor over temperature: matrix-6-thermal; at one temperature: matrix-6; a triad: triad-12."""
    assert visibility(campaign()).form == "matrix-6-thermal"
    assert visibility(campaign(temperatures=(20.0,))).form == "matrix-6"
    two = visibility(campaign(temperatures=(0.0, 40.0), runs_each=3))
    assert two.form == "matrix-6, calibrated at each temperature"  # what follows temperature is no finding there
    assert {name: sight.visible for name in ("bias_T", "jump") if (sight := two.sight(name))} == {
        "bias_T": False,
        "jump": True,
    }
    assert visibility(triad_poses()).form == "triad-12"
    assert (ROTOR.is_rotor, TRIAD.is_triad) == (True, True)


@pytest.mark.slow
def test_text_says_what_is_seen_alike_absorbed_and_what_would_help() -> None:
    """The screenful for the contractor's form on the published sweep, and for a campaign marked as simulated."""
    document = sweep_document(load_sweep("rd-gc-86-1"), load_bench("simulated"), built_in_model("collins-4"))
    text = visibility_text(document)
    # Sensor 1 lies at right angles to sensor 2: its spin axis points up and down, so it tells MU from even terms.
    maps = {number: {e["id"]: e["class"] for e in one["effects"]} for number, one in document["sensors"].items()}  # type: ignore[attr-defined]
    assert "k2" in maps["2"]["MU_real"]
    assert "k2" not in maps["1"]["MU_real"]
    alike = next(line for line in text.splitlines() if line.startswith("Look alike") and "MU_real" in line)
    assert "k2" in alike
    assert "  supply: needs supply_V" in text
    # Of a unit that settles within seconds nothing is left in any collect: of one that takes a minute much is.
    settle = next(line for line in text.splitlines() if line.startswith("  settle "))
    assert settle.endswith("typical 5 to 100, sensor 1: in some shapes only, best time constant 60 s")
    assert next(line for line in text.splitlines() if line.startswith("  MU_real ")).endswith(
        "typical 2 to 40, sensor 1"
    )
    small = (
        text.partition("\nToo small to be found, where no larger than what occurs:\n")[2]
        .partition("\n\n")[0]
        .splitlines()
    )
    assert next(line for line in small if line.split()[0] == "k2").endswith("typical 0.1 to 1, sensor 2")
    assert text.index("\n  MU_real ") < text.index("\nToo small to be found") < text.index("\n  k2 ")
    assert "1. add collect 4 (spin axis down) to every run (costs one more collect per run)" in text
    assert "tells apart: " in text
    unpromised = next(line for line in text.splitlines() if line.startswith("Promised at no size"))
    assert {"MU_rr", "flicker", "rrw", "beat"} <= set(unpromised.replace(",", "").split())
    assert "settle" not in unpromised  # which moves averages, too, and has a size above
    assert text.splitlines()[0].endswith("  SIMULATED")  # its bench is
    rates = of_each_position(campaign())
    simulated = Campaign("night", "twin", {2: Collects(campaign(), rates, np.full((72, 2), 0.5))}, simulated=True)
    lines = visibility_text(campaign_document(simulated)).splitlines()
    assert lines[0] == "night  SIMULATED"
    assert "noise, sensor 1: 0.93 deg/hr in a collect; from run to run the bias by 1.8 deg/hr (assumed)" in text
    assert "noise, sensor 2: RA 0.5, RB 0.5 deg/hr in a collect; from run to run nothing (its repeats)" in lines
    looked = "with no effect looked for: what a recorded column explains of it is no noise"
    assert looked not in text  # of what was not observed, or is nothing
    run = campaign().run  # type: ignore[attr-defined]
    rng = np.random.default_rng(1)
    noisy = rates + 5.0 * rng.normal(size=run.max() + 1)[run][:, None] + 0.5 * rng.normal(size=rates.shape)
    restless = Campaign("night", "twin", {2: Collects(campaign(), noisy, np.full((72, 2), 0.5))})
    said = visibility_text(campaign_document(restless))
    assert looked in said
    assert not {"from_run", "runs_held", "from_collect"} & set(said.replace(",", "").split())
    assert any(line.startswith("  k2 (sensor 2: ") and "MUB" in line for line in lines)
    assert not any(line.startswith("  MU_real") for line in lines)  # the model has it


def test_what_the_unit_does_not_stream_is_not_planned_with() -> None:
    """A STIM300 has no thermometer in this stream: the chamber's stands in, as in its night, and nothing has a rate."""
    plan = make_plan(load_sweep("triad-six-positions").procedure())
    columns = planned_conditions(plan, load_bench("espec-stim300-example"))[1].columns
    assert np.array_equal(columns["temperature_degC"], columns["chamber_degC"])
    assert not {"case_degC", "dTdt_degC_per_min"} & set(columns)
