"""The static stretches of a log as a campaign: a collect each, poses by gravity, rates with honest standard errors.

    made = campaign_of_log(read_log(read_columns(path)), StaticTest(), latitude_deg=48.1)
    write_log_campaign(made, Path("my-campaign"))
    made.document["accelerometer"]["parameters"]["b_X"]

f of a pose is the direction in which the calibrated accelerometers show the acceleration reaction, at 1 g, which is
what it is at rest. Which way north lies, gravity does not tell: of the earth rate the vertical part is known where the
latitude is given, and the rest is in the rates.
"""

import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hil.analysis.log.accelerometer import NAMES, Accelerometers
from hil.analysis.log.reading import AXES, CHANNELS, Log
from hil.analysis.log.static import StaticTest, Stretch, static_stretches
from hil.analysis.log.turns import fit_turns
from hil.campaign import Campaign, Collects, Conditions, FloatArray, Sensor, Series
from hil.campaign.data import EARTH_RATE_DEG_PER_HR, known_mean
from hil.campaign.warnings import F_LIMITS_G, F_SUSPICIOUS
from hil.campaign.writer import write_campaign
from hil.errors import InputError
from hil.files.page import filled
from procedures.averaging import average_series
from procedures.verdict import Judgement, Verdict
from procedures.words import counted, listed, numbered

ACCELEROMETER_FILE = "accelerometer.json"
_AXIS_LABEL = re.compile(r"([+\-−]?)\s*([XYZ])\s*([+\-−]?)\s*(up|down)?", re.IGNORECASE)
_OF_AN_AXIS = 0.87  # of f lies along an axis by which a pose is called: 30 degrees; beyond, it stands between axes


@dataclass(frozen=True)
class LogCampaign:
    """A campaign and the document of `hil import log` (schema hil.import-log/1)."""

    campaign: Campaign
    document: dict[str, Any]


def campaign_of_log(log: Log, test: StaticTest, *, latitude_deg: float | None = None) -> LogCampaign:
    """Return the campaign that the static stretches of `log` make; raise `InputError` where they make none."""
    stretches, sentences = static_stretches(log, test)
    n = len(stretches)
    averages = [average_series(log.time_s[each.rows], log.values[each.rows]) for each in stretches]
    mean, se = np.array([each.mean for each in averages]), np.array([each.se for each in averages])
    _check_size(log, mean[:, 3:])
    fitted = Accelerometers(mean[:, 3:], se[:, 3:])
    calibrated = fitted.f_g(mean[:, 3:])
    f_g = calibrated / np.linalg.norm(calibrated, axis=1, keepdims=True)
    positions, contradicted = _positions(log, stretches, f_g)
    told = _calibration_in_words(fitted, n)
    turns = fit_turns(log, stretches, f_g, mean[:, :3])
    up = EARTH_RATE_DEG_PER_HR * np.sin(np.deg2rad(latitude_deg or 0.0)) * f_g
    layout = Sensor(1, AXES, dict(zip(CHANNELS, AXES, strict=True)))
    start_s, last_s = np.array([log.time_s[each.rows][[0, -1]] for each in stretches]).T
    columns = {"n_samples": np.array([each.n for each in averages], dtype=np.float64)}
    columns |= {f"accelerometer_{axis}_g": calibrated[:, j] for j, axis in enumerate(AXES)}
    if log.temperature_degC is not None:
        columns["temperature_degC"] = np.array([known_mean(log.temperature_degC[each.rows]) for each in stretches])
    conditions = Conditions(
        sensor=layout,
        collect=np.arange(1, n + 1),
        run=np.ones(n, dtype=np.int64),
        position=np.array(positions, dtype=np.str_),
        start_s=start_s,
        duration_s=last_s - start_s + log.interval_s,
        f_g=f_g,
        w_deg_per_hr=up,
        columns=columns,
    )
    notes = [
        f"{log.path.name}: {n} static stretches, a collect each",
        *log.notes,
        *sentences,
        *told,
        *(turns.sentences if turns else ["gyros: too few turns for their scale factors: five, of a minute at most"]),
        *contradicted,
        (
            "w is given as 0: neither latitude (--latitude) nor heading is known; the earth rate is in the parameters, "
            "its vertical part (15 deg/hr times the sine of the latitude) as a sensitivity to f along a channel's axis"
            if latitude_deg is None
            else f"w is the vertical part at latitude {latitude_deg:g} deg; which way north lay is not known: the "
            "horizontal part is in the rates"
        ),
    ]
    campaign = Campaign(
        title=f"{log.path.stem}, {counted(n, 'pose')} by hand",
        source=f"{log.path.name}, a log that others recorded",
        sensors={1: Collects(conditions, mean[:, :3], se[:, :3])},
        simulated=log.simulated,
        site={} if latitude_deg is None else {"latitude_deg": latitude_deg},
        condition_units={f"accelerometer_{axis}_g": "what the calibrated accelerometers show, g" for axis in AXES},
        notes="\n".join(notes),
        recorded={k: partial(_series, log, each) for k, each in enumerate(stretches, start=1)},
        verdicts={1: Judgement(Verdict.FAIL, turns.sentences[0])} if turns and turns.astray else {},
    )
    rows = [
        {
            "collect": k + 1,
            "position": positions[k],
            "rows": log.row[each.rows][[0, -1]].tolist(),
            "start_s": float(conditions.start_s[k]),
            "duration_s": float(conditions.duration_s[k]),
            "begins": each.begins,
            "ends": each.ends,
            "shown_g": mean[k, 3:].tolist(),
            "size_of_f_g": 1.0 + float(fitted.residuals_g[k]),
        }
        for k, each in enumerate(stretches)
    ]
    document = {
        "schema": "hil.import-log/1",
        "file": str(log.path),
        "simulated": log.simulated,
        "samples": len(log.row),
        "rate_hz": 1.0 / log.interval_s,
        "stretches": rows,
        "accelerometer": {
            "schema": "hil.accelerometer/1",
            "simulated": log.simulated,
            "model": "m = S N f + b; S = diag(s_X, s_Y, s_Z), N = [[1, 0, 0], [a_YX, 1, 0], [a_ZX, a_ZY, 1]]",
            "poses": n,
            "residual_rms_g": float(np.sqrt(np.mean(fitted.residuals_g**2))),
            "degrees_of_freedom": round(float(fitted.freedom)),
            "errors_enlarged_by": float(fitted.inflation),
            "parameters": fitted.rows(),
            "covariance": fitted.covariance.tolist(),
            "gyros": turns.document() if turns else None,
            "notes": told,
        },
        "notes": notes,
    }
    return LogCampaign(campaign, document)


