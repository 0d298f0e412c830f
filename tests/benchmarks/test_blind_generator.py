"""Sealed cases are what they say: sizes, covariances, errors that are stated, layouts and mistakes of the data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import Case, Noise, base_columns, make_case, noise_covariance, write_case
from benchmarks.blind.jobs import EIGHT, FOUR, HEADINGS
from benchmarks.blind.night import Design, Night, make_night
from benchmarks.blind.physics import CATALOGUE
from benchmarks.blind.poses import MISTAKES, POSES, QUIET, write_quiet_triad
from benchmarks.blind.real import logs, write_real
from benchmarks.blind.scatter import SCATTER, drawn, left_by
from benchmarks.blind.wider import CYCLED, EVERY_SIZE, ORDINARY, QUARTER, WIDER, YEAR
from hil.campaign.reader import read_campaign
from hil.model.effects.catalogue import VARIANCE_EFFECTS

MATRIX = "matrix-6"


def night(design: Design = FOUR, seed: int = 3) -> Night:
    """The layout alone."""
    return make_night(design, np.random.default_rng(seed))


def covariance(name: str, at: Night, seed: int = 3) -> np.ndarray:
    """Covariance of RA's rows, (n, n), at unit size."""
    n = len(at)
    return SCATTER[name](at, np.random.default_rng(seed))[:n, :n]


def test_reseating_is_one_number_a_run_along_the_spin_axis() -> None:
    """Rows of one run move as their f along S; runs have nothing to do with one another."""
    at = night()
    c = covariance("MU_rr", at)
    same = at.run[:, None] == at.run[None, :]
    assert c[same] == pytest.approx(np.outer(at.f[:, 2], at.f[:, 2])[same])
    assert not c[~same].any()


def test_a_markov_bias_forgets_within_its_time() -> None:
    """1/e of the correlation is left after the time in the name, give or take the unit's fifth."""
    at = night()
    c, lag = covariance("markov@2 h", at), np.abs(at.start_s[:, None] - at.start_s[None, :]) / 3600.0
    tau = -lag[lag > 0.0] / np.log(c[lag > 0.0])
    assert np.ptp(tau) < 1e-6
    assert 1.6 <= tau[0] <= 2.4


def test_a_walk_grows_with_time_and_flicker_with_its_logarithm() -> None:
    """The structure function at 1, 2 and 4 hours: doubling for a walk, equal steps for 1/f."""
    at = night(replace(FOUR, positions=("1",), runs_per_temperature=40, temperatures_degC=(20.0,)))
    hour = round(3600.0 / np.median(np.diff(at.start_s)) * 4)
    for name, ratio in (("rrw", 2.0), ("flicker", 1.0)):
        c = covariance(name, at)
        first, second, third = (c[0, 0] + c[k, k] - 2.0 * c[0, k] for k in (hour, 2 * hour, 4 * hour))
        assert (third - second) / (second - first) == pytest.approx(ratio, abs=0.25)


def test_cold_noise_is_white_and_frost_lies_about_zero() -> None:
    """The one has a diagonal that ends at 5 °C, the other offsets of runs near the melting point."""
    at = night()
    cold = covariance("hash", at)
    assert np.count_nonzero(cold - np.diag(np.diag(cold))) == 0
    assert np.all((np.diag(cold) > 0.0) == (at.rotor < 5.0))
    frost = covariance("frost", at)
    assert abs(at.rotor[np.argmax(np.diag(frost))]) < 8.0
    assert np.diag(frost)[np.abs(at.rotor) > 25.0].max() < 1e-2


def test_a_turn_on_bias_lasts_from_one_power_on_to_the_next() -> None:
    """As many values as the supply came on; within one all rows agree, and the clock since power-on begins anew."""
    at = night(CYCLED)
    c = covariance("turnon", at)
    assert np.linalg.matrix_rank(c) == CYCLED.power_cycles + 1
    begins = np.flatnonzero(np.diff(at.since_power_s) < 0.0) + 1
    assert len(begins) == CYCLED.power_cycles
    assert np.all(np.diff(at.run)[begins - 1] == 1)
    assert not c[begins - 1, begins].any()


