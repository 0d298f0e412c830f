"""The frame descriptions that ship decode what real units sent, in the units that the rest of the project speaks."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import load_description
from hil.config import load_bench, load_sweep, parse_bench
from hil.config.recorded import configuration_of, configuration_text
from hil.files.strict import find_config


def test_the_stim300_description_gives_rates_in_deg_per_hr(reference: Path) -> None:
    """Every good captured datagram 0x93, against the values listed beside it."""
    description = load_description(find_config("imus", "stim300"))
    frames = json.loads((reference / "golden_frames.json").read_text())
    good = [f for f in frames if f["layout"] == "stim300_0x93_rate_acc_incl_crlf" and f["checksum_ok"]]
    assert good
    assert description.roles is not None
    # A saturated gyro shows exactly 480 deg/s (0x780000), in the reference's section on the STIM300.
    assert description.roles.sensors[1].at_rest.full_scale_deg_per_hr == 480.0 * 3600.0 == 0x780000 / 2**14 * 3600.0
    for frame in good:
        decoded = StreamDecoder(description).feed(bytes.fromhex(frame["hex"]), 0.0)
        assert decoded.counts.ok == 1
        fields = {name: float(values[0]) for name, values in decoded["rate_acc_incl"].columns.items()}
        for axis, deg_s, g in zip("xyz", frame["expected"]["gyro_deg_s"], frame["expected"]["acc_g"], strict=True):
            assert fields[f"gyro_{axis}"] == pytest.approx(3600.0 * deg_s, abs=1e-9)
            assert fields[f"acc_{axis}"] == pytest.approx(g, abs=1e-12)


def test_the_record_keeps_what_a_description_includes(tmp_path: Path) -> None:
    """A night can be replayed where the included file is not beside the kept one."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["imu"] |= {"description": "novatel", "parameters": {"imu": "STIM300"}}
    bench = parse_bench(yaml.safe_dump(document), "bench.yaml")
    kept, _ = configuration_of(configuration_text(bench, load_sweep("quick")), tmp_path)
    assert kept.imu_description == tmp_path / "imu.yaml"
    assert kept.frames == bench.frames
