"""A measured night as a configuration that can be carried out again on simulated devices: its bench, plan and stream.

A night has all of it on record. Of a campaign folder the plan is inferred from its collects, the attitude at each
position from gravity and earth rate along the sensor's axes, and the stream is made up.
"""

from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hil.campaign import Campaign, Conditions, FloatArray
from hil.campaign.data import EARTH_RATE_DEG_PER_HR
from hil.config.recorded import SCHEMA, understood
from hil.config.unit import of_each
from hil.errors import InputError
from hil.files.strict import find_config, parse_yaml, read_text
from hil.model.earth import Site
from hil.records import reading
from hil.records.reader import is_night
from hil.records.units import place_of
from hil.solve.temperatures import level_degC, same_temperature
from procedures.words import listed

_LOOKED_AT = {"interval": "90 s", "read_interval": "90 s"}  # seldom: simulated devices keep every byte
_OVERHEAD_BYTES = 11  # sync, id, status, counter, position and checksum of an MFS frame
_INFERRED = "inferred"
_MARGIN_DEGC = 20.0


def configuration(folder: Path, campaign: Campaign) -> tuple[dict[str, Any], bool]:
    """Return hil.configuration/1 of what is in a folder, without its model; and whether its devices are assumed.

    Raises `InputError` where the plan of a campaign cannot be inferred from its collects.
    """
    if is_night(folder):
        with reading(folder) as journal:
            document = understood(journal.night.configuration)
        if unit := place_of(folder)[1]:
            document["bench"] = of_each(document["bench"])[unit]
            document["imu"] = document.get(f"imu-{unit}", document["imu"])
    else:
        document = _inferred(campaign)
    bench = document["bench"]
    for key in ("faults", "notify"):
        bench.pop(key, None)
    for section in ("imu", "chamber"):
        if "port" in bench[section]:
            bench[section]["port"] = f"sim://{section}"
    bench["chamber"].pop("model", None)  # which the simulated one is not
    if bench["unit"]["serial"] in ("", "ask"):
        bench["unit"]["serial"] = "SIM-0001"
    bench |= {"clock": "virtual", "record": {"raw": False}, "polling": dict(_LOOKED_AT)}
    first = str(next(iter(document["sweep"].get("positions", ["1"]))))
    start = {"temperature": document["sweep"].get("start", "23 degC"), "position": first}
    assumed = document["bench_file"] == _INFERRED or "simulation" not in bench
    bench["simulation"] = {"start": start, **bench.get("simulation", {}), "seed": 0, "model": "model"}
    for key in ("imu_faults", "chamber_faults"):
        bench["simulation"].pop(key, None)
    return document, assumed


def _inferred(campaign: Campaign) -> dict[str, Any]:
    site = _site(campaign)
    stream = parse_yaml(read_text(find_config("imus", "mfs")), "mfs")
    frame, roles = stream["frames"]["sample"], stream["roles"]
    rows = [each.conditions for each in campaign.sensors.values()]
    fields: dict[str, str] = {}  # name and unit
    sensors: dict[int, Any] = {}
    roles |= {"sensors": {}, "conditions": {}}
    for own in rows:
        sensor, n = own.sensor, own.sensor.number
        rates = {channel: f"rate_{n}_{k}" for k, channel in enumerate(sensor.channels)}
        axes = {axis: f"accel_{n}_{k}" for k, axis in enumerate(sensor.axes)}
        fields |= dict.fromkeys(rates.values(), "deg/hr") | dict.fromkeys(axes.values(), "g")
        fields[f"inside_{n}_degC"] = "degC"
        roles["sensors"][n] = {"rates": rates, "accelerations": axes, "temperature": f"inside_{n}_degC"}
        if "spin_period_us" in own.columns:
            fields[f"spin_{n}_us"] = "us"
            roles["sensors"][n]["conditions"] = {"spin_period_us": f"spin_{n}_us"}
        lies = {at: {"matrix": _axes(site, own, at).tolist()} for at in dict.fromkeys(own.position.tolist())}
        sensors[n] = {"axes": list(sensor.axes), "channels": dict(sensor.channels), "orientations": lies}
    for name in ("case_degC", "supply_V"):
        if any(name in own.columns for own in rows):
            fields[name], roles["conditions"][name] = name.split("_")[1], name
    frame["fields"] = {name: frame["fields"][name] for name in ("status", "counter", "index_position")}
    frame["fields"] |= {name: {"type": "f64", "unit": unit} for name, unit in fields.items()}
    frame["length"] = _OVERHEAD_BYTES + 8 * len(fields)
    sweep, rest_s = _sweep(campaign, rows[0])
    levels = [float(str(each).split()[0]) for each in sweep["temperatures"]]
    limits = {"low": f"{min(*levels, 23.0) - _MARGIN_DEGC} degC", "high": f"{max(*levels, 23.0) + _MARGIN_DEGC} degC"}
    bench = {
        "name": "inferred",
        "unit": {"model": "MFS-IMU", "serial": "SIM-0001"},
        "site": {
            "latitude": f"{site.latitude_deg} deg",
            "heading": f"{site.heading_deg} deg",
            "axis_2_elevation": f"{site.axis_2_elevation_deg} deg",
            "axis_3_elevation": f"{site.axis_3_elevation_deg} deg",
        },
        "sensors": sensors,
        "imu": {"description": "mfs", "port": "sim://imu", "positioner": "indexing"},
        "chamber": {"driver": "espec", "port": "sim://chamber", "limits": limits, "safe_state": {"action": "standby"}},
        "simulation": {"noise": {"new_run_after_rest": f"{0.5 * rest_s} s"}},
    }
    texts = {"schema": SCHEMA, "bench_file": _INFERRED, "sweep_file": _INFERRED, "bench": bench, "sweep": sweep}
    return {**texts, "imu": yaml.safe_dump(stream, sort_keys=False)}