def test_base_motion_is_the_same_turn_seen_from_each_position() -> None:
    """Collects 1 and 2 see it with opposite signs in RA, with equal ones in RB."""
    at = night()
    n = len(at)
    c = SCATTER["base"](at, np.random.default_rng(1))
    assert c[0, 1] < 0.0 < c[n, n + 1]
    assert not c[:n, n:].any()


@pytest.mark.parametrize(
    ("name", "least"),
    [
        ("MU_rr", 0.999),
        ("GS_rr", 0.999),
        ("rrw", 0.999),
        ("hash", 0.999),
        ("turnon", 0.999),
        ("flicker", 0.9),
        ("frost", 0.9),
        ("base", 0.9),
    ],
)
def test_two_hands_wrote_the_same_covariance(name: str, least: float, tmp_path: Path) -> None:
    """The catalogue's covariance and the generator's differ in scale, and in what a unit has of its own."""
    case = make_case(4, design=CYCLED)
    effect = next(effect for effect in VARIANCE_EFFECTS if effect.id == name)
    conditions = read_campaign(write_case(case, tmp_path / "case")).sensors[2].conditions
    theirs = effect.covariance(conditions)
    n = len(case.night)
    theirs = theirs.reshape(n, 2, n, 2).transpose(1, 0, 3, 2).reshape(2 * n, 2 * n)
    base = base_columns(case.night, MATRIX)
    q, _ = np.linalg.qr(base)
    beside = np.eye(2 * n) - q @ q.T
    ours, theirs = (beside @ c @ beside for c in (SCATTER[name](case.night, np.random.default_rng(2)), theirs))
    assert np.vdot(ours, theirs) / np.linalg.norm(ours) / np.linalg.norm(theirs) > least


def test_what_is_drawn_has_the_covariance() -> None:
    """Two thousand draws of a wandering bias in twelve collects, of a covariance with no inverse too."""
    at = night(replace(FOUR, temperatures_degC=(20.0,), runs_per_temperature=3))
    rng = np.random.default_rng(0)
    for name in ("markov@2 h", "MU_rr"):
        c = SCATTER[name](at, np.random.default_rng(1))
        draws = np.array([drawn(c, rng).T.ravel() for _ in range(2000)])
        assert draws.T @ draws / 2000 == pytest.approx(c, abs=5.0 * c.max() * np.sqrt(2.0 / 2000))


@pytest.mark.parametrize("name", ["MU_rr", "hash", "frost", "flicker", "base", "markov@40 h", "rrw"])
def test_scatter_has_the_size_that_is_asked_for(name: str) -> None:
    """Beside the base it leaves four times the collects' noise; the same night without it has the same noise."""
    assert left_by(np.eye(6)[:, :2], 4.0 * np.eye(6)) == pytest.approx(4.0)
    case, plain = (make_case(6, hidden, model=MATRIX, noise=ORDINARY, times_white=4.0) for hidden in ((name,), ()))
    added = case.covariance - np.kron(np.eye(2), noise_covariance(case.night, ORDINARY))
    assert np.sqrt(left_by(base_columns(case.night, MATRIX), added)) == pytest.approx(4.0 * ORDINARY.collect)
    moved = (case.rates - plain.rates).T.ravel()
    q, _ = np.linalg.qr(base_columns(case.night, MATRIX))
    assert np.std(moved - q @ (q.T @ moved)) == pytest.approx(4.0 * ORDINARY.collect, rel=0.8)
    assert case.se == pytest.approx(plain.se)
    assert make_case(6, (name,), model=MATRIX, noise=ORDINARY, times_white=1e-9).rates == pytest.approx(plain.rates)


