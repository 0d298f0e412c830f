"""One night among others: as often unlike as chance says where it is one of them, surely where it is not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.campaign.writer import write_campaign
from hil.likeness.features import features
from hil.likeness.verdict import SMALLEST, verdict
from hil.model import load_model
from hil.records.export import open_source
from tests.hil.solve.runs_of_a_unit import campaign


def nights(values: np.ndarray) -> list[dict[str, float]]:
    """Return nights of numbers, (N, K), of which a third belong to each of three parts and to ten places."""
    names = [json.dumps([("averages", "run_scatter", "series")[k % 3], {"position": str(k % 10)}, f"x{k}"])
             for k in range(values.shape[1])]  # fmt: skip
    return [dict(zip(names, row.tolist(), strict=True)) for row in values]


@pytest.mark.parametrize("kind", ["correlated", "skewed"])
def test_a_night_like_the_others_is_told_apart_as_often_as_stated(kind: str) -> None:
    """At 5 %, by the whole and by the least likely part and place, whatever the numbers depend on."""
    rng, told, placed = np.random.default_rng(3), 0, 0
    for _ in range(300):
        values = rng.standard_normal((21, 30))
        if kind == "correlated":
            values = values + 2.0 * values[:, :1]
        found = verdict(nights(np.exp(values) if kind == "skewed" else values))
        told += found["p_value"] < 0.05
        placed += found["places"][0]["p_value"] < 0.05
        assert found["p_value"] == min(p for p in found["parts"].values() if p is not None)
    assert 0.03 < told / 300 < 0.07
    assert 0.03 < placed / 300 < 0.07


def test_where_one_number_is_far_off_part_and_place_are_named() -> None:
    """Far beyond what ranks of twenty draws could say."""
    values = np.random.default_rng(4).standard_normal((21, 30))
    values[0, 13] = 25.0
    found = verdict(nights(values))
    assert SMALLEST <= found["p_value"] < 1e-3
    assert found["parts"]["run_scatter"] == found["p_value"]
    assert min(found["parts"]["averages"], found["parts"]["series"]) > 0.05
    assert found["parts"]["conditions"] is None
    assert found["places"][0]["where"] == {"position": "3"}
    assert found["places"][1]["p_value"] > 0.05


def test_a_place_has_the_sizes_that_were_left_there() -> None:
    """Of the first night, and the least and the largest of the others, deg/hr: by temperature where any is known."""
    place, whole = {"channel": "RA", "temperature_degC": 23, "position": "1"}, {"channel": "RA", "position": "1"}
    keys = [json.dumps(["run_scatter", where, "size"]) for where in (place, whole)]
    drawn = [dict.fromkeys(keys, size ** (2.0 / 3.0)) for size in (2.0, 1.0, 3.0, 1.5)]
    told = {json.dumps(each["where"]): each for each in verdict(drawn)["places"]}
    assert told[json.dumps(place)]["measured_deg_per_hr"] == pytest.approx(2.0)
    assert told[json.dumps(place)]["simulated_deg_per_hr"] == pytest.approx([1.0, 3.0])
    assert "measured_deg_per_hr" not in told[json.dumps(whole)]
    (alone,) = verdict([{keys[1]: night[keys[1]]} for night in drawn])["places"]
    assert (alone["where"], alone["measured_deg_per_hr"]) == (whole, pytest.approx(2.0))


def test_one_draw_that_is_far_off_makes_no_other_night_unlike() -> None:
    """It is the most unlike of all by itself."""
    values = np.random.default_rng(5).standard_normal((21, 30))
    values[7, 13] = 25.0
    assert verdict(nights(values))["p_value"] > 0.05


def test_what_is_the_same_within_its_resolution_is_alike() -> None:
    """Temperatures within half a degree, times within a minute; ten times as much where the bench is assumed."""

    def of(off_degC: float) -> list[dict[str, float]]:
        key = json.dumps(["conditions", {"sensor": 2}, "temperature_degC"])
        return [{key: 20.0 + (off_degC if k == 0 else 1e-6 * k)} for k in range(21)]

    assert verdict(of(0.3))["p_value"] == pytest.approx(1.0 / 21.0, rel=1.0)  # the most unlike, by next to nothing
    assert verdict(of(9.0))["p_value"] < 1e-3
    assert verdict(of(9.0), 10.0)["p_value"] > 1e-3


def test_nothing_follows_a_condition_that_differs_by_how_it_was_reckoned(tmp_path: Path) -> None:
    """Times since an index move that differ in their last digits are one time: of a share along them there is none."""
    one = campaign(6, 3, seed=1)
    for off in (0.0, 1e-12):
        rows = one.sensors[2]
        columns = {**rows.conditions.columns, "time_since_index_s": 60.4 + off * (np.arange(18) % 5)}
        moved = replace(rows, conditions=replace(rows.conditions, columns=columns))
        write_campaign(replace(one, sensors={2: moved}), folder := tmp_path / str(off))
        told = features(open_source(folder), load_model("matrix-6"), calibrated=False)
        assert told[json.dumps(["averages", {"sensor": 2}, "share along time since index s"])] == 0.0


@pytest.mark.slow
def test_beyond_the_most_unlike_draw_chances_are_as_stated() -> None:
    """Eight draws' ranks say no less than 1/9; below it chances are what they say, by the tail of Student's t."""
    rng = np.random.default_rng(6)
    found = np.array([verdict(nights(rng.standard_normal((9, 12))))["p_value"] for _ in range(1500)])
    assert 0.02 < np.mean(found < 0.03) < 0.04
    assert 0.005 < np.mean(found < 0.01) < 0.02
    assert np.mean(found < 0.001) < 0.005
