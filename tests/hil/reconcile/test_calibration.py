"""A unit whose parameters differ at every temperature is calibrated there; what is named is what the form lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.analysis.published.table import read_published_table
from hil.campaign import Campaign
from hil.model import load_model
from hil.reconcile import Reconciliation, reconcile, write_result
from tests.hil.reconcile.hidden_effects import EIGHT, Rows, campaign_of, hidden_campaign, lay_out, noise

DRAWS = 100
B_A = (22.1, 30.5, 21.6, 23.1, 17.7, 9.7, 6.1, 11.4)  # deg/hr at the eight temperatures, irregular as published
B_B = (-37.8, -13.8, -27.7, -5.2, 19.5, 27.0, 34.7, 31.2)
MU_A = (-37.2, 4.2, 0.7, 23.9, 9.2, 6.1, -0.4, 2.0)
MU_B = (-7.5, 3.6, -24.3, -18.3, 0.1, 3.4, -1.6, -0.3)


def published_night(positions: tuple[str, ...], *, seed: int = 3) -> Campaign:
    """Three runs at each of eight temperatures, B and MU irregular from one to the next, GS along a line."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, runs_each=3, positions=positions)
    # Soaked through: a unit that follows the setpoint while its thermometer does not is a late thermometer, and found.
    rows.temperature, rows.slope = rows.setpoint, np.zeros(len(rows))
    return campaign_of(rows, irregular(rows) + noise(rows, rng))


def irregular(rows: Rows) -> np.ndarray:
    """R = B(T) + K(T) f + w with values at the setpoints of their own."""
    at = np.array([EIGHT.index(setpoint) for setpoint in rows.setpoint.tolist()])
    ba, bb, mua, mub = (np.array(values)[at] for values in (B_A, B_B, MU_A, MU_B))
    gsa, gsb = 60.0 + 0.24 * (rows.setpoint - 25.0), -25.0 - 0.1 * (rows.setpoint - 25.0)
    fa, fb, fs = rows.f.T
    ra = ba + gsa * fa + gsb * fb + mub * fs + rows.w[:, 0]
    return np.stack([ra, bb - gsb * fa + gsa * fb - mua * fs + rows.w[:, 1]], 1)


def ids(result: Reconciliation) -> list[str]:
    """Ids in the order found."""
    return [effect.id for effect in result.effects]


@pytest.mark.slow
def test_the_contractors_model_lacks_mass_unbalance_and_nothing_else(tmp_path: Path) -> None:
    """Collects 1-2-3: MU_real alone, ambiguous with k2, Collect 4 next; with it in the model nothing more is found."""
    campaign = published_night(("1", "2", "3"))
    result = reconcile(campaign, "collins-4", draws=DRAWS)
    assert result.calibration == "per temperature"
    assert result.verdict == "ambiguous"
    assert ids(result) == ["MU_real"]
    assert "k2" in {rival.id for rival in result.effects[0].confusable_with}
    assert result.next_experiment is not None
    assert [c["position"] for c in result.next_experiment["collects"]] == ["4"]
    found = {float(p["at"].split()[0]): p["value"] for p in result.effects[0].parameters if p["name"] == "MUB"}
    for setpoint, truth in zip(EIGHT, MU_B, strict=True):
        nearest = min(found, key=lambda t: abs(t - setpoint))
        assert found[nearest] == pytest.approx(truth, abs=4.0)
    assert result.gap.after < 1.3 * result.gap.noise_floor
    assert result.gap.before > 3.0 * result.gap.after
    write_result(result, tmp_path)
    again = reconcile(campaign, load_model(tmp_path / "model.yaml"), draws=DRAWS)
    assert again.verdict == "none"
    assert again.as_it_stands is not None
    assert again.as_it_stands["rms_deg_per_hr"] < 2.0


@pytest.mark.slow
def test_the_fourth_collect_names_it() -> None:
    """Collects 1-2-3-4: k2 no longer looks the same."""
    result = reconcile(published_night(("1", "2", "3", "4")), "collins-4", draws=DRAWS, prove=False)
    assert (result.verdict, ids(result)) == ("named", ["MU_real"])


@pytest.mark.slow
def test_the_full_model_lacks_nothing_on_such_a_night() -> None:
    """matrix-6 has the right form: its values belong to the temperatures, nothing is missing, and that is said."""
    result = reconcile(published_night(("1", "2", "3")), "matrix-6", draws=DRAWS, prove=False)
    assert (result.verdict, ids(result)) == ("none", [])
    assert result.calibration == "per temperature"
    assert any("calibrated at each temperature" in note for note in result.notes)


def test_a_bias_that_follows_temperature_smoothly_is_a_finding_and_no_calibration() -> None:
    """A smooth curve has a name and costs less than a value at each temperature."""
    campaign = hidden_campaign(
        11, lambda r: np.stack([0.3 * (r.temperature - 20.0), 0.004 * (r.temperature - 20.0) ** 2], 1), thermal=False
    )
    result = reconcile(campaign, "matrix-6", draws=DRAWS, prove=False)
    assert result.calibration == "one set"
    assert ids(result) == ["bias_T"]


def test_the_published_table_ends_at_mass_unbalance(reference: Path) -> None:
    """Printed means, one run per temperature: MU_real or k2, on the stated errors, and no claim of a held-out proof."""
    result = reconcile(read_published_table(reference / "table1.csv"), "collins-4", draws=DRAWS)
    assert (result.verdict, ids(result)) == ("ambiguous", ["MU_real"])
    assert {rival.id for rival in result.effects[0].confusable_with} >= {"k2"}
    assert result.next_experiment is not None
    assert [c["position"] for c in result.next_experiment["collects"]] == ["4"]
    assert result.gap.held_out.startswith("not held out")
    assert any("stated standard errors" in note for note in result.notes)


def test_one_run_per_temperature_with_nothing_missing_is_none() -> None:
    """The same layout, the contractor's model true: neither calibration finds anything."""
    campaign = hidden_campaign(5, thermal=False, mu=False, runs_each=1, positions=("1", "2", "3"))
    assert reconcile(campaign, "collins-4", draws=DRAWS).verdict == "none"
