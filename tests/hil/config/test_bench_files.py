"""A bench file is read strictly: everything that is wrong with one is a sentence that names file and key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.config import check_sweep_against_bench, load_bench, load_sweep, parse_bench, parse_sweep
from hil.config.bench import Bench
from hil.errors import InputError

_BENCH = load_bench("simulated").text
_SWEEP = load_sweep("rd-gc-86-1").text


def _changed(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1, f"{old!r} must stand once in the file that the test changes"
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("clock: virtual", "clock: wall", "clock: 'wall' is not allowed; allowed: 'system' or 'virtual'"),
        ("safe_state:", "safestate:", "chamber: unknown key 'safestate'; did you mean 'safe_state'?"),
        ("chamber:\n  driver", "chambr:\n  driver", "unknown key 'chambr'; did you mean 'chamber'?"),
        ("{interval: 30 s", "{intervall: 30 s", "polling: unknown key 'intervall'; did you mean 'interval'?"),
        ("low: -45 degC", "low: -45 kg", "chamber.limits.low: '-45 kg' is not a temperature"),
        ("low: -45 degC", "low: -45", "chamber.limits.low: -45 has no unit"),
        ("low: -45 degC", "low: 145 degC", "chamber.limits: low (145 °C) must be below high (75 °C)"),
        (
            "high: 75 degC",
            "high: 1000 degC",
            "chamber.limits.high: no chamber that these drivers know reaches 1000 °C",
        ),
        ("low: -45 degC", "low: -200 degC", "chamber.limits.low: no chamber that these drivers know reaches -200 °C"),
        ("{interval: 30 s,", "{interval: 8 d,", "polling: interval_s must be a finite number of at most 7 days"),
        ("clock: virtual", "clock: virtual\ninterlocks: {chamber_loss: 1e300 s}", "interlocks: chamber_loss_s must be"),
        ("case_lag: 12 min", "case_lag: 12 degC", "simulation.thermal.case_lag: '12 degC' is not a time"),
        ("interval: 30 s,", "interval: 30 kg,", "polling.interval: '30 kg' is not a time"),
        ("action: standby", "action: sleep", "chamber.safe_state.action: 'sleep' is not allowed"),
        (
            "{action: standby}",
            "{action: hold, temperature: 93 degC}",
            "chamber.safe_state.temperature: 93 °C lies outside the chamber's limits -45 … 75 °C",
        ),
        ("{action: standby}", "{temperature: 20 degC}", "chamber.safe_state.action: this key is missing"),
        ("low: -45 degC, ", "", "chamber.limits.low: this key is missing"),
        ("seed: 861", "seed: 861\n  imu_faults: [{begins: 3 s}]", "simulation.imu_faults.0.fault: this key is missing"),
        ("{action: standby}", "{action: hold}", "chamber.safe_state: a safe state has a temperature when"),
        ("unit: {model: MFS-IMU, serial: SIM-0001}", "unit: {model: MFS-IMU}", "unit.serial: this key is missing"),
        ("seed: 861", "seed: -1", "simulation.seed: must be at least 0, not -1"),
        ("latitude: 34.6 deg", "latitude: 134.6 deg", "site: latitude 134.6 deg"),
        ("G2: 1 mg", "G2: 1 kg", "site.G2: '1 kg' is not an acceleration"),
        ("G2: 1 mg", "G2: 1 g", "site: G2 and G3 are components of a nearly level bench"),
        ("G2: 1 mg", "axis_2_elevation: 1 deg", "site: give G2 and G3, or axis_2_elevation and axis_3_elevation"),
        ("description: mfs ", "description: msf ", "imu.description: msf: there is no IMU description of this name"),
        ("model: rd-gc-86-1-truth", "model: nosuch", "simulation.model: nosuch: there is no model of this name"),
        ("sim://imu", "sim://gyro", "imu.port: there is no simulated port 'sim://gyro'"),
        ("sim://chamber", "sim://imu", "chamber.port: there is no simulated port 'sim://imu'"),
        ("sim://imu", "ftp://imu", "imu.port: 'ftp://imu': ports begin with sim://"),
        ("sim://imu", "socket://imu", "imu.port: 'socket://imu' lacks its host or port number"),
        ("sim://imu", "", "imu.port: None is not a port"),
        ("sim://imu", "/dev/ttyS0", "clock: a virtual clock cannot drive the real port /dev/ttyS0 (imu.port)"),
        ("name: simulated", "name: my bench", "name: 'my bench' is not a name"),
        ("{A: +1, B: +2, S: -3}  ", "{A: +1, B: +2, S: 4}  ", "sensors.2.orientations.2.S: 4 is not a signed"),
    ],
)
def test_a_wrong_entry_is_one_sentence_that_names_file_and_key(old: str, new: str, message: str) -> None:
    """One sentence, no traceback, no second guess."""
    if old.startswith("{A"):
        old, new = '"2": {A: +1, B: +2, S: -3}\n      "3": {A: +3', '"2": {A: +1, B: +2, S: 4}\n      "3": {A: +3'
    with pytest.raises(InputError) as refusal:
        parse_bench(_changed(_BENCH, old, new), "my-bench.yaml")
    assert str(refusal.value).startswith(f"my-bench.yaml: {message}")
    assert "\n" not in str(refusal.value)


def test_the_first_of_several_errors_is_told_and_where_the_others_are() -> None:
    """A technician mends one thing at a time, and all before the next trial."""
    text = _changed(_changed(_BENCH, "clock: virtual", "clock: wall"), "seed: 861", "seed: x")
    with pytest.raises(InputError, match=r"clock: .* \(also simulation\.seed\)$"):
        parse_bench(text, "my-bench.yaml")


def test_simulated_ports_need_a_simulation_section() -> None:
    """Otherwise nothing would say what they do."""
    text = _BENCH[: _BENCH.index("simulation:")]
    with pytest.raises(InputError, match=r"imu\.port: sim://imu needs a simulation section"):
        parse_bench(text, "my-bench.yaml")


def test_a_bench_is_simulated_when_it_has_a_simulation_section() -> None:
    """Also behind a pseudo-terminal: the data is simulated all the same."""
    text = _BENCH.replace("sim://imu", "/tmp/imu").replace("sim://chamber", "/tmp/chamber")  # noqa: S108
    text = _changed(text, "clock: virtual", "clock: system")
    assert parse_bench(text, "b").simulated
    assert not parse_bench(text[: text.index("simulation:")], "b").simulated


def _orientation(entry: str) -> Bench:
    old = '"4": {A: -3, B: +2, S: -1}  # not in the report'
    alone = _changed(_BENCH, '      "4": {A: -1, B: +2, S: +3}\n', "")  # sensor 1, which would have to turn with it
    return parse_bench(_changed(alone, old, f'"4": {entry}  # not in the report'), "b.yaml")


@pytest.mark.parametrize(
    "entry",
    [
        "{A: -3, B: 2, S: '-1'}",
        "{from: 3, rotate: 180 deg, about: 2}",
        "{from: '1', rotate: -90 deg, about: '2'}",
        "{matrix: [[0, 0, -1], [0, 1, 0], [-1, 0, 0]]}",
        "{matrix: [[0, 0.0005, -1], [0, 1, 0], [-1, 0, 0]]}",
    ],
)
def test_an_orientation_may_be_written_in_three_ways(entry: str) -> None:
    """Position 1 is position 3 turned by -90 deg about axis 2, so that a further -90 deg is position 4."""
    axes = _orientation(entry).sensors[2].built["4"].axes
    np.testing.assert_allclose(axes, [[0, 0, -1], [0, 1, 0], [-1, 0, 0]], atol=1e-3)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(("position", "theta_deg"), [("1", -90.0), ("2", 90.0), ("3", 0.0)])
def test_a_rotation_turns_as_the_equation_does(position: str, theta_deg: float) -> None:
    """The equation has fA = G1 sin θ + G3 cos θ: the report's collects are θ = -90, 90 and 0 deg."""
    bench = _orientation(f"{{from: '3', rotate: {theta_deg} deg, about: 2}}")
    np.testing.assert_allclose(bench.sensors[2].built["4"].axes, bench.sensors[2].built[position].axes, atol=1e-12)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("{A: -3, B: +2, S: +3}", "orientations.4: -3, +2, +3 must be three different bench axes"),
        ("{A: -3, B: +2}", "orientations.4: {'A': -3, 'B': 2} is not an orientation"),
        ("up", "orientations.4: 'up' is not an orientation"),
        ("{A: -3, B: +2, S: 1.5}", "orientations.4.S: 1.5 is not a signed bench axis"),
        ("{from: '9', rotate: 90 deg, about: 2}", "orientations.4.from: '9' is not a position"),
        ("{from: '3', rotate: 90 kg, about: 2}", "orientations.4.rotate: '90 kg' is not an angle"),
        ("{from: '3', rotate: 90 deg, about: 5}", "orientations.4.about: 5 is not a bench axis"),
        ("{from: '3', rotate: 90 deg}", "orientations.4: a rotation needs from, rotate and about"),
        (
            "{matrix: [[1, 0, 0], [0, 1, 0], [1, 0, 0]]}",
            "orientations.4.matrix: three rows of three numbers, orthonormal",
        ),
        ("{matrix: [[1, 0], [0, 1]]}", "orientations.4.matrix: three rows of three numbers"),
        ("{matrix: sideways}", "orientations.4.matrix: three rows of three numbers"),
    ],
)
def test_an_impossible_orientation_names_its_position(entry: str, message: str) -> None:
    """The sensor and the position are in the sentence."""
    with pytest.raises(InputError) as refusal:
        _orientation(entry)
    assert f"sensors.2.{message}" in str(refusal.value)


