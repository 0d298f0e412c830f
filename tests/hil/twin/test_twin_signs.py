"""Every term of the equation reaches the bytes with the report's sign, decoded by the production path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from hil.bench import build_bench
from hil.config import parse_bench
from tests.hil.twin.quiet import NAMES, collect, quiet_bench

_RESOLUTION = 0.001  # deg/hr, of the frame


def _report(position: str, p: dict[str, float], g: np.ndarray, w: np.ndarray) -> tuple[float, float]:
    """RD-GC-86-1 equations (1) to (6) for sensor 2, written out by hand, and Collect 4 beside them."""
    g1, g2, g3 = g
    w1, w2, w3 = w
    ba, bb, gsa, gsb, mua, mub = (p.get(name, 0.0) for name in NAMES)
    return {
        "1": (ba - gsa * g1 + gsb * g2 + mub * g3 - w1, bb + gsb * g1 + gsa * g2 - mua * g3 + w2),
        "2": (ba + gsa * g1 + gsb * g2 - mub * g3 + w1, bb - gsb * g1 + gsa * g2 + mua * g3 + w2),
        "3": (ba + gsa * g3 + gsb * g2 + mub * g1 + w3, bb - gsb * g3 + gsa * g2 - mua * g1 + w2),
        "4": (ba - gsa * g3 + gsb * g2 - mub * g1 - w3, bb + gsb * g3 + gsa * g2 + mua * g1 + w2),
    }[position]


@pytest.mark.parametrize("name", [*NAMES, "none"])
def test_each_term_of_sensor_2_reaches_the_bytes_with_the_reports_sign(name: str, tmp_path: Path) -> None:
    """One coefficient at a time, and none: then the earth's rate alone is left."""
    values = {name: 100.0} if name != "none" else {}
    bench = quiet_bench(tmp_path, {2: values})
    gravity, earth = bench.site.gravity_g(), bench.site.earth_rate_deg_per_hr()
    with build_bench(bench) as live:
        for position in bench.positions:
            means = collect(live, position)
            expected = _report(position, values, gravity, earth)
            assert (means["rate_A2"], means["rate_B2"]) == pytest.approx(expected, abs=_RESOLUTION)


@pytest.mark.parametrize("name", NAMES)
def test_each_term_of_sensor_1_follows_its_own_orientations(name: str, tmp_path: Path) -> None:
    """Sensor 1's axes from the bench file, in the same equation; sensor 2 does not feel its coefficients."""
    bench = quiet_bench(tmp_path, {1: {name: 100.0}})
    gravity, earth = bench.site.gravity_g(), bench.site.earth_rate_deg_per_hr()
    p = dict.fromkeys(NAMES, 0.0) | {name: 100.0}
    with build_bench(bench) as live:
        for position in bench.positions:
            a, b, s = bench.sensors[1].built[position].axes
            f_a, f_b, f_s = a @ gravity, b @ gravity, s @ gravity
            means = collect(live, position)
            rate_a = p["BA"] + p["GSA"] * f_a + p["GSB"] * f_b + p["MUB"] * f_s + a @ earth
            rate_b = p["BB"] - p["GSB"] * f_a + p["GSA"] * f_b - p["MUA"] * f_s + b @ earth
            assert (means["rate_A1"], means["rate_B1"]) == pytest.approx((rate_a, rate_b), abs=_RESOLUTION)
            assert means["rate_A2"] == pytest.approx(_report(position, {}, gravity, earth)[0], abs=_RESOLUTION)


def test_a_tilted_position_is_turned_the_right_way(tmp_path: Path) -> None:
    """Bench axes into sensor axes, not the other way: the published positions are their own transposes, this is not."""
    text = quiet_bench(tmp_path, {2: {"GSA": 100.0, "MUB": 30.0}}).text
    document = yaml.safe_load(text)
    for sensor in document["sensors"].values():
        sensor["orientations"]["4"] = {"from": "3", "rotate": "40 deg", "about": 1}
    bench = parse_bench(yaml.safe_dump(document), str(tmp_path / "bench.yaml"))
    gravity, earth = bench.site.gravity_g(), bench.site.earth_rate_deg_per_hr()
    cos, sin = np.cos(np.deg2rad(40.0)), np.sin(np.deg2rad(40.0))
    a, b, s = np.array([0.0, -sin, cos]), np.array([0.0, cos, sin]), np.array([1.0, 0.0, 0.0])
    with build_bench(bench) as live:
        means = collect(live, "4")
    rate_a = 100.0 * (a @ gravity) + 30.0 * (s @ gravity) + a @ earth
    rate_b = 100.0 * (b @ gravity) + b @ earth
    assert (means["rate_A2"], means["rate_B2"]) == pytest.approx((rate_a, rate_b), abs=_RESOLUTION)
    assert means["accel_A2"] == pytest.approx(a @ gravity, abs=1e-6)


def test_accelerometers_show_gravity_along_their_axes(tmp_path: Path) -> None:
    """Signs and levels of both pairs at every position."""
    bench = quiet_bench(tmp_path, {})
    gravity = bench.site.gravity_g()
    with build_bench(bench) as live:
        for position in bench.positions:
            means = collect(live, position)
            for number in (1, 2):
                a, b, _ = bench.sensors[number].built[position].axes
                shown = means[f"accel_A{number}"], means[f"accel_B{number}"]
                assert shown == pytest.approx((a @ gravity, b @ gravity), abs=1e-6)


def test_a_sample_taken_during_a_move_shows(tmp_path: Path) -> None:
    """The unit turns about bench axis 2, which is axis B of both sensors: B sees 10⁵ deg/hr, A does not."""
    bench = quiet_bench(tmp_path, {})
    with build_bench(bench) as live:
        collect(live, "1")
        live.devices.imu.read_block()
        live.devices.imu.command_index(3)  # type: ignore[attr-defined]
        live.devices.clock.sleep(2.5)
        fields = live.devices.imu.read_block().fields
    for number in (1, 2):
        assert fields[f"rate_B{number}"][-1] == pytest.approx(1.5 * 90.0 / 5.0 * 3600.0, rel=0.01)
        assert abs(fields[f"rate_A{number}"][-1]) < 50.0
    assert fields["accel_A2"][-1] == pytest.approx(-np.sqrt(0.5), abs=0.02)


def test_settling_after_a_move_dies_away_and_is_slower_when_cold(tmp_path: Path) -> None:
    """30 deg/hr at the end of the move, with 5 s warm and 10 s cold."""
    for temperature, time_constant_s in (("23 degC", 5.0), ("-20 degC", 10.0)):
        bench = quiet_bench(
            tmp_path,
            {},
            settling={"size": "30 deg/hr", "time_constant": "5 s", "time_constant_cold": "10 s"},
            start={"temperature": temperature, "powered_for": "10 h"},
        )
        with build_bench(bench) as live:
            long_after = collect(live, "1", settle_s=400.0)["rate_A2"]
            live.devices.positioner.move_to("2", 60.0)
            live.devices.positioner.move_to("1", 60.0)
            arrived_s = live.simulators.unit._timeline.legs[-1].ends_s  # type: ignore[union-attr]
            live.devices.imu.discard()
            live.devices.clock.sleep(60.0)
            block = live.devices.imu.read_block()
        expected = 30.0 * np.exp(-(block.time_s - arrived_s) / time_constant_s)
        np.testing.assert_allclose(block.fields["rate_A2"] - long_after, expected, atol=0.3)
