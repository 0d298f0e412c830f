"""A log that others recorded becomes a campaign: its truth comes back, and no trap of public logs passes in silence."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.log.accelerometer import NAMES, Accelerometers
from hil.analysis.log.poses import LogCampaign, campaign_of_log, write_log_campaign
from hil.analysis.log.reading import read_log
from hil.analysis.log.static import StaticTest
from hil.campaign.reader import read_campaign
from hil.errors import InputError
from hil.files.columns import Columns, read_columns
from hil.files.units import ACCELERATION, RATE, TIME
from hil.solve import solve_campaign
from hil.solve.least_squares import solve
from procedures.averaging import average_series
from procedures.verdict import Verdict
from tests.hil.analysis.log.simulated import (
    ACCELEROMETER,
    BIAS_DEG_PER_HR,
    F_NOISE,
    HZ,
    RATE_NOISE,
    SENSITIVITY,
    Simulated,
    poses,
    shown_g,
    simulate,
)

TRUTH = np.concatenate([BIAS_DEG_PER_HR, SENSITIVITY.ravel()])


def made_of(path: Path, *, rate_hz: float | None = None, gyro: str | None = None, **scales: str) -> LogCampaign:
    """Read a log with options (gyro, rate_hz, and of each kind its scale) and make its campaign."""
    kinds = {"gyro_scale": RATE, "accelerometer_scale": ACCELERATION, "time_scale": TIME}
    units = {kinds[name]: text for name, text in scales.items()}
    columns = {RATE: gyro} if gyro else {}
    return campaign_of_log(read_log(read_columns(path), columns, units, rate_hz=rate_hz), StaticTest())


def said(made: LogCampaign) -> str:
    """Return all that is said of a log."""
    return "\n".join(made.document["notes"])


@pytest.fixture(scope="module")
def sound() -> Simulated:
    """Return a log with nothing wrong; tests spoil a copy."""
    return simulate(14)


def spoiled(one: Simulated, change: Callable[[dict[str, np.ndarray]], None], path: Path) -> Path:
    """Write the log with its columns changed in place."""
    columns = {name: values.copy() for name, values in one.columns().items()}
    change(columns)
    return one.write(path, columns)


@pytest.mark.slow
def test_the_truth_comes_back_from_the_folder_alone(sound: Simulated, tmp_path: Path) -> None:
    """Bias, sensitivities that are not symmetric, and accelerometers, within four of their standard deviations."""
    made = made_of(sound.write(tmp_path / "log.csv"))
    write_log_campaign(made, tmp_path / "campaign")
    campaign = read_campaign(tmp_path / "campaign")
    assert not campaign.contradicted
    (solution,) = solve_campaign(campaign, "triad-12")
    found = list(solution.parameters.values())
    off = np.abs([each.value for each in found] - TRUTH) / [each.se for each in found]
    assert off.max() < 4.0, dict(zip(solution.parameters, off.round(1), strict=True))
    f_g = campaign.sensors[1].conditions.f_g
    assert np.abs(f_g - sound.f_g).max() < 0.001
    accelerometer = json.loads((tmp_path / "campaign" / "accelerometer.json").read_text())
    assert accelerometer["schema"] == "hil.accelerometer/1"
    for name, truth in zip(NAMES, ACCELEROMETER, strict=True):
        of = accelerometer["parameters"][name]
        assert of["low"] < of["value"] < of["high"]
        assert of["told"]
        assert abs(of["value"] - truth) < 4.0 * of["sd"], name
    series = campaign.series(1)
    assert series is not None
    assert len(series.t_s) == campaign.sensors[1].conditions.columns["n_samples"][0]


def test_stated_intervals_hold_over_many_logs() -> None:
    """95 % intervals of accelerometers, biases and sensitivities hold the truth in 93 to 97 %: 18 poses, 500 seeds."""
    seeds, n, samples = 500, 18, 250
    f_g = np.array([poses(n, seed) for seed in range(seeds)])
    rng = np.random.default_rng(7)
    se_g, se = F_NOISE / np.sqrt(samples), RATE_NOISE / np.sqrt(samples)
    mean_g = shown_g(f_g) + se_g * rng.normal(size=f_g.shape)
    fitted = Accelerometers(mean_g, np.full(mean_g.shape, se_g))
    inside = np.abs(fitted.values - ACCELEROMETER) <= fitted.half_width
    assert 0.93 <= inside.mean() <= 0.97
    found_g = fitted.f_g(mean_g)
    found_g /= np.linalg.norm(found_g, axis=-1, keepdims=True)
    rates = BIAS_DEG_PER_HR + f_g @ SENSITIVITY.T + se * rng.normal(size=f_g.shape)
    columns = np.zeros((seeds, n, 3, 12))
    columns[..., :3] = np.eye(3)
    for c in range(3):
        columns[..., c, 3 + 3 * c : 6 + 3 * c] = found_g
    solution = solve(
        columns.reshape(seeds, 3 * n, 12), rates.reshape(seeds, 3 * n), sigma=se, names=tuple("abcdefghijkl")
    )
    inside = np.abs(solution.values - TRUTH) <= 1.96 * solution.se
    assert 0.93 <= inside.mean() <= 0.97


@pytest.mark.slow
def test_standard_errors_allow_for_correlation_between_samples(sound: Simulated, tmp_path: Path) -> None:
    """Noise that a filter has correlated (AR(1), 0.9) makes them several times those of independent samples."""
    rng = np.random.default_rng(3)
    white = rng.normal(size=sound.rates.shape)
    for i in range(1, len(white)):
        white[i] = 0.9 * white[i - 1] + np.sqrt(1.0 - 0.81) * white[i]
    still = np.all(np.abs(sound.rates) < 5000.0, axis=1)
    coloured = np.where(still[:, None], 400.0 + RATE_NOISE * white, sound.rates)
    made = made_of(replace(sound, rates=coloured).write(tmp_path / "log.csv"))
    rows = made.campaign.sensors[1]
    independent = RATE_NOISE / np.sqrt(rows.conditions.columns["n_samples"])[:, None]
    assert np.median(rows.rates_se_deg_per_hr / independent) > 2.5


def test_a_label_that_says_the_opposite_of_the_data_is_told_and_the_data_win(sound: Simulated, tmp_path: Path) -> None:
    """+Z over data that say -Z: the position is called what it is, f is the data's, and a note stays in the folder."""
    label = sound.label.copy()
    label[label == "-Z"] = "+Z"
    made = made_of(replace(sound, label=label).write(tmp_path / "log.csv", labels=True))
    conditions = made.campaign.sensors[1].conditions
    assert conditions.position.tolist()[:3] == ["+Z", "-Z", "+X"]
    assert conditions.f_g[1, 2] < -0.99
    assert "collect 2 (rows 477-726): its label says +Z, its accelerometers -Z" in said(made)
    write_log_campaign(made, tmp_path / "campaign")
    assert "its label says +Z" in read_campaign(tmp_path / "campaign").notes