def test_an_effect_beside_scatter_is_measured_by_all_the_noise() -> None:
    """Generalised least squares by its normal equations gives d."""
    case = make_case(6, ("markov@2 h", "supply"), 10.0, model=MATRIX, noise=ORDINARY)
    base, s = base_columns(case.night, MATRIX), case.signals[0].T.ravel()
    weight = np.linalg.inv(case.covariance)
    left = s @ weight @ s - (base.T @ weight @ s) @ np.linalg.solve(base.T @ weight @ base, base.T @ weight @ s)
    assert np.sqrt(left) == pytest.approx(10.0)
    assert case.sizes == pytest.approx((10.0,))


@pytest.mark.parametrize("d", EVERY_SIZE)
def test_an_effect_has_its_size_whatever_it_is(d: float) -> None:
    """From 4 to 200, the rates move in proportion."""
    one, many = make_case(8, ("hyst",), 1.0), make_case(8, ("hyst",), d)
    assert many.sizes == pytest.approx((d,))
    assert many.signals[0] == pytest.approx(d * one.signals[0])


def test_errors_that_are_stated_too_small_are_those_of_the_noise_by_that_factor() -> None:
    """A quarter is stated; extra white noise is not stated at all."""
    honest, low, extra = (
        make_case(9, noise=Noise(kind="white", rho=0.0, unequal=0.3, **more), model=MATRIX, design=FOUR)
        for more in ({}, {"stated": 0.25}, {"extra": 3.6})
    )
    assert low.rates == pytest.approx(honest.rates)
    assert low.se == pytest.approx(0.25 * honest.se)
    assert extra.se == pytest.approx(honest.se)
    assert np.std(extra.rates - honest.rates) == pytest.approx(3.6, rel=0.2)
    assert np.ptp(honest.se) > 0.5


def test_steps_fall_at_any_collect_or_within_a_run() -> None:
    """Both kinds are one step each; the one reaches the first and last collects, the other never a run's first."""
    edges: dict[str, set[int]] = {"jump@any collect": set(), "jump@within a run": set()}
    for name, seen in edges.items():
        for seed in range(60):
            case = make_case(seed, (name,), design=EIGHT, model=MATRIX)
            at = np.flatnonzero(np.any(np.diff(case.signals[0], axis=0) != 0.0, axis=1))
            assert len(at) == 1
            seen.add(int(at[0]) + 1)
    place = np.arange(32) % 4
    assert {int(place[k]) for k in edges["jump@within a run"]} == {1, 2, 3}
    assert min(edges["jump@any collect"]) <= 3
    assert max(edges["jump@any collect"]) >= 29
    assert 0 in {int(place[k]) for k in edges["jump@any collect"]}


def test_a_warm_up_begins_anew_when_the_power_comes_back() -> None:
    """After each loss of the supply the bias is as large as at the first collect, or larger."""
    case = make_case(2, ("warmup",), design=replace(FOUR, power_cycles=2))
    size = np.abs(case.signals[0][:, 0])
    begins = np.flatnonzero(np.diff(case.night.since_power_s) < 0.0) + 1
    assert np.all(size[begins] > size[begins - 1])
    assert np.all(np.diff(size)[np.diff(case.night.since_power_s) > 0.0] < 0.0)


def test_layouts_have_their_holes_waits_and_lengths(tmp_path: Path) -> None:
    """Jitter, cold rows missing, columns missing, 8, 96 and 384 runs over a year."""
    plain, jittered = night(), night(replace(FOUR, jitter=0.4))
    assert np.ptp(np.diff(plain.start_s)[plain.order[1:] > 0]) == 0.0
    assert np.ptp(np.diff(jittered.start_s)[jittered.order[1:] > 0]) > 15.0
    assert np.ptp(np.diff(jittered.since_setpoint_s[jittered.order == 0][:3])) > 60.0
    holes = night(replace(FOUR, missing_cold=0.5))
    assert np.sum(holes.setpoint < 0.0) < 0.7 * np.sum(plain.setpoint < 0.0)
    assert np.sum(holes.setpoint >= 0.0) == np.sum(plain.setpoint >= 0.0)
    assert [len(np.unique(night(d).run)) for d in (EIGHT, QUARTER, YEAR)] == [8, 96, 384]
    assert 300.0 < np.ptp(night(YEAR).start_s) / 86400.0 < 400.0
    folder = write_case(make_case(1), tmp_path / "case", without=("supply_V", "case_degC"))
    columns = read_campaign(folder).sensors[2].conditions.columns
    assert "temperature_degC" in columns
    assert not {"supply_V", "case_degC"} & set(columns)


