"""Campaigns of one unit through two years: channel A drifts, channel B of sensor 2 jumps half way."""

from __future__ import annotations

import shutil
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.campaign.writer import write_campaign
from hil.cli.app import run as hil
from hil.records.export import campaign_of_night

COUNT, DAYS = 8, 91
DRIFT, JUMP = 0.8, 25.0  # deg/hr a month, deg/hr


def of_life(campaign: Campaign, number: int, serial: str = "0042", model: str = "MFS-IMU") -> Campaign:
    """Return the calibration of this number in a unit's life."""
    rng = np.random.default_rng(number)
    sensors = {}
    for sensor, of in campaign.sensors.items():
        rates = of.rates_deg_per_hr + rng.normal(0.0, 0.3, of.rates_deg_per_hr.shape)
        rates[:, 0] += DRIFT * DAYS / 30.44 * number
        rates[:, 1] += JUMP * (sensor == 2 and number >= COUNT // 2)
        sensors[sensor] = replace(of, rates_deg_per_hr=rates)
    day = date(2024, 1, 1) + timedelta(days=DAYS * number)
    return replace(
        campaign,
        sensors=sensors,
        recorded={},
        source=f"measured on {day}",
        simulated=False,
        notes="",
        identity={"model": model, "serial": serial},
    )


@pytest.fixture(scope="session")
def measured(night: Path) -> Campaign:
    """What all of them are made of."""
    return campaign_of_night(night)


@pytest.fixture(scope="session")
def campaigns(measured: Campaign, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Campaign folders, in the order of time."""
    folder = tmp_path_factory.mktemp("campaigns")
    return [write_campaign(of_life(measured, number), folder / f"{number}") for number in range(COUNT)]


@pytest.fixture(scope="module")
def archive(campaigns: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of them taken up; to be read, not written to."""
    folder = tmp_path_factory.mktemp("laboratory") / "archive"
    assert hil(["archive", str(folder), *map(str, campaigns)]) == 0
    return folder


@pytest.fixture
def copy(archive: Path, tmp_path: Path) -> Path:
    """One to be spoilt."""
    return Path(shutil.copytree(archive, tmp_path / "archive"))