def test_a_pose_between_axes_is_called_by_none(sound: Simulated, tmp_path: Path) -> None:
    """Whatever axis its label says: on an edge or a corner it has a number."""
    between = next(k for k in range(6, 14) if np.abs(sound.f_g[k]).max() < 0.8)
    axis = int(np.argmax(np.abs(sound.f_g[between])))
    nearest = f"{'+' if sound.f_g[between][axis] > 0 else '-'}{'XYZ'[axis]}"
    label = np.where(sound.label == f"pose {between}", nearest, sound.label)
    made = made_of(replace(sound, label=label).write(tmp_path / "log.csv", labels=True))
    assert f"its label says {nearest}, its accelerometers that it stands between axes" in said(made)
    positions = [each["position"] for each in made.document["stretches"]]
    assert positions[between] == f"pose-{between + 1:02d}"
    assert positions[:6] == ["+Z", "-Z", "+X", "-X", "+Y", "-Y"]


def test_accelerometers_that_show_gravity_itself_are_refused_by_their_labels(sound: Simulated, tmp_path: Path) -> None:
    """All labels say the opposite: the sign of f would turn every sensitivity; with a minus in the scale it is read."""
    path = replace(sound, acc=-sound.acc).write(tmp_path / "log.csv", labels=True)
    with pytest.raises(InputError, match=r"all 6 labels say the opposite.*--accelerometer-scale with a minus"):
        made_of(path)
    turned = made_of(path, accelerometer_scale="-1 g").campaign.sensors[1].conditions
    assert turned.f_g[0, 2] > 0.99


