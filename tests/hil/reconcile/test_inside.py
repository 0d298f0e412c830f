"""What is hidden inside the collects is named from their series: sealed cases by the blind benchmark's generator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import make_case, write_case
from benchmarks.blind.inside import INSIDE, write_series
from benchmarks.blind.jobs import EIGHT
from hil.campaign import Campaign, Series
from hil.campaign.reader import read_campaign
from hil.model import load_model, save_model
from hil.model.effects.catalogue import SERIES_EFFECTS
from hil.model.effects.series import SettlingInCollect
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.inside import within_collects
from tests.hil.model.effect_conditions import ROTOR

SMALL = replace(EIGHT, temperatures_degC=(-20.0, 20.0, 60.0), runs_per_temperature=2)


def campaign_with(name: str, folder: Path, seed: int = 5, rho: float = 0.0) -> Campaign:
    """A night of 24 collects with series in which `name` is hidden ("" for nothing)."""
    case = make_case(seed, model="matrix-6", design=SMALL)
    written = write_case(case, folder / "case")
    write_series(case, name, written, seed, rho)
    return read_campaign(written)


def reconciled(campaign: Campaign, model: str = "matrix-6") -> Reconciliation:
    """The campaign against a model, without the held-out comparison of averages."""
    return reconcile(campaign, load_model(model), prove=False)


QUICK = "settle"


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n == QUICK else pytest.mark.slow) for n in sorted(INSIDE)]
)
def test_what_is_hidden_inside_collects_is_named(name: str, tmp_path: Path) -> None:
    """The series' own name comes first, with its size and where it was seen."""
    result = reconciled(campaign_with(name, tmp_path))
    assert result.effects[0].id == name
    assert result.verdict in {"named", "ambiguous"}
    assert result.effects[0].parameters
    assert "RA" in result.effects[0].parameters[0]["at"]
    assert result.document()["effects"][0]["inside_collects"] is True


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_series_of_noise_alone_get_no_name(rho: float, tmp_path: Path) -> None:
    """White samples and correlated ones."""
    campaign = campaign_with("", tmp_path, rho=rho)
    assert within_collects(campaign, SERIES_EFFECTS, 0.01) == []
    assert reconciled(campaign).verdict == "none"


def flicker(rng: np.random.Generator, samples: int) -> np.ndarray:
    """Noise of which every octave has as much, deg/hr."""
    lines = rng.standard_normal(samples // 2 + 1) + 1j * rng.standard_normal(samples // 2 + 1)
    lines /= np.sqrt(np.maximum(np.arange(len(lines)), 1.0))
    return np.asarray(10.0 * np.fft.irfft(lines, samples) * np.sqrt(samples))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_that_wanders_inside_every_collect_is_no_settling_slope_or_step(seed: int) -> None:
    """Of 36 collects each seems to do one of them by itself; what one does more than the others is still seen."""
    rng, sensor = np.random.default_rng(seed), ROTOR
    regressions = [effect for effect in SERIES_EFFECTS if effect.size]
    every = [Series(np.arange(120.0), np.stack([flicker(rng, 120), flicker(rng, 120)], 1)) for _ in range(36)]
    for effect in regressions:
        own = [effect.test(series, sensor)[0] for series in every]
        assert effect.p_values(own).min() * len(own) * len(regressions) > 0.005
    settles = Series(every[0].t_s, every[0].rates_deg_per_hr + 500.0 * np.exp(-every[0].t_s / 12.0)[:, None])
    found = [SettlingInCollect().test(series, sensor)[0] for series in (settles, *every[1:])]
    p_values = SettlingInCollect().p_values(found)
    assert int(np.argmin(p_values)) == 0
    assert p_values[0] < 1e-3


@pytest.mark.parametrize("name", ["settle", "beat"])
def test_what_no_collect_proves_shows_in_all_together(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every collect begins a little off, or has a weak line; together they are a thousand times further from chance."""
    campaign = campaign_with(name, tmp_path, seed=7)
    effect = next(e for e in SERIES_EFFECTS if e.id == name)
    together = within_collects(campaign, [effect], 0.01)
    monkeypatch.setattr(type(effect), "together", lambda *_: None)
    alone = within_collects(campaign, [effect], 0.01)
    assert [f["channel"] for f in together] == ["RA"]
    assert together[0]["q_value"] < 1e-3 * min([f["q_value"] for f in alone], default=1.0)


@pytest.mark.slow
def test_what_the_model_has_on_record_is_not_found_again(tmp_path: Path) -> None:
    """The improved model, read back, finds nothing more in the same data."""
    campaign = campaign_with("beat", tmp_path)
    first = reconciled(campaign)
    save_model(first.model_after, tmp_path / "model.yaml")
    again = reconciled(campaign, str(tmp_path / "model.yaml"))
    assert first.model_after.version == first.input_model.version + 1
    assert [known.effect for known in first.model_after.inside_collects] == ["beat"]
    assert again.verdict == "none"
    assert again.effects == []
    assert again.within_collects  # it is still told


@pytest.mark.parametrize(("name", "rho"), [("settle", 0.0), ("", 0.9), ("settle", 0.7)])
def test_a_slope_of_the_spectrum_is_no_tone(name: str, rho: float, tmp_path: Path) -> None:
    """Settling and correlated noise make the spectrum fall; all collects together must not call that a line."""
    findings = within_collects(campaign_with(name, tmp_path, seed=11, rho=rho), SERIES_EFFECTS, 0.05)
    assert "beat" not in [finding["id"] for finding in findings]
