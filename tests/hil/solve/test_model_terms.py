"""Solving beside a model file: its named terms are taken off, the rest is solved for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import make_case, write_case
from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.errors import InputError
from hil.model import Model, load_model
from hil.solve import solve_campaign
from hil.solve.beside_terms import solve_beside
from tests.hil.audit.folders import FOLDERS

MODEL_FILE = """
schema: hil.model/1
title: with a term
form: matrix-6
sensors:
  2:
    BA: {unit: deg/hr, value: 0}
    BB: {unit: deg/hr, value: 0}
    GSA: {unit: deg/hr/g, value: 0}
    GSB: {unit: deg/hr/g, value: 0}
    MUA: {unit: deg/hr/g, value: 0}
    MUB: {unit: deg/hr/g, value: 0}
terms: []
"""


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    """A campaign in which the spin-axis drift is what it is."""
    return read_campaign(write_case(make_case(3, model="matrix-6"), tmp_path / "campaign"))


def model(tmp_path: Path, terms: str, form: str = "matrix-6") -> Model:
    """Write a model file with `terms` and read it."""
    path = tmp_path / "model.yaml"
    path.write_text(MODEL_FILE.replace("terms: []", terms).replace("form: matrix-6", f"form: {form}"))
    return load_model(path)


def test_a_named_bias_is_taken_off_the_bias(campaign: Campaign, tmp_path: Path) -> None:
    """A k2 term of +3 deg/hr/g² along A in both channels: Collects 1 and 2 lose 3, and so does the bias."""
    term = "terms:\n  - effect: k2\n    sensor: 2\n    parameters: {kAA_A: {unit: deg/hr/g^2, value: 3}}\n"
    found = solve_beside(campaign, model(tmp_path, term))
    plain = solve_campaign(campaign, "matrix-6")
    f_a = campaign.sensors[2].conditions.f_g[0, 0]
    for ours, theirs in zip(found, plain, strict=True):
        ba, before = ours.parameters["BA"].value, theirs.parameters["BA"].value
        assert ba is not None
        assert before is not None
        assert ba == pytest.approx(before - 3.0 * f_a**2, abs=0.01)
        assert ours.model == "with a term with k2"
        assert any("k2 as model with a term has it" in text for text in ours.assumed)


def test_without_terms_a_model_file_is_its_form(campaign: Campaign, tmp_path: Path) -> None:
    """Values of the base are solved for, not taken from the file."""
    found = solve_beside(campaign, model(tmp_path, "terms: []"))
    for ours, theirs in zip(found, solve_campaign(campaign, "matrix-6"), strict=True):
        assert ours.parameters == theirs.parameters
        assert np.array_equal(ours.covariance, theirs.covariance)


def test_terms_without_values_are_refused(campaign: Campaign, tmp_path: Path) -> None:
    """A term on a sensor for which the file has no base values cannot be taken off."""
    term = "terms:\n  - effect: k2\n    parameters: {kAA_A: {unit: deg/hr/g^2, value: 3}}\n"
    bare = model(tmp_path, term).model_copy(update={"sensors": {}})
    with pytest.raises(InputError, match="no values for sensor 2"):
        solve_beside(campaign, bare)


def test_the_campaign_is_not_changed(campaign: Campaign, tmp_path: Path) -> None:
    """Taking terms off makes new rates and leaves the measured ones."""
    before = campaign.sensors[2].rates_deg_per_hr.copy()
    term = "terms:\n  - effect: k2\n    sensor: 2\n    parameters: {kAA_A: {unit: deg/hr/g^2, value: 3}}\n"
    solve_beside(campaign, model(tmp_path, term))
    assert np.array_equal(campaign.sensors[2].rates_deg_per_hr, before)


def test_a_term_that_follows_temperature_takes_what_stands_in_for_it(tmp_path: Path) -> None:
    """As reconcile took it that found the term; the campaign keeps the thermometers that it has."""
    one = FOLDERS["no thermometer of its own"]()
    term = "terms:\n  - effect: bias_T\n    sensor: 2\n    parameters: {b1_A: {unit: deg/hr/degC, value: 2}}\n"
    chamber = one.sensors[2].conditions.columns["chamber_degC"]
    for ours, theirs in zip(solve_beside(one, model(tmp_path, term)), solve_campaign(one, "matrix-6"), strict=True):
        at = chamber[one.sensors[2].conditions.run == ours.run].mean()
        ba, before = ours.parameters["BA"].value, theirs.parameters["BA"].value
        assert ba is not None
        assert before is not None
        assert ba == pytest.approx(before - 2.0 * (at - 25.0), abs=0.5)
    assert "temperature_degC" not in one.sensors[2].conditions.columns
