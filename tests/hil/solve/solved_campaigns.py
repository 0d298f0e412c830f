"""Campaign folders written as a person would write them, from the one equation, and their solutions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.model.earth import Site
from hil.model.equation import Orientation, pickoff_rates, rotor_matrix
from hil.solve import RunSolution, solve_campaign

TRUTH = np.array([22.08, -37.83, 46.8, -19.8, -37.23, -7.53])
NAMES = ["BA", "BB", "GSA", "GSB", "MUA", "MUB"]
SITE = Site.from_gravity(34.6, 30.0, 0.001, -0.016)
THETA_DEG = {"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}
SIGMA = 0.9

ROTOR_YAML = """\
schema: hil.campaign/1
title: by hand
sensors:
  2:
    axes: [A, B, S]
    channels: {RA: A, RB: B}
"""
TRIAD_YAML = (
    ROTOR_YAML.replace("2:", "1:").replace("[A, B, S]", "[X, Y, Z]").replace("{RA: A, RB: B}", "{GX: X, GY: Y, GZ: Z}")
)
Row = tuple[int, str, np.ndarray, np.ndarray, np.ndarray]  # run, position, f, w, rates


def rotor_row(run: int, position: str, noise: np.ndarray | float = 0.0, truth: np.ndarray = TRUTH) -> Row:
    """One collect at the report's angle, made by the one equation."""
    turned = Orientation.from_rotation_about_2(position, THETA_DEG[position])
    f_g, w = turned.components(SITE.gravity_g()), turned.components(SITE.earth_rate_deg_per_hr())
    return run, position, f_g, w, pickoff_rates(truth[:2], rotor_matrix(*truth[2:]), f_g, w[:2]) + noise


def write(
    folder: Path, yaml: str, axes: str, channels: Sequence[str], rows: Sequence[Row], se: float | None
) -> Campaign:
    """Write the folder as a person would, and read it."""
    names = ["collect", "run", "sensor", "position", "start_s", "duration_s"]
    names += [f"f_{axis}_g" for axis in axes] + [f"w_{axis}_deg_per_hr" for axis in axes]
    names += [f"{channel}_deg_per_hr" for channel in channels]
    names += [f"{channel}_se_deg_per_hr" for channel in channels] if se is not None else []
    lines = [",".join(names)]
    sensor = "1" if axes == "XYZ" else "2"
    for i, (run, position, f_g, w, rates) in enumerate(rows):
        cells = [str(i + 1), str(run), sensor, position, str(i * 100), "60", *map(repr, map(float, [*f_g, *w]))]
        cells += ["" if np.isnan(rate) else repr(float(rate)) for rate in rates]
        cells += [repr(se)] * len(channels) if se is not None else []
        lines.append(",".join(cells))
    (folder / "campaign.yaml").write_text(yaml)
    (folder / "collects.csv").write_text("\n".join(lines) + "\n")
    return read_campaign(folder)


def rotor(folder: Path, rows: Sequence[Row], se: float | None = SIGMA) -> Campaign:
    """Write and read a campaign of sensor 2."""
    return write(folder, ROTOR_YAML, "ABS", ("RA", "RB"), rows, se)


def only(campaign: Campaign, model: str | None = None) -> RunSolution:
    """Solve a campaign of one run."""
    (solution,) = solve_campaign(campaign, model)
    return solution


def values_of(solution: RunSolution) -> list[float | None]:
    """Return the parameters' values in their order."""
    return [estimate.value for estimate in solution.parameters.values()]