def test_rows_of_zeros_are_left_out_and_told(sound: Simulated, tmp_path: Path) -> None:
    """A first row of zeros, and a buffer that ends in hundreds of them, are no samples."""
    n = len(sound.t_s)

    def zeros(columns: dict[str, np.ndarray]) -> None:
        for name in columns.keys() - {"t_s"}:
            columns[name][0] = 0.0
            columns[name][n - 120 :] = 0.0

    made = made_of(spoiled(sound, zeros, tmp_path / "log.csv"))
    assert f"rows 2, {n - 118}-{n + 1} left out: accelerations of exactly zero" in said(made)
    assert made.document["stretches"][0]["rows"][0] == 3
    assert made.document["stretches"][-1]["rows"][1] <= n - 119
    assert np.abs(made.campaign.sensors[1].conditions.f_g - sound.f_g).max() < 0.001


def test_counts_without_a_scale_are_refused_with_what_to_give(sound: Simulated, tmp_path: Path) -> None:
    """And with the scales they are the rates and accelerations that they stand for."""
    counts = {
        "timestamp": np.round(sound.t_s * 1e3),
        **{f"gyro_{axis}": np.round(sound.rates[:, k] / 36.0) for k, axis in enumerate("xyz")},
        **{f"accel_{axis}": np.round(sound.acc[:, k] / 1e-4) for k, axis in enumerate("xyz")},
    }
    path = sound.write(tmp_path / "log.csv", counts)
    with pytest.raises(InputError, match=r"columns gyro_x, gyro_y, gyro_z: .*give --gyro-scale, such as deg/s"):
        made_of(path)
    with pytest.raises(InputError, match=r"accel_z: .*give --accelerometer-scale"):
        made_of(path, gyro_scale="0.01 deg/s")
    with pytest.raises(InputError, match=r"columns timestamp: .*give --time-scale"):
        made_of(path, gyro_scale="0.01 deg/s", accelerometer_scale="0.1 mg")
    made = made_of(path, gyro_scale="0.01 deg/s", accelerometer_scale="0.1 mg", time_scale="ms")
    assert "rates: columns gyro_x, gyro_y, gyro_z, in 0.01 deg/s" in said(made)
    rates = made.campaign.sensors[1].rates_deg_per_hr
    assert np.abs(rates - (BIAS_DEG_PER_HR + sound.f_g @ SENSITIVITY.T)).max() < 80.0
    with pytest.raises(InputError, match=r"show 0\.0\d+ g, where 1 g belongs.*--accelerometer-scale"):
        made_of(path, gyro_scale="0.01 deg/s", accelerometer_scale="0.01 mg", time_scale="ms")