def spoiled(name: str) -> tuple[Case, Case]:
    """A case with a mistake, and the same without."""
    with_it, without = (make_case(12, hidden, 10.0, model=MATRIX, design=HEADINGS) for hidden in ((name,), ()))
    return with_it, without


@pytest.mark.parametrize(
    "name", ["pose@collect", "pose@run", "swap", "row", "run", "sign@run", "frame@channel", "clip"]
)
def test_a_mistake_spoils_the_rows_that_it_says_and_no_other(name: str) -> None:
    """The file's night is as it was; the rates differ in the spoiled rows alone, by the signal that is kept."""
    wrong, right = spoiled(name)
    changed = np.any(np.abs(wrong.rates - right.rates) > 1e-9, axis=1)
    assert changed.any()
    assert np.array_equal(changed, wrong.spoiled)
    assert wrong.filed.f == pytest.approx(right.filed.f)
    assert wrong.signals[-1] == pytest.approx(wrong.rates - right.rates)


def test_a_unit_in_another_pose_gives_that_pose_s_rates() -> None:
    """A run that stood a quarter turn further, or two or three: gravity and earth rate are seen from there."""
    wrong, right = spoiled("pose@run")
    f, w, changes = right.night.f, right.night.w, []
    for _ in range(3):  # quarter turns: A is where S was, S where −A was
        f, w = (np.stack([v[:, 2], v[:, 1], -v[:, 0]], 1) for v in (f, w))
        changes.append(right.truth.rates(f, w) - right.truth.rates(right.night.f, right.night.w))
    rows = wrong.spoiled
    assert len(np.unique(wrong.night.run[rows])) == 1
    assert any((wrong.rates - right.rates)[rows] == pytest.approx(change[rows]) for change in changes)


def test_the_file_says_what_a_mistake_of_the_earth_rate_says(tmp_path: Path) -> None:
    """Left out: zeros and the latitude. A wrong label alone: f, w and the rates are what they were."""
    left_out, right = spoiled("earth@left out")
    assert left_out.rates == pytest.approx(right.rates)
    campaign = read_campaign(write_case(left_out, tmp_path / "case"))
    assert campaign.site["latitude_deg"] == right.night.design.latitude_deg
    assert not campaign.sensors[2].conditions.w_deg_per_hr.any()
    assert left_out.signals[0] == pytest.approx(right.night.w[:, :2])
    for name in ("earth@heading", "frame@sign"):
        turned, _ = spoiled(name)
        assert turned.filed.w @ np.ones(3) != pytest.approx(right.night.w @ np.ones(3))
        assert np.linalg.norm(turned.filed.w, axis=1) == pytest.approx(np.linalg.norm(right.night.w, axis=1))
    label, _ = spoiled("label@alone")
    assert label.rates == pytest.approx(right.rates)
    assert np.sum(label.filed.position != right.night.position) == 1


def test_every_row_of_every_group_has_seeds_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """No sealed case stands in two rows."""
    monkeypatch.setattr("benchmarks.blind.jobs.shares", lambda *_: dict.fromkeys(CATALOGUE, 1.0))
    jobs = [job for group in WIDER.values() for job in group(5)]
    made = [job for job in jobs if job.seed]
    assert len({job.seed for job in made}) == len(made)
    assert {len([j for j in jobs if j.row == row]) for row in {j.row for j in made}} == {5}


