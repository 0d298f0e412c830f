"""What is promised is found: the size is that at which the search itself, with its own priors, says so often enough."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from hil.campaign import Campaign, Collects
from hil.design.visibility.map import NoiseLevel, base_values, visibility
from hil.design.visibility.promise import Rows, Smallest, found_from, noise_unknown, thresholds
from hil.model import built_in_model
from hil.model.effects.catalogue import EFFECTS, effect_by_id
from hil.model.effects.columns import flattened
from hil.model.forms import named_form
from hil.reconcile.search.candidates import effect_columns
from hil.reconcile.search.layout import searches
from hil.reconcile.search.problem import pose
from hil.solve.identifiability import Visible, orthonormal, visible, whitener
from tests.hil.model.effect_conditions import campaign

MATRIX_6 = built_in_model("matrix-6")
NOISE = NoiseLevel(collect_deg_per_hr=0.7, run_bias_deg_per_hr=1.1)
ROWS = campaign()


def promised(name: str, sensors: int = 1, noise: NoiseLevel = NOISE) -> Smallest:
    """Return what is promised of an effect in the rows of these tests."""
    sight = visibility(ROWS, MATRIX_6, noise, sensors=sensors).sight(name)
    assert sight is not None
    return sight.best


def found(name: str, size: float, one: Smallest, nights: int = 200) -> float:
    """Return in which share of nights with an effect of a size the search's own scan has odds of 19 for its name."""
    rng, (shown, offsets) = np.random.default_rng(3), (NOISE.collect_deg_per_hr, NOISE.run_bias_deg_per_hr)
    base, effect = base_values(ROWS, MATRIX_6), effect_by_id(name)
    names = [parameter.name for parameter in effect.parameters_for(ROWS)]
    column = effect_columns(effect, ROWS, base, one.easiest_shape)[:, :, names.index(one.parameter.name)]
    rates = rng.normal(0.0, shown, (nights, len(ROWS), 2)) + size * column
    rates += rng.normal(0.0, offsets, (nights, ROWS.run.max() + 1, 2))[:, ROWS.run]
    night = Collects(ROWS, base.rates + rates[0], np.full_like(rates[0], shown))
    search = searches(pose(Campaign("t", "s", {2: night}), MATRIX_6, EFFECTS), (), ())[2]
    own = [j for j, term in enumerate(search.terms) if term.name == name]
    data = [rates[:, block.block.rows, block.block.channel].T for block in search.blocks]
    log_odds = search.scan_many(data)[own] + search.log_odds[own][:, None]
    return float(np.mean(np.logaddexp.reduce(log_odds, axis=0) > np.log(19.0)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["GS_T", "bias_Tdot", "hyst", "jump", "warmup"])
def test_the_search_finds_what_is_promised_and_not_half_of_it(name: str) -> None:
    """Of a column within runs, of one that is the same in a whole run, of one value and of one for each channel."""
    one = promised(name)
    assert 0.82 <= found(name, one.easiest, one) <= 0.99
    assert found(name, 0.5 * one.easiest, one) < 0.4


WHITEN = whitener(ROWS, np.full((len(ROWS), 2), NOISE.collect_deg_per_hr), np.full(2, NOISE.run_bias_deg_per_hr))


def test_a_size_that_is_promised_in_any_shape_is_found_in_so_many_of_them() -> None:
    """Of two shapes one shows a third of the other; where more than a tenth of them never show, no size is promised."""
    base = orthonormal(WHITEN @ flattened(named_form("matrix-6", ROWS).columns(ROWS)))
    effect, rows = effect_by_id("hyst"), Rows(WHITEN, base, 2)
    columns = WHITEN @ flattened(effect.columns(ROWS, None, {"half_width_degC": 20.0, "from_degC": 20.0}))

    def shown(*weights: float) -> list[Visible]:
        return [visible(weight * columns, base, np.ones(2)) for weight in weights]

    def size(*weights: float) -> float:
        return found_from(effect, ROWS, [{}] * len(weights), shown(*weights), -5.0, rows)[0].value

    both = size(1.0, 1.0 / 3.0)
    assert size(1.0) < both < size(1.0 / 3.0)
    reach, needed = thresholds(effect, ROWS, shown(1.0, 1.0 / 3.0), -5.0, rows)
    assert np.mean(ndtr(both * reach[:, 0] - needed[:, 0])) == pytest.approx(0.9, abs=1e-3)
    assert size(1.0, 0.0) == np.inf
    assert size(*[1.0] * 19, 0.0) == pytest.approx(size(1.0), rel=0.1)


def test_what_a_whole_run_has_in_common_is_apart_from_the_rest() -> None:
    """By channel: a bias of each run in the one, and what adds up to nothing in a run in the other; nothing is lost."""
    rows = Rows(WHITEN, np.zeros((2 * len(ROWS), 0)), 2)
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
    rows, effect = Rows(WHITEN, base, 2), effect_by_id("jump")
    every = WHITEN @ np.eye(2 * len(ROWS))
    every -= base @ (base.T @ every)
    some = every @ np.random.default_rng(8).standard_normal((len(every), 3))
    cosine = (every / np.linalg.norm(every, axis=0)).T @ (some / np.linalg.norm(some, axis=0))
    assert rows.in_one(some) == pytest.approx(np.max(cosine**2, axis=0))
    assert rows.in_one(every[:, 7:9]) == pytest.approx(1.0)
    single, many = (
        found_from(effect, ROWS, [{}], [visible(own, base, np.ones(2))], -5.0, rows)[0].value
        for own in (every[:, :2], every[:, :12].reshape(-1, 6, 2).sum(axis=1))
    )
    assert many < effect.parameters[0].typical[1] < single


def test_noise_that_few_rows_tell_may_be_what_is_seen() -> None:
    """Σ ν log(1 + f x/ν) is what is needed: next to x where rows are many, and far less of it where they are few."""
    needed, shares = np.full((1, 1, 1), 25.0), np.array([0.9, 0.1])
    every = [np.array(freedom) for freedom in ((1e6, 1e6), (20.0, 150.0), (8.0, 40.0))]
    many, some, few = (float(noise_unknown(needed, shares[None, :, None], each).item()) ** 2 for each in every)
    assert many == pytest.approx(25.0, rel=1e-4)
    assert np.sum(every[1] * np.log1p(shares * some / every[1])) == pytest.approx(25.0, rel=0.04)
    assert few > 1.5 * some > 2.0 * many


def test_of_few_rows_whatever_is_seen_may_be_errors_that_are_wrong() -> None:
    """Two directions beside the base: that errors hold is not known; of fifty that hardly counts."""
    twice_log, shares = np.full((1, 1, 1), 16.0), np.array([1.0, 0.0])[::-1]
    few, many = (float(noise_unknown(twice_log, shares[None, :, None], np.array([1.0, n])).item()) for n in (2.0, 50.0))
    assert many < 5.0 < 20.0 < few


def test_what_one_sensor_of_two_has_is_asked_for_more() -> None:
    """An effect is in other sensors, too, as a rule: alone it costs more; a cause that all have in common does not."""
    ratio = {name: promised(name, 2).easiest / promised(name).easiest for name in ("GS_T", "hyst", "supply", "warmup")}
    assert min(ratio["GS_T"], ratio["hyst"]) > 1.03
    assert max(ratio["supply"], ratio["warmup"]) == pytest.approx(1.0, abs=0.01)


def test_one_value_of_both_channels_is_seen_in_both() -> None:
    """A lag acts on both: what they show together counts, and the price of its size is paid once."""
    rows, effect = Rows(WHITEN, np.zeros((2 * len(ROWS), 0)), 2), effect_by_id("T_lag")
    both = np.where(np.arange(2 * len(ROWS)) % 6 < 2, 1.0, -0.5)[:, None]  # nothing that a run has in common
    alone = both * rows.channel[:, :1]
    seen = [visible(own, np.zeros((len(both), 0)), np.ones(1)) for own in (both, alone)]
    sizes = [found_from(effect, ROWS, [{}], [own], -5.0, rows)[0].value for own in seen]
    assert sizes[1] / sizes[0] == pytest.approx(np.sqrt(2.0), rel=0.05)