@pytest.mark.parametrize(
    ("names", "factors", "unit"),
    [
        ("ang_rate {} [deg/s]|IMU::Accel::{} [m/s^2]|t [s]", (3600.0, 1 / 9.80665), "in deg/s"),
        ("w{}_rad_per_s|a{}_m_per_s2|time_s", (206264.80624709636, 1 / 9.80665), "in rad/s"),
        ("gyro{1}_{0}_dps|{}acc_mg|timestamp_s", (3600.0, 1e-3), "in deg/s"),
    ],
)
def test_columns_and_units_are_recognised_by_their_names(
    sound: Simulated, tmp_path: Path, names: str, factors: tuple[float, float], unit: str
) -> None:
    """Whatever order they stand in; and what was taken for what is said."""
    gyro, accelerometer, time = names.split("|")
    columns = {accelerometer.format("xyz"[k]): sound.acc[:, k] / factors[1] for k in (2, 0, 1)}
    columns |= {gyro.format("xyz"[k], 9 - k): sound.rates[:, k] / factors[0] for k in (1, 2, 0)}
    made = made_of(sound.write(tmp_path / "log.csv", {**columns, time: sound.t_s}))
    assert f"{unit}\n" in said(made)
    rates = made.campaign.sensors[1].rates_deg_per_hr
    assert np.abs(rates - (BIAS_DEG_PER_HR + sound.f_g @ SENSITIVITY.T)).max() < 80.0


def test_two_columns_that_could_be_meant_are_a_question(sound: Simulated, tmp_path: Path) -> None:
    """Never the first of them; --gyro names which."""
    columns = {**sound.columns(), "gyro_temperature_x": sound.t_s}
    path = sound.write(tmp_path / "log.csv", columns)
    with pytest.raises(InputError, match=r"which columns hold the rates is not clear.*--gyro X,Y,Z"):
        made_of(path)
    unnamed = sound.write(tmp_path / "unnamed.csv", {f"c{k}": each for k, each in enumerate(columns.values())})
    with pytest.raises(InputError, match=r"the rates is not clear \(by their names: none\).*there are c0, c1"):
        made_of(unnamed)
    assert made_of(path, gyro="GX_deg_per_hr,GY_deg_per_hr,GZ_deg_per_hr").document["stretches"]
    path.write_text(re.sub(r"\A(.*\n[^,]*,)[^,]*", r"\1high", path.read_text()))
    with pytest.raises(InputError, match=r"log.csv, row 2, column GX_deg_per_hr: 'high' is no number"):
        made_of(path, gyro="GX_deg_per_hr,GY_deg_per_hr,GZ_deg_per_hr")


@pytest.mark.slow
@pytest.mark.parametrize("turn", ["f turns by", "turns by"])
def test_what_is_moved_within_a_stretch_is_not_at_rest(turn: str) -> None:
    """So slowly that no variance shows it: tilted by 2 degrees, or turned by 4 about the vertical, unseen by f."""
    one = simulate(8, rest_s=20.0)
    rows = slice(one.starts[6], one.starts[6] + 2000)
    way = np.clip((np.arange(2000) - 200) / 1600.0, 0.0, 1.0)
    if turn == "f turns by":
        one.acc[rows] += np.outer(np.deg2rad(2.0) * way, np.cross(one.f_g[6], [0.0, 0.0, 1.0]))
    else:
        fastest_deg_per_hr = 4.0 * np.pi / (2.0 * 16.0) * 3600.0
        one.rates[rows] += np.outer(fastest_deg_per_hr * np.sin(np.pi * way), one.f_g[6])
    made = campaign_of_log(read_log(Columns(Path("log"), one.columns())), StaticTest())
    first = one.starts[6] + 2
    assert not any(first <= each["rows"][0] < first + 2000 for each in made.document["stretches"])
    assert len(made.document["stretches"]) == 7
    assert f"are quiet and yet not used: {'G' * (turn == 'turns by')}" in said(made)
    assert turn in said(made)


def test_coarse_counts_that_hardly_change_are_no_motion_where_they_do(sound: Simulated, tmp_path: Path) -> None:
    """A step that is five times the noise: most windows show one value, and a flip between two is no motion."""
    made = made_of(replace(sound, rates=1000.0 * np.round(sound.rates / 1000.0)).write(tmp_path / "log.csv"))
    assert len(made.document["stretches"]) == 14