def write_log_campaign(made: LogCampaign, out: Path) -> Path:
    """Write the campaign with its series and, beside them, what was found of the accelerometers."""
    accelerometer = json.dumps(made.document["accelerometer"], indent=1, allow_nan=False)
    return write_campaign(made.campaign, out, {ACCELEROMETER_FILE: accelerometer.encode()})


def _series(log: Log, stretch: Stretch) -> Series:
    t_s = log.time_s[stretch.rows]
    temperature = None if log.temperature_degC is None else log.temperature_degC[stretch.rows]
    return Series(t_s - t_s[0], log.rates_deg_per_hr[stretch.rows], temperature)


def _check_size(log: Log, mean_g: FloatArray) -> None:
    size = float(np.median(np.linalg.norm(mean_g, axis=1)))
    low, high = F_LIMITS_G
    if not low <= size <= high:
        hint = "m/s^2" if 9.0 < size < 10.5 else "mg" if 900.0 < size < 1100.0 else f"'{1.0 / size:.4g} g'"
        raise InputError(
            f"{log.path}: at rest the accelerometers show {size:.4g} g, where 1 g belongs; their unit is another: "
            f"--accelerometer-scale {hint}?"
        )


def _positions(log: Log, stretches: Sequence[Stretch], f_g: FloatArray) -> tuple[list[str], list[str]]:
    positions, said, turned, axes = [], [], 0, 0
    for k, (each, f) in enumerate(zip(stretches, f_g, strict=True), start=1):
        first, last = log.row[each.rows][[0, -1]]
        given = Counter([] if log.labels is None else log.labels[each.rows].tolist())
        label = given.most_common(1)[0][0].strip() if given else ""
        if len(given) > 1:
            said.append(f"collect {k}: its label changes within ({listed(given)}); taken as {label or 'none'}")
        named = _AXIS_LABEL.fullmatch(label)
        if named is None:
            positions.append(label or f"pose-{k:02d}")
            continue
        axes += 1
        minus = ((named[1] or named[3]) in ("-", "−")) != ((named[4] or "").lower() == "down")
        along = float(f[AXES.index(named[2].upper())]) * (-1.0 if minus else 1.0)
        turned += along < -_OF_AN_AXIS
        worst = int(np.argmax(np.abs(f)))
        seen = f"{'+' if f[worst] > 0 else '-'}{AXES[worst]}"
        if along > _OF_AN_AXIS:
            positions.append(label)
            continue
        between = abs(f[worst]) <= _OF_AN_AXIS
        positions.append(f"pose-{k:02d}" if between else seen)
        said.append(
            f"collect {k} (rows {first}-{last}): its label says {label}, its accelerometers "
            f"{'that it stands between axes' if between else seen} ({f[worst]:+.2f} g along {AXES[worst]}): taken as "
            f"{positions[-1]}"
        )
    if turned == axes > 1:
        raise InputError(
            f"{log.path}: all {axes} labels say the opposite of the accelerations: these seem to be those of gravity, "
            "not of its reaction (+1 g along the axis that points up); give --accelerometer-scale with a minus, "
            "such as '-1 g'"
        )
    return positions, said


def _calibration_in_words(fitted: Accelerometers, n: int) -> list[str]:
    lacking, off = [name for name, of in fitted.rows().items() if not of["told"]], np.abs(fitted.residuals_g)
    known = {
        "poses": counted(n, "pose"),
        "every": len(NAMES),
        "told": len(NAMES) - len(lacking),
        "lacking": listed(lacking) if lacking else "",
        "rms_mg": 1e3 * float(np.sqrt(np.mean(fitted.residuals_g**2))),
        "freedom": round(float(fitted.freedom)),
        "inflation": float(fitted.inflation),
        "off": numbered("collect", (np.flatnonzero(off > F_SUSPICIOUS) + 1).tolist())
        if np.any(off > F_SUSPICIOUS)
        else "",
        "most_g": off.max(),
    }
    return filled(__package__, "calibration.txt.j2", **known).splitlines()
