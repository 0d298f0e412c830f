"""How wrong a site may be without leaving a residual, and that the report says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.analysis.against import Comparison
from hil.campaign import Campaign, Collects, Conditions
from hil.config import load_bench
from hil.model.earth import Site
from hil.report.content import cannot_tell, gather
from hil.solve import solve_campaign
from hil.solve.precision import smallest_seen_deg
from procedures.verdict import Verdict
from tests.hil.solve.runs_of_a_unit import campaign

BENCH = load_bench("simulated")


def taken(headings: tuple[float, ...], labels: str, noise: float = 0.7, off_deg: float = 0.0) -> Campaign:
    """Return one run of collects whose bench stood at each of the headings, all `off_deg` from what is believed."""
    sensor, poses = BENCH.sensor(2), BENCH.sensors[2].built
    f, w, true = [], [], []
    for heading in headings:
        site, here = (Site(BENCH.site.latitude_deg, heading + off) for off in (0.0, off_deg))
        f += [poses[label].components(site.gravity_g()) for label in labels]
        w += [poses[label].components(site.earth_rate_deg_per_hr()) for label in labels]
        true += [poses[label].components(here.earth_rate_deg_per_hr()) for label in labels]
    n = len(f)
    count, position = np.arange(1, n + 1), np.array([*labels] * len(headings))
    run, lasts = np.ones(n, dtype=np.int64), np.full(n, 60.0)
    conditions = Conditions(sensor, count, run, position, 600.0 * count, lasts, np.array(f), np.array(w))
    rows = Collects(conditions, np.array(true)[:, :2], np.full((n, 2), noise))
    return Campaign("made", "", {2: rows}, site={"latitude_deg": BENCH.site.latitude_deg})


@pytest.mark.parametrize(
    ("headings", "labels", "seen"), [((30.0,), "123", False), ((30.0,), "1324", False), ((30.0, 210.0), "123", True)]
)
def test_only_a_second_heading_shows_the_site(headings: tuple[float, ...], labels: str, seen: bool) -> None:
    """Gravity stays and the earth rate turns; in one heading no error of any size leaves a residual."""
    made = taken(headings, labels)
    assert all(np.isfinite(least) == seen for least in smallest_seen_deg(made).values())
    assert len(smallest_seen_deg(made)) == 2
    told = " ".join(cannot_tell(gather(made)))
    assert ("of latitude, of any size and of heading, of any size" in told) is not seen
    assert ("of latitude, below 6 deg and of heading, below 6 deg" in told) is seen
    assert "An error of the site" not in " ".join(cannot_tell(gather(taken(headings, labels, 1e-3)))) or not seen
    assert "An error of the site" not in " ".join(cannot_tell(gather(made, None, Comparison(made, made))))


@pytest.mark.parametrize(("times", "verdict"), [(0.5, Verdict.PASS), (3.0, Verdict.FAIL)])
def test_what_it_says_can_be_seen_is_seen(times: float, verdict: Verdict) -> None:
    """An error of the heading of three times that size fails on its residual, one of half of it does not."""
    least = smallest_seen_deg(taken((30.0, 210.0), "123"))["heading"]
    (solved,) = solve_campaign(taken((30.0, 210.0), "123", off_deg=times * least))
    assert solved.verdict is verdict


def test_without_an_earth_rate_or_a_latitude_nothing_can_be_said() -> None:
    """The assumption that it is 0 is said elsewhere."""
    made = taken((30.0,), "123")
    rows = made.sensors[2]
    still = replace(rows, conditions=replace(rows.conditions, w_deg_per_hr=np.zeros((3, 3))))
    assert smallest_seen_deg(replace(made, sensors={2: still})) == {}
    assert smallest_seen_deg(replace(made, site={})) == {}


def test_an_earth_rate_of_nothing_where_the_site_has_a_latitude_is_no_pass() -> None:
    """What there is of it stood in the parameters, 30 standard errors off, under PASS; where nobody knows it may."""
    one = campaign(6, 2)
    rows = one.sensors[2]
    left_out = replace(rows, conditions=replace(rows.conditions, w_deg_per_hr=np.zeros((len(rows), 3))))
    for site, judged in (({}, Verdict.PASS), ({"latitude_deg": 34.6}, Verdict.MARGINAL)):
        solved = solve_campaign(replace(one, sensors={2: left_out}, site=site))
        assert {each.verdict for each in solved} == {judged}
    assert {"w is 0 in every row" in each.reason for each in solved} == {True}