def _site(campaign: Campaign) -> Site:
    """Where it was measured: as the campaign says, else by the earth rate's part along gravity."""
    said = {f"{name}_deg": campaign.site.get(f"{name}_deg") for name in ("latitude", "heading")}
    rows = next(iter(campaign.sensors.values())).conditions
    up = np.sum(rows.w_deg_per_hr * rows.f_g, axis=1) / np.linalg.norm(rows.f_g, axis=1)
    latitude = float(np.rad2deg(np.arcsin(np.clip(np.median(up) / EARTH_RATE_DEG_PER_HR, -1.0, 1.0))))
    elevations = {f"axis_{k}_elevation_deg": campaign.site.get(f"axis_{k}_elevation_deg") or 0.0 for k in (2, 3)}
    return Site(said["latitude_deg"] or latitude, said["heading_deg"] or 0.0, **elevations)


def _axes(site: Site, rows: Conditions, position: str) -> FloatArray:
    """Return the sensor's axes in the bench frame, (3, 3), rows: those with its gravity and earth rate at a position.

    Of the mirror image, which has the same, nothing shows at rest; nor, where the earth rate has no horizontal part, of
    how a sensor lies about the vertical.
    """
    here = rows.position == position
    pairs = []
    for up, rate in (
        (site.gravity_g(), site.earth_rate_deg_per_hr()),
        (rows.f_g[here].mean(axis=0), rows.w_deg_per_hr[here].mean(axis=0)),
    ):
        up = up / np.linalg.norm(up)
        pairs.append(np.stack([up, rate - up * (rate @ up)]))
    left, _, right = np.linalg.svd(pairs[1].T @ pairs[0])
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _sweep(campaign: Campaign, rows: Conditions) -> tuple[dict[str, Any], float]:
    """Return the sweep of which these are the collects, and how long it rests between two runs, s."""
    station, level = same_temperature(rows), rows.columns.get("temperature_degC", level_degC(rows))
    runs = [np.flatnonzero(rows.run == run) for run in dict.fromkeys(rows.run.tolist())]
    taken = [tuple(rows.position[own].tolist()) for own in runs]
    positions, often = Counter(taken).most_common(1)[0]
    stands = [int(station[own[0]]) for own in runs]
    plateaus = [0, *(k for k in range(1, len(runs)) if stands[k] != stands[k - 1])]
    visits = np.diff([*plateaus, len(runs)]).tolist()
    times, equally = Counter(visits).most_common(1)[0]
    odd = next((rows.run[own[0]] for own, at in zip(runs, taken, strict=True) if at != positions), None)
    alike = f"the same collects in most runs ({', '.join(positions)}, which run {odd} has not)"
    lacks = [alike] * (2 * often <= len(runs)) + ["a known temperature of every run"] * (min(stands) < 0)
    lacks += [f"as many runs at most temperatures ({', '.join(map(str, visits))})"] * (2 * equally <= len(plateaus))
    if lacks:
        raise InputError(f"{campaign.folder}: no plan can be inferred: it takes {listed(lacks)}")
    levels = [23.0 if level is None else float(np.nanmean(level[station == stands[k]])) for k in plateaus]
    settle_s = float(np.nanmedian(rows.columns.get("time_since_index_s", np.array([60.0]))))
    ends_s = rows.start_s + rows.duration_s
    rests = [rows.start_s[b[0]] - ends_s[a[-1]] for a, b in pairwise(runs)]
    rest_s = max(float(np.median(rests)) if rests else 2700.0, 120.0 + settle_s)
    generous = {"band": "2 degC", "slope": "20 degC/min", "unit_band": "20 degC", "unit_slope": "20 degC/min"}
    soak = {"at_least": f"{rest_s - settle_s - 6.0} s", "window": "2 min", "ceiling": "12 h", **generous}
    collect = {"settle": f"{settle_s} s", "duration": f"{float(np.median(rows.duration_s))} s"}
    sweep = {
        "title": campaign.title,
        "temperatures": [f"{each:.1f} degC" for each in levels],
        "self_calibrations_per_temperature": times,
        "positions": list(positions),
        "restabilisation": soak,
        "collect": {**collect, "drift_limit": "1000000 deg/hr/min"},
    }
    return sweep, rest_s
