"""What is promised is found: the size is that at which the search itself, with its own priors, says so often enough."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from hil.campaign import Campaign, Collects, Conditions, FloatArray
from hil.design.visibility import promise
from hil.design.visibility.document import campaign_document
from hil.design.visibility.map import NoiseLevel, base_values, visibility
from hil.design.visibility.promise import Asked, Rows, Smallest, found_from, thresholds
from hil.model import Model, built_in_model
from hil.model.effects.base import Base, effect_columns
from hil.model.effects.catalogue import EFFECTS, effect_by_id
from hil.model.effects.columns import flattened
from hil.model.effects.thermal import Hysteresis
from hil.model.forms import named_form
from hil.reconcile.search.layout import searches
from hil.reconcile.search.problem import pose
from hil.solve.identifiability import Visible, orthonormal, visible, whitener
from tests.hil.audit.folders import FOLDERS
from tests.hil.model.effect_conditions import campaign

MATRIX_6 = built_in_model("matrix-6")
NOISE = NoiseLevel(collect_deg_per_hr=0.7, run_bias_deg_per_hr=1.1)
ROWS = campaign()
UP_AND_DOWN = campaign(temperatures=(-10.0, 20.0, 50.0, 20.0, -10.0), runs_each=2)


def promised(name: str, sensors: int = 1, rows: Conditions = ROWS, model: Model = MATRIX_6) -> Smallest:
    """Return what is promised of an effect in the rows of these tests."""
    sight = visibility(rows, model, NOISE, sensors=sensors).sight(name)
    assert sight is not None
    return sight.best


def found(name: str, size: float, one: Smallest, rows: Conditions, model: Model) -> float:
    """Return in which share of nights with an effect of a size the search's own scan has odds of 19 for its name."""
    rng, nights, (shown, offsets) = np.random.default_rng(3), 200, (NOISE.collect_deg_per_hr, NOISE.run_bias_deg_per_hr)
    base, effect = base_values(rows, model), effect_by_id(name)
    names = [parameter.name for parameter in effect.parameters_for(rows)]
    column = effect_columns(effect, rows, base, one.easiest_shape)[:, :, names.index(one.parameter.name)]
    rates = rng.normal(0.0, shown, (nights, len(rows), 2)) + size * column
    rates += rng.normal(0.0, offsets, (nights, rows.run.max() + 1, 2))[:, rows.run]
    night = Collects(rows, base.rates + rates[0], np.full_like(rates[0], shown))
    search = searches(pose(Campaign("t", "s", {2: night}), model, EFFECTS), (), ())[2]
    own = [j for j, term in enumerate(search.terms) if term.name == name]
    data = [rates[:, block.block.rows, block.block.channel].T for block in search.blocks]
    log_odds = search.scan_many(data)[own] + search.log_odds[own][:, None]
    return float(np.mean(np.logaddexp.reduce(log_odds, axis=0) > np.log(19.0)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rows", "form"),
    [
        *((name, ROWS, "matrix-6") for name in ("GS_T", "bias_Tdot", "hyst", "jump", "warmup")),
        ("hyst", UP_AND_DOWN, "matrix-6-thermal"),
    ],
    ids=["GS_T", "bias_Tdot", "hyst", "jump", "warmup", "hyst of ten runs"],
)
def test_the_search_finds_what_is_promised_and_not_half_of_it(name: str, rows: Conditions, form: str) -> None:
    """Of a column within runs, of one that is the same in a whole run, of one value and of one for each channel."""
    one = promised(name, rows=rows, model=(model := built_in_model(form)))
    assert 0.75 <= found(name, one.easiest, one, rows, model) <= 0.99  # and what has another name is found as well
    assert found(name, 0.5 * one.easiest, one, rows, model) < 0.4


BIASES = np.broadcast_to(np.eye(2), (len(ROWS), 2, 2))
SIGMA = np.full((len(ROWS), 2), NOISE.collect_deg_per_hr)
WHITEN = whitener(ROWS, SIGMA, BIASES, np.full(2, NOISE.run_bias_deg_per_hr))


SIGMA = np.full((len(ROWS), 2), NOISE.collect_deg_per_hr)


def asked(name: str, *seen: Visible, log_prior: float = -5.0) -> Asked:
    """Return an effect that is seen so in its shapes."""
    effect = effect_by_id(name)
    return Asked(effect, effect.parameters_for(ROWS), [{}] * len(seen), seen, log_prior)


def test_a_size_that_is_promised_in_any_shape_is_found_in_so_many_of_them() -> None:
    """Of two shapes one shows a third of the other; where more than a tenth of them never show, no size is promised."""
    base = orthonormal(WHITEN @ flattened(named_form("matrix-6", ROWS).columns(ROWS)))
    rows = Rows(WHITEN, base, SIGMA)
    shape = {"half_width_degC": 20.0, "from_degC": 20.0}
    columns = WHITEN @ flattened(effect_by_id("hyst").columns(ROWS, None, shape))

    def shown(*weights: float) -> Asked:
        return asked("hyst", *(visible(weight * columns, base, np.ones(2)) for weight in weights))

    def size(*weights: float) -> float:
        return found_from([shown(*weights)], rows)[0][0].value

    both = size(1.0, 1.0 / 3.0)
    assert size(1.0) < both < size(1.0 / 3.0)
    (reach,), (needed,) = thresholds([shown(1.0, 1.0 / 3.0)], rows)
    assert np.mean(ndtr(both * reach[:, 0] - needed[:, 0])) == pytest.approx(0.9, abs=1e-3)
    assert size(1.0, 0.0) == np.inf
    several = found_from([asked("hyst", *shown(*[1.0] * 19, 0.0).seen, log_prior=-5.0 - np.log(19.0))], rows)[0][
        0
    ].value
    assert several == pytest.approx(size(1.0), rel=0.1)


def test_what_looks_the_same_is_asked_for_together() -> None:
    """Shapes and names that nobody can tell apart share the odds of being there; what looks otherwise adds nothing."""
    base = orthonormal(WHITEN @ flattened(named_form("matrix-6", ROWS).columns(ROWS)))
    rows = Rows(WHITEN, base, SIGMA)
    every = WHITEN @ np.random.default_rng(4).standard_normal((2 * len(ROWS), 4))
    one, other = (visible(own, base, np.ones(2)) for own in (every[:, :2], every[:, 2:]))
    alone, alike, apart = (
        thresholds([asked("hyst", one), *more], rows)[1][0][0, 0]
        for more in ([], [asked("hyst", one, log_prior=-1.0)], [asked("hyst", other, log_prior=-1.0)])
    )
    assert alike < 0.9 * alone
    assert apart == pytest.approx(alone, rel=1e-3)


def test_what_most_are_found_by_is_asked_first_and_all_are_found_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not found by usual deviations is asked by all; a map asks by half of them, and tells the same."""
    asked_by, log_evidence = [], Rows.log_evidence

    def counted(rows: Rows, shares: FloatArray, deviations: FloatArray = promise.DEVIATIONS) -> FloatArray:
        asked_by.append(len(shares) * len(deviations))
        return log_evidence(rows, shares, deviations)

    monkeypatch.setattr(Rows, "log_evidence", counted)
    found, told = [], []
    for usual in (promise.USUAL, 5, len(promise.DEVIATIONS)):
        monkeypatch.setattr(promise, "USUAL", usual)
        asked_by.clear()
        found.append([sight.smallest for sight in visibility(UP_AND_DOWN, MATRIX_6, NOISE).effects])
        told.append(sum(asked_by))
    assert found[0] == found[1] == found[2]
    assert told[0] < 0.6 * told[2]


def test_each_shape_of_an_effect_is_laid_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that a map keeps of all that are tried had been laid a second time."""
    laid, columns = [], Hysteresis.columns

    def counted(effect: Hysteresis, rows: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        laid.append(tuple(shape.values()))
        return columns(effect, rows, base, shape)

    monkeypatch.setattr(Hysteresis, "columns", counted)
    visibility(UP_AND_DOWN, MATRIX_6, NOISE)
    assert len(laid) == len({*laid}) > 1


def test_a_base_is_inverted_once_for_all_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """What an effect leaks into the parameters takes the inverse of the base, which no effect changes."""
    inverted, pinv = [], np.linalg.pinv
    monkeypatch.setattr(np.linalg, "pinv", lambda *of, **how: inverted.append(of) or pinv(*of, **how))
    visibility(UP_AND_DOWN, MATRIX_6, NOISE)
    assert len(inverted) == 1


def test_what_a_whole_run_has_in_common_is_apart_from_the_rest() -> None:
    """By channel: a bias of each run in the one, and what adds up to nothing in a run in the other; nothing is lost."""
    rows = Rows(WHITEN, np.zeros((2 * len(ROWS), 0)), SIGMA)
    rng, runs = np.random.default_rng(5), ROWS.run - ROWS.run.min()
    of_runs = rng.standard_normal(runs.max() + 1)[runs, None] * [1.0, 0.0]
    shared, _, rest, other = rows.squares(WHITEN @ of_runs.reshape(-1, 1))[:, 0]
    assert shared > 0.0
    assert max(rest, other) < 1e-9 * shared
    within = np.tile([1.0, -2.0, 1.0], len(ROWS) // 3)[:, None] * [0.0, 1.0]
    assert rows.squares(WHITEN @ within.reshape(-1, 1))[:3, 0] == pytest.approx(0.0, abs=1e-9)
    any_column = rng.standard_normal((2 * len(ROWS), 1))
    assert rows.squares(any_column).sum() == pytest.approx(np.sum(any_column**2))
    assert rows.freedom[:2] == pytest.approx(24.0)
    assert rows.freedom[2:] == pytest.approx(48.0)


def test_what_shows_in_one_rate_may_be_a_wrong_one() -> None:
    """How much of a column one rate explains beside the base; of what one explains whole nothing typical is seen."""
    base = orthonormal(WHITEN @ flattened(named_form("matrix-6", ROWS).columns(ROWS)))
    rows, effect = Rows(WHITEN, base, SIGMA), effect_by_id("jump")
    every = WHITEN @ np.eye(2 * len(ROWS))
    every -= base @ (base.T @ every)
    some = every @ np.random.default_rng(8).standard_normal((len(every), 3))
    cosine = (every / np.linalg.norm(every, axis=0)).T @ (some / np.linalg.norm(some, axis=0))
    assert rows.in_one(some) == pytest.approx(np.max(cosine**2, axis=0))
    assert rows.in_one(every[:, 7:9]) == pytest.approx(1.0)
    single, many = (
        found_from([asked("jump", visible(own, base, np.ones(2)))], rows)[0][0].value
        for own in (every[:, :2], every[:, :12].reshape(-1, 6, 2).sum(axis=1))
    )
    assert many < effect.parameters[0].typical[1] < single


def test_noise_that_few_rows_tell_may_be_what_is_seen() -> None:
    """Offsets from run to run may be larger than is assumed, the more so the fewer runs beside the base tell it."""
    runs, rng = np.unique(ROWS.run, return_inverse=True)[1], np.random.default_rng(6)
    of_rows = rng.standard_normal((runs.max() + 1, 20))[runs, None] * np.array([1.0, 0.0])[:, None]
    white = orthonormal(WHITEN @ flattened(of_rows))
    against = []
    for values in (1, 12, 19):
        rows = Rows(WHITEN, white[:, :values], SIGMA)
        at_rest, *_, shown = rows.log_evidence(np.array([1.0, 0.0, 0.0, 0.0]))[:31]  # of six deviations
        against.append(float(at_rest - shown))
    assert 18.0 > against[0] > 1.2 * against[1] > 1.5 * against[2] > 0.0  # were the noise known: half of 36


@pytest.mark.slow
def test_what_one_sensor_of_two_has_is_asked_for_more() -> None:
    """An effect is in other sensors, too, as a rule: alone it costs more; a cause that all have in common does not."""
    ratio = {name: promised(name, 2).easiest / promised(name).easiest for name in ("GS_T", "hyst", "supply", "warmup")}
    assert min(ratio["GS_T"], ratio["hyst"]) > 1.03
    assert max(ratio["supply"], ratio["warmup"]) == pytest.approx(1.0, abs=0.01)


def test_one_value_of_both_channels_is_seen_in_both() -> None:
    """A lag acts on both: what they show together counts, and the price of its size is paid once."""
    rows = Rows(WHITEN, np.zeros((2 * len(ROWS), 0)), SIGMA)
    both = np.where(np.arange(2 * len(ROWS)) % 6 < 2, 1.0, -0.5)[:, None]  # nothing that a run has in common
    alone = both * rows.channel[:, :1]
    seen = [visible(own, np.zeros((len(both), 0)), np.ones(1)) for own in (both, alone)]
    sizes = [found_from([asked("T_lag", own)], rows)[0][0].value for own in seen]
    assert sizes[1] / sizes[0] == pytest.approx(np.sqrt(2.0), rel=0.05)


def test_a_channel_that_measured_nothing_asks_for_no_noise() -> None:
    """Of no rows nothing was divided by nothing, and the command ended in an internal error."""
    found: Any = campaign_document(FOLDERS["dead channel"](), changes=())
    assert all(effect["smallest_visible"]["value"] != 0.0 for effect in found["effects"])
    assert any(effect["visible"] for effect in found["effects"])