def test_empty_cells_and_times_that_repeat_are_left_out_and_told(sound: Simulated, tmp_path: Path) -> None:
    """One by one; the samples beside them are used."""

    def change(columns: dict[str, np.ndarray]) -> None:
        columns["GY_deg_per_hr"][40:43] = np.nan
        columns["t_s"][100] = columns["t_s"][99]

    made = made_of(spoiled(sound, change, tmp_path / "log.csv"))
    assert "rows 42-44 left out: a cell is empty" in said(made)
    assert "row 102 left out: the time is not later" in said(made)
    first, last = made.document["stretches"][0]["rows"]
    assert first == 2
    assert 200 < last < 300
    write_log_campaign(made, tmp_path / "campaign")
    assert read_campaign(tmp_path / "campaign").sensors[1].conditions.columns["n_samples"][0] == last - first + 1 - 4


@pytest.mark.slow
def test_no_stretch_goes_over_a_jump_in_time(sound: Simulated, tmp_path: Path) -> None:
    """Who knows what was done with the unit meanwhile; and a clock that often stands still is none."""

    def later(columns: dict[str, np.ndarray]) -> None:
        columns["t_s"][150:] += 30.0

    made = made_of(spoiled(sound, later, tmp_path / "jump.csv"))
    assert "30 s, before row 152" in said(made)
    assert made.document["stretches"][0]["rows"] == [2, 151]
    assert made.document["stretches"][0]["ends"] == "a gap in time"
    assert made.document["stretches"][1]["begins"] == "a gap in time"

    def back(columns: dict[str, np.ndarray]) -> None:
        columns["t_s"][3000:] -= 20.0

    path = spoiled(sound, back, tmp_path / "back.csv")
    with pytest.raises(InputError, match=r"the first is row 3002.*--rate '100 Hz' counts samples"):
        made_of(path)
    assert len(made_of(path, rate_hz=100.0).document["stretches"]) == 14


@pytest.mark.slow
def test_a_stream_that_stands_still_is_no_rest(sound: Simulated, tmp_path: Path) -> None:
    """A buffer that repeats its last sample for a minute is as quiet as nothing else, and no measurement."""

    def frozen(columns: dict[str, np.ndarray]) -> None:
        for name in columns.keys() - {"t_s"}:
            columns[name][1100:1350] = columns[name][1099]

    made = made_of(spoiled(sound, frozen, tmp_path / "log.csv"))
    assert len(made.document["stretches"]) == 14
    assert made.document["stretches"][2]["ends"].endswith("the stream stands still")
    tail = np.full(3000, len(sound.t_s) - 1)
    rows = np.concatenate([np.arange(len(sound.t_s)), tail])
    columns = {name: values[rows] for name, values in sound.columns().items()} | {"t_s": np.arange(len(rows)) / HZ}
    assert len(made_of(sound.write(tmp_path / "tail.csv", columns)).document["stretches"]) == 14


def test_why_a_stretch_ends_and_the_level_of_the_test_are_said(sound: Simulated, tmp_path: Path) -> None:
    """A threshold that nobody is told is nobody's to judge."""
    made = made_of(sound.write(tmp_path / "log.csv"))
    assert made.document["stretches"][0]["begins"] == "the log begins"
    ends = made.document["stretches"][0]["ends"]
    assert ends.startswith("row 302: ")
    assert ends.endswith("times as much as in the quietest tenth")
    assert made.document["stretches"][-1]["ends"] == "the log ends"
    assert "more than 4 times as much (variance) as in the quietest tenth, which white noise does in" in said(made)
    log = read_log(read_columns(tmp_path / "log.csv"))
    with pytest.raises(InputError, match="nowhere at rest for 60 s"):
        campaign_of_log(log, StaticTest(shortest_s=60.0))