def test_positions_have_the_units_own_numbers() -> None:
    """A position called 3 is its number 3, unless the file gives codes."""
    assert load_bench("simulated").position_codes == {"1": 1, "2": 2, "3": 3, "4": 4}
    text = _changed(_BENCH, "  positioner: indexing", "  codes: {1: 11, 3: 13}\n  positioner: indexing")
    assert parse_bench(text, "b").position_codes == {"1": 11, "2": 2, "3": 13, "4": 4}


def test_gravity_and_earth_rate_come_from_the_site() -> None:
    """G as the file gives it, of length 1; W of the length of the earth's rate."""
    site = load_bench("simulated").site
    np.testing.assert_allclose(site.gravity_g()[1:], [0.001, -0.016], atol=1e-12)
    assert np.linalg.norm(site.gravity_g()) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(site.earth_rate_deg_per_hr()) == pytest.approx(15.041067, abs=1e-6)


def test_a_bench_keeps_the_text_it_was_read_from(tmp_path: Path) -> None:
    """A record keeps it, and reads the same bench from it."""
    path = tmp_path / "mine.yaml"
    path.write_text(_BENCH)
    bench = load_bench(path)
    assert (bench.text, bench.source) == (_BENCH, str(path))
    assert parse_bench(bench.text, bench.source) == bench


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("45 min  ", "45 kg  ", "restabilisation.at_least: '45 kg' is not a time; write it like 45 min"),
        ("45 min  ", "~  ", "restabilisation.at_least: None is not a time"),
        ("  band: 0.5 degC", "  band: 0 degC", "restabilisation: band_degC must be positive"),
        ("ceiling: 4 h", "ceiling: 4 min", "restabilisation: ceiling_s (240) is shorter than"),
        ("restabilisation:", "restabilization:", "unknown key 'restabilization'; did you mean 'restabilisation'?"),
        ("settle: 60 s", "setle: 60 s", "collect: unknown key 'setle'; did you mean 'settle'?"),
        ("[-21.5 degF,", "[-21.5,", "temperatures.0: -21.5 has no unit"),
        ("[-21.5 degF,", "[-600 degF,", "temperatures.0: '-600 degF' cannot be"),
        ("temperatures: [", "temperatures: 5 # [", "temperatures: must be a list"),
        ("positions: [1, 2, 3]", "positions: []", "positions: "),
        ("ramp: 3 degC/min", "ramp: 3 degC", "ramp: '3 degC' is not a rate of temperature change"),
        ("ramp: 3 degC/min", "ramp: 0 degC/min", "ramp: must be more than 0, not"),
        ("self_calibrations_per_temperature: 3", "self_calibrations_per_temperature: 0", "self_calibrations_per_temp"),
        (
            "self_calibrations_per_temperature: 3",
            "self_calibrations_per_temperature: yes",
            "self_calibrations_per_temperature: must be a whole number, not True",
        ),
    ],
)
def test_a_wrong_sweep_is_one_sentence_that_names_file_and_key(old: str, new: str, message: str) -> None:
    """As for benches."""
    with pytest.raises(InputError) as refusal:
        parse_sweep(_changed(_SWEEP, old, new), "my-sweep.yaml")
    assert str(refusal.value).startswith(f"my-sweep.yaml: {message}")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "140 degF]",
            "240 degF]",
            "temperatures.7: 115.6 °C lies outside the limits of bench simulated's chamber, -45",
        ),
        ("[-21.5 degF", "[-51 degF", "temperatures.0: -46.11 °C lies outside"),
        ("final: 23 degC", "final: 76 degC", "final: 76 °C lies outside"),
        (
            "[1, 2, 3]",
            "[1, 2, 7]",
            "positions: bench simulated gives no orientation of sensor 2 at position 7; it knows 1",
        ),
    ],
)
def test_a_sweep_that_the_bench_cannot_do_is_refused(old: str, new: str, message: str) -> None:
    """Before anything moves, and with the key of the sweep file."""
    sweep = parse_sweep(_changed(_SWEEP, old, new), "my-sweep.yaml")
    with pytest.raises(InputError) as refusal:
        check_sweep_against_bench(sweep, load_bench("simulated"))
    assert str(refusal.value).startswith(f"my-sweep.yaml: {message}")


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("collect: {duration: 1e300 s}", "collect: duration_s must be a finite number of at most 7 days, not 1e+300"),
        ("collect: {duration: 8 d}", "collect: duration_s must be a finite number of at most 7 days, not 691200"),
        ("collect: {attempts: 100000}", "collect: attempts must be a finite number of at most 1000"),
        ("collect: {motion_limit: 1e6 g}", "collect: motion_limit_g must be a finite number of at most 100 g"),
        ("restabilisation: {band: 1e9 degC}", "restabilisation: band_degC must be a finite number of at most 350 °C"),
        ("restabilisation: {ceiling: 1 year}", "restabilisation: ceiling_s must be a finite number of at most 7 days"),
        ("ramp: 1e300 degC/min", "ramp: must be at most 100"),
    ],
)
def test_what_cannot_be_is_refused(section: str, message: str) -> None:
    """A slip of the pen, or a unit too large: with it the night would never end, or believe everything."""
    with pytest.raises(InputError) as refusal:
        parse_sweep(f"title: t\ntemperatures: [20 degC]\n{section}\n", "s.yaml")
    assert str(refusal.value).startswith(f"s.yaml: {message}")


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("positions: [1, 1, 1]", "positions: 1, 1, 1 is one position 3 times"),
        ("collect: {duration: 7 d}\nself_calibrations_per_temperature: 100", "it would take 2"),
        ("ramp: 1e-9 degC/min", "it would take"),
        (f"positions: [{'1, 2, ' * 500}3]\nself_calibrations_per_temperature: 1000", "1 temperature, 1000 self_"),
    ],
)
def test_a_sweep_that_solves_nothing_or_never_ends_is_refused(section: str, message: str) -> None:
    """Before anything moves."""
    sweep = parse_sweep(f"title: t\ntemperatures: [20 degC]\n{section}\n", "s.yaml")
    with pytest.raises(InputError) as refusal:
        check_sweep_against_bench(sweep, load_bench("simulated"))
    assert str(refusal.value).startswith(f"s.yaml: {message}")


