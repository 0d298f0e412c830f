"""What is hidden inside the collects is named from their series: sealed cases by the blind benchmark's generator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import make_case, write_case
from benchmarks.blind.inside import INSIDE, write_series
from benchmarks.blind.jobs import EIGHT
from hil.campaign import Campaign, Series
from hil.campaign.reader import read_campaign
from hil.model import Model, load_model, save_model
from hil.model.effects.base import VarianceEffect
from hil.model.effects.catalogue import SERIES_EFFECTS
from hil.model.effects.noise import BiasInstability, RateRandomWalk
from hil.model.effects.scatter import drawn
from hil.model.effects.series import SettlingInCollect
from hil.model.stated_noise import SensorNoise
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.inside import Wander, wandering, within_collects
from hil.reconcile.outcome.stated import beside, with_white_noise
from hil.reconcile.scattering import what_scatters
from tests.hil.model.effect_conditions import ROTOR

SMALL = replace(EIGHT, temperatures_degC=(-20.0, 20.0, 60.0), runs_per_temperature=2)


def campaign_with(name: str, folder: Path, seed: int = 5, rho: float = 0.0) -> Campaign:
    """A night of 24 collects with series in which `name` is hidden ("" for nothing)."""
    case = make_case(seed, model="matrix-6", design=SMALL)
    written = write_case(case, folder / "case")
    write_series(case, name, written, seed, rho)
    return read_campaign(written)


def reconciled(campaign: Campaign, model: str | Model = "matrix-6") -> Reconciliation:
    """The campaign against a model, without the held-out comparison of averages."""
    return reconcile(campaign, model, prove=False)


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


def with_further(plain: Campaign, every: Sequence[Series | None], further: np.ndarray) -> Campaign:
    """Return a campaign with something further in its series, (n, samples, 2)."""
    more = [
        replace(each, rates_deg_per_hr=each.rates_deg_per_hr + own) for each, own in zip(every, further, strict=True)
    ]
    return replace(plain, recorded={n: partial(replace, each) for n, each in zip(plain.recorded, more, strict=True)})


def wandering_as_flicker(
    plain: Campaign, size: float, seed: int, what: type[VarianceEffect] = BiasInstability
) -> Campaign:
    """A campaign with flicker in its series and averages, in deg/hr, whose standard errors allow for it; or a walk."""
    rows = plain.sensors[2]
    every = [plain.series(collect) for collect in rows.conditions.collect.tolist()]
    t_s = np.concatenate([begins + each.t_s for begins, each in zip(rows.conditions.start_s, every, strict=True)])
    fine = rows.conditions.rows(np.repeat(np.arange(len(every)), len(every[0].t_s)))
    fine = replace(fine, start_s=t_s, duration_s=np.full(len(t_s), 0.2))
    rng = np.random.default_rng(seed)
    more = size * drawn([what().scatter(fine, {})], [fine], rng)[0]
    more = more.reshape(len(every), -1, 2)
    rates, errors = rows.rates_deg_per_hr + more.mean(axis=1), 3.0 * rows.rates_se_deg_per_hr
    sensors = {2: replace(rows, rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)}
    return replace(with_further(plain, every, more), sensors=sensors)


def test_what_flicker_scatters_averages_by_is_taken_in_square_from_what_they_scatter_by() -> None:
    """5 deg/hr of which flicker does 3 are 4 more, less surely; what is as good as all flicker is no more at all."""
    own = Wander(1.0, 0.1, None, np.zeros(0), within=2.0, between=3.0)
    sizes = {"run_offset_deg_per_hr": 5.0, "run_offset_se_deg_per_hr": 0.4}
    sizes |= {"collect_to_collect_deg_per_hr": 2.1, "collect_to_collect_se_deg_per_hr": 0.4}
    (left,) = beside([{"sensor": 2, "channel": "RA", "scatter": [], **sizes}], {2: own})
    assert (left["run_offset_deg_per_hr"], left["run_offset_se_deg_per_hr"]) == pytest.approx((4.0, 0.5))
    assert left["collect_to_collect_se_deg_per_hr"] is None


@pytest.mark.slow
def test_noise_that_wanders_where_no_run_was_repeated_leaves_open_what_runs_scatter_by(tmp_path: Path) -> None:
    """One run at each temperature: what of it is from run to run is not known, and less the flicker no more so."""
    wanders = wandering_as_flicker(campaign_with("", tmp_path), 5.0, 1)
    rows = wanders.sensors[2]
    of_three = replace(wanders, sensors={2: rows.rows(np.isin(rows.conditions.run, [1, 3, 5]))})
    alone = reconciled(of_three)
    assert None in [each["run_offset_deg_per_hr"] for each in alone.noise]
    (told,) = [note for note in alone.notes if "show flicker" in note]
    assert told.removesuffix(", which model.yaml states") in what_scatters(of_three).sentences()


def test_a_series_that_walks_shows_no_flicker(tmp_path: Path) -> None:
    """It was a bias instability of seven errors, beside an Allan deviation that knows a walk by its slope."""
    plain = campaign_with("", tmp_path)
    told = [wandering(wandering_as_flicker(plain, 300.0, seed, RateRandomWalk), 2) for seed in range(8)]
    assert told == [None] * 8
    assert all(wandering(wandering_as_flicker(plain, 30.0, seed), 2) is not None for seed in range(4))


@pytest.mark.slow
def test_noise_that_wanders_inside_the_collects_is_written_as_white_noise_and_flicker(tmp_path: Path) -> None:
    """Each of its size, though standard errors hold both; what it scatters averages by is stated once; and that is all.

    Where averages do not wander samples are only filtered, and a shape is none: then nothing of it is written.
    """
    plain, size = campaign_with("", tmp_path), 30.0
    rows = plain.sensors[2]
    every = [plain.series(collect) for collect in rows.conditions.collect.tolist()]
    wanders = wandering_as_flicker(plain, size, 3)
    result = reconciled(wanders)
    noise = result.model_after.noise[2]
    white = float(np.median(rows.rates_se_deg_per_hr)) * np.sqrt(60.0 / 3600.0)
    assert noise.angle_random_walk.at([-20.0, 20.0, 60.0]) == pytest.approx(white, rel=0.1)
    (term,) = noise.scatter
    (curve,) = term.parameters.values()
    assert term.effect == "flicker"
    assert abs(curve.value - size) < 3.0 * curve.se < 0.3 * size
    assert not noise.collect_to_collect
    assert not noise.run_to_run
    assert any("show flicker" in note for note in result.notes)
    again = reconcile(wanders, result.model_after, prove=False)
    assert again.model_after == again.input_model
    named = term.model_copy(update={"parameters": {"B_f": curve.scaled(0.5)}, "added": {"name": "flicker"}})
    sized = with_white_noise(
        result.input_model.model_copy(update={"noise": {2: SensorNoise(scatter=(named,))}}),
        wanders,
        wanders={2: wandering(wanders, 2)},
    )
    assert sized.noise[2].scatter == (term.model_copy(update={"added": named.added}),)
    quiet = replace(wanders, sensors={2: rows})
    assert not any("show flicker" in note for note in reconciled(quiet).notes)
    settles, steps = 100.0 * np.exp(-every[0].t_s / 8.0), 100.0 * (every[0].t_s > 30.0)
    few = np.arange(len(every)) % 6 == 0
    for shapes in (np.outer(np.ones(len(every)), settles), np.outer(few, steps)):
        settling = with_further(wanders, every, shapes[:, :, None])
        assert not any("show flicker" in note for note in reconciled(settling).notes)


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
@pytest.mark.parametrize(("effect", "unit"), [("markov", "deg/hr"), ("MU_rr", "deg/hr/g")])
def test_a_slope_inside_collects_is_the_slow_effects_that_the_model_states(
    effect: str, unit: str, tmp_path: Path
) -> None:
    """A bias that wanders drifts through every collect; an MU that differs from run to run through none."""
    plain = campaign_with("", tmp_path)
    every = [plain.series(collect) for collect in plain.recorded]
    ramp = np.linspace(-60.0, 60.0, len(every[0].t_s))
    drifts = with_further(plain, every, np.broadcast_to(ramp[:, None], (len(every), len(ramp), 2)))
    size = {"unit": unit, "value": 1.0}
    shape, name = ({"tau_hr": 0.5}, "sigma_m") if effect == "markov" else ({}, "s_mu")
    noise = SensorNoise.model_validate({"scatter": [{"effect": effect, "parameters": {name: size}, "shape": shape}]})
    result = reconciled(drifts, load_model("matrix-6").model_copy(update={"noise": {2: noise}}))
    assert {each["id"] for each in result.within_collects} >= {"drift"}
    assert ("drift" in [each.id for each in result.effects]) is (effect == "MU_rr")


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