def test_six_poses_say_that_they_do_not_tell_misalignment() -> None:
    """Bias and scale factor yes; the leans stay nominal, with what it takes."""
    f_g = poses(6)
    mean_g = f_g * [1.01, 0.97, 1.02] + [0.05, -0.03, 0.02]
    fitted = Accelerometers(mean_g, np.full((6, 3), 1e-4))
    assert [name for name, of in fitted.rows().items() if not of["told"]] == ["a_YX", "a_ZX", "a_ZY"]
    assert fitted.values[:6] == pytest.approx([0.05, -0.03, 0.02, 1.01, 0.97, 1.02], abs=1e-4)


def test_few_poses_are_told_in_words(tmp_path: Path) -> None:
    """How many it takes, and of what kind."""
    made = made_of(simulate(6).write(tmp_path / "log.csv"))
    assert "6 poses: 6 of 9 parameters told; a_YX, a_ZX and a_ZY stay what is usual: it takes 9 poses" in said(made)
    assert "6 poses: no residual" in said(made)


def test_scatter_of_f_beyond_noise_enlarges_the_uncertainties() -> None:
    """What no noise of means explains (a table that shakes, a scale factor that bends) is not hidden by it."""
    f_g = poses(30)
    rng = np.random.default_rng(5)
    mean_g = shown_g(f_g) + 1e-3 * rng.normal(size=f_g.shape)
    fitted = Accelerometers(mean_g, np.full(f_g.shape, 1e-4))
    assert 6.0 < fitted.inflation < 15.0
    assert np.all(np.abs(fitted.values - ACCELEROMETER) < 4.0 * fitted.sd)


@pytest.mark.slow
def test_the_earth_rate_is_what_a_latitude_tells(sound: Simulated, tmp_path: Path) -> None:
    """Its vertical part along f; without a latitude nothing, and either is said."""
    log = read_log(read_columns(sound.write(tmp_path / "log.csv")))
    there = campaign_of_log(log, StaticTest(), latitude_deg=48.0)
    w = there.campaign.sensors[1].conditions.w_deg_per_hr
    assert w == pytest.approx(15.041067 * np.sin(np.deg2rad(48.0)) * sound.f_g, abs=0.02)
    assert "which way north lay is not known" in said(there)
    (warned,) = read_campaign(write_log_campaign(there, tmp_path / "there")).warnings
    assert "the horizontal part, up to 10.1 deg/hr in any channel, is in the rates, and in no standard error" in warned
    nowhere = campaign_of_log(log, StaticTest())
    assert not nowhere.campaign.sensors[1].conditions.w_deg_per_hr.any()
    assert "neither latitude (--latitude) nor heading is known" in said(nowhere)


@pytest.mark.slow
def test_a_mean_is_that_of_the_stretch(sound: Simulated, tmp_path: Path) -> None:
    """The rates of a collect are those of its rows in the file, and no others."""
    made = made_of(sound.write(tmp_path / "log.csv"))
    first, last = made.document["stretches"][3]["rows"]
    rows = slice(first - 2, last - 1)
    average = average_series(sound.t_s[rows], sound.rates[rows])
    assert made.campaign.sensors[1].rates_deg_per_hr[3] == pytest.approx(average.mean)
    assert made.campaign.sensors[1].rates_se_deg_per_hr[3] == pytest.approx(average.se)
    assert made.campaign.sensors[1].conditions.duration_s[3] == pytest.approx((last - first + 1) / HZ)


def test_no_pose_is_a_pass_of_a_log_whose_turns_are_none(sound: Simulated, tmp_path: Path) -> None:
    """What was noted when the log was read stands in the campaign's verdict."""
    turned = replace(sound, rates=sound.rates * [1.0, -1.0, 1.0])
    write_log_campaign(made_of(turned.write(tmp_path / "log.csv")), tmp_path / "campaign")
    (solution,) = solve_campaign(read_campaign(tmp_path / "campaign"))
    assert solution.verdict is Verdict.FAIL
    assert "a sign or the order of the gyros' columns is wrong" in solution.reason