def test_a_measured_log_keeps_its_noise_and_gets_the_effect(reference_data: Path, tmp_path: Path) -> None:
    """A g-sensitivity of size 12 in a log that others measured: what was added is linear in f."""
    assert logs()
    name = logs()[0].name
    sensor = 1
    plain, added = (
        read_campaign(write_real(1, name, ("g_sensitivity",), d, tmp_path / f"{d:g}")).sensors[sensor]
        for d in (0.0, 12.0)
    )
    difference = added.rates_deg_per_hr - plain.rates_deg_per_hr
    f = plain.conditions.f_g
    left = difference - f @ np.linalg.lstsq(f, difference, rcond=None)[0]
    assert np.abs(left).max() < 1e-3
    beside = difference - difference.mean(0)
    assert np.sqrt(np.sum((beside / plain.rates_deg_per_hr.std(0, ddof=1)) ** 2)) == pytest.approx(12.0, rel=1e-3)


def test_a_triad_that_is_turned_over_sees_the_earth_turn(tmp_path: Path) -> None:
    """A mistake is one of the file's f and w, or of a channel: the unit turned and measured as it does without."""
    files = {m: write_quiet_triad(3, m, tmp_path / (m or "nothing")) for m in MISTAKES}
    read = {m: read_campaign(folder).sensors[1] for m, (folder, _) in files.items()}
    f, w, rates = read[""].conditions.f_g, read[""].conditions.w_deg_per_hr, read[""].rates_deg_per_hr
    rest = rates - w
    assert np.std(rest - rest.mean(0)) == pytest.approx(QUIET, rel=0.3)
    assert np.linalg.norm(w, axis=1) == pytest.approx(15.041067)
    vertical = np.sum(f * w, axis=1)
    latitude = read_campaign(files["earth@left out"][0]).site["latitude_deg"]
    assert vertical == pytest.approx(15.041067 * np.sin(np.deg2rad(latitude)), rel=1e-3)
    assert not read["earth@left out"].conditions.w_deg_per_hr.any()
    turned, sign = (read[m].conditions.w_deg_per_hr for m in ("earth@heading", "frame@sign"))
    assert np.sum(f * turned, axis=1) == pytest.approx(vertical)
    assert np.abs(turned - w).max() > 3.0
    assert sign - w == pytest.approx(-2.0 * vertical[:, None] * f)
    other = np.arange(POSES) + 1 == files["pose@collect"][1]
    assert read["pose@collect"].conditions.f_g == pytest.approx(np.where(other, -1.0, 1.0)[:, None] * f)
    assert read["pose@collect"].conditions.w_deg_per_hr == pytest.approx(np.where(other, -1.0, 1.0)[:, None] * w)
    assert other.sum() == 1
    for mistake, rows in read.items():
        factor = np.median(rows.rates_deg_per_hr / rates, axis=0)
        assert sorted(factor) == ([-1.0, 1.0, 1.0] if mistake == "scale@channel" else [1.0, 1.0, 1.0])
        assert rows.rates_deg_per_hr == pytest.approx(factor * rates)


def test_the_earth_rate_is_left_out_of_a_log_as_a_better_gyro_would_show_it(
    reference_data: Path, tmp_path: Path
) -> None:
    """The rates gain the vertical part along f, their scatter is made smaller, and the latitude is given."""
    source, folder = logs()[-1], tmp_path / "log"
    campaign = read_campaign(write_real(1, source.name, ("earth@left out",), 12.0, folder))
    rows, before = campaign.sensors[1], read_campaign(source).sensors[1].rates_deg_per_hr
    added = rows.conditions.f_g * 15.041067 * np.sin(np.deg2rad(campaign.site["latitude_deg"]))
    rest = rows.rates_deg_per_hr - added
    assert rest.mean(0) == pytest.approx(before.mean(0))
    smaller = np.std(rest, axis=0) / np.std(before, axis=0)
    assert np.ptp(smaller) < 1e-3
    beside = (added - added.mean(0)) / rest.std(0, ddof=1)
    assert np.sqrt(np.sum(beside**2)) == pytest.approx(12.0, rel=1e-2)