@pytest.mark.parametrize("positions", ["[1]", "[1, 2, 3, 2, 1]", "[1, 1, 3, 3]", "[3, 1]"])
def test_repeated_positions_are_legal_where_they_say_something(positions: str) -> None:
    """There and back again keeps a drift out; two of a kind show the noise; one alone shows a drift."""
    sweep = parse_sweep(f"title: t\ntemperatures: [20 degC]\npositions: {positions}\n", "s.yaml")
    check_sweep_against_bench(sweep, load_bench("simulated"))


def test_settings_that_are_not_given_keep_the_procedures_defaults() -> None:
    """The defaults stand in one place."""
    sweep = parse_sweep("title: t\ntemperatures: [20 degC]\ncollect: {duration: 30 s}\n", "s")
    assert (sweep.collect.duration_s, sweep.collect.settle_s) == (30.0, 20.0)
    assert sweep.procedure().restabilisation.at_least_s == 2700.0


def test_interlock_temperatures_are_points_and_margins_are_differences() -> None:
    """194 °F is 90 °C for a thermometer, 5.4 °F is 3 °C for a margin."""
    text = _BENCH + "interlocks: {unit_low: -40 degF, unit_high: 194 degF, chamber_margin: 5.4 degF}\n"
    interlocks = parse_bench(text, "b").interlocks
    assert interlocks.unit_low_degC == pytest.approx(-40.0)
    assert interlocks.unit_high_degC == pytest.approx(90.0)
    assert interlocks.chamber_margin_degC == pytest.approx(3.0)


def test_faults_of_simulated_devices_are_configuration() -> None:
    """In the words of the simulators."""
    faults = "  imu_faults: [{fault: stall, begins: 1 h, ends: 2 h}]\n  chamber_faults: [{kind: alarm, begins: 3 h}]\n"
    settings = parse_bench(_BENCH + faults, "b").simulation
    assert settings is not None
    assert (settings.imu_faults[0].fault, settings.imu_faults[0].ends_s) == ("stall", 7200.0)
    assert (settings.chamber_faults[0].kind, settings.chamber_faults[0].begins_s) == ("alarm", 10800.0)
    with pytest.raises(InputError, match=r"simulation\.imu_faults\.1\.fault: .gremlins..* allowed: .dropped_frames., "):
        parse_bench(_BENCH + "  imu_faults: [{fault: stall}, {fault: gremlins}]\n", "b")
