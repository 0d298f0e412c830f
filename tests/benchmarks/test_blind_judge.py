"""The judge of sealed cases: what is right is called right, what is wrong wrong, and absent keys are no mistake."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from benchmarks.blind.cases import Noise
from benchmarks.blind.engines import answer
from benchmarks.blind.jobs import EIGHT, Job
from benchmarks.blind.judge import (
    all_right,
    answers,
    confidently_wrong,
    false_alarm,
    first_is_right,
    followed,
    kind_hidden,
    listed,
    of_data,
    on_the_mean,
    scatter_named,
    stated,
    told,
)
from benchmarks.blind.score import main, outcome, outcomes, reconcile_job
from benchmarks.blind.tables import tables

STEP = Job("a step", 5, ("jump@any collect",), 12.0, model="matrix-6", design=EIGHT)


def effect(name: str, probability: float = 0.9, **more: Any) -> dict[str, Any]:
    """One found effect; `rivals` are (id, probability, overlap)."""
    rivals = [{"id": r, "probability": p, "overlap": o} for r, p, o in more.pop("rivals", ())]
    return {"id": name, "probability": probability, "confusable_with": rivals, **more}


def document(*effects: dict[str, Any], verdict: str = "named", **more: Any) -> dict[str, Any]:
    """What an engine says, with the keys that the contract demands and no other."""
    gap = {"before": 2.0, "after": 1.0, "noise_floor": 0.9}
    found = {"verdict": verdict if effects else "none", "effects": list(effects), "gap": gap}
    return {**found, "disagreements": [], "next_experiment": None, **more}


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Put an engine that always says the same under a name, as `--engine` takes it."""

    def put(name: str, said: dict[str, Any] | Exception) -> str:
        module = ModuleType(name)

        def reconcile(_campaign: Any, _model: str, *, alpha: float) -> dict[str, Any]:
            assert alpha == STEP.alpha
            if isinstance(said, Exception):
                raise said
            return dict(said)

        module.reconcile = reconcile  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, name, module)
        return f"{name}:reconcile"

    return put


def test_a_hidden_thing_is_right_by_the_name_before_its_form() -> None:
    """A step at any collect is a jump; a label that alone is wrong is nothing to find."""
    assert answers(("jump@any collect", "markov@2 h", "supply")) == ("jump", "markov", "supply")
    assert answers(("label@alone",)) == ()
    kinds = [
        ("jump@any collect",),
        ("markov@2 h",),
        ("markov@2 h", "k2"),
        ("row",),
        ("scale@channel",),
        ("label@alone",),
        (),
    ]
    assert [kind_hidden(k) for k in kinds] == ["mean", "scatter", "both", "fault", "fault", "nothing", "nothing"]


def test_a_wrong_name_is_wrong_and_a_right_one_right() -> None:
    """Of a hidden step: a sure warm-up is wrong, a sure step is right, and so is one of the same class."""
    right, wrong = document(effect("jump")), document(effect("warmup"))
    same = document(effect("ageing", 0.5, rivals=[("jump", 0.4, 0.97)]))
    apart = document(effect("ageing", 0.85, rivals=[("jump", 0.1, 0.6)]))
    hidden = STEP.hidden
    assert [first_is_right(d, hidden) for d in (right, wrong, same, apart)] == [True, False, True, False]
    assert [all_right(d, hidden) for d in (right, wrong, same, apart)] == [True, False, True, False]
    assert [confidently_wrong(d, hidden) for d in (right, wrong, same, apart)] == [False, True, False, True]
    assert [listed(d, hidden) for d in (right, wrong, same, apart)] == [True, False, True, True]
    assert stated(right, hidden) + stated(wrong, hidden) == [(0.9, True), (0.9, False)]
    assert not all_right(document(effect("jump"), effect("supply")), hidden)


def test_what_is_far_down_a_list_is_not_listed() -> None:
    """The 90 % set counts, not every rival that is written."""
    assert not listed(document(effect("warmup", 0.95, rivals=[("jump", 0.01, 0.2)])), STEP.hidden)


def test_scatter_is_right_where_it_is_said_to_scatter_and_an_effect_on_the_mean_in_its_place_is_seen() -> None:
    """The key is optional: absent, an effect moves averages."""
    hidden = ("rrw",)
    named = document(effect("rrw", acts_on="scatter"))
    kin = document(effect("markov", acts_on="scatter"))
    place = document(effect("ageing", 0.9, rivals=[("rrw", 0.05, 0.99)]))
    said = (named, kin, place, document())
    assert [scatter_named(d, hidden) for d in said] == [(True, True), (False, True), (False, False), (False, False)]
    assert [on_the_mean(d, hidden) for d in said] == [False, False, True, False]
    assert on_the_mean(place, hidden, sure=0.8)
    assert not on_the_mean(document(effect("empirical: bias × run", 0.99)), (), sure=0.8)
    assert scatter_named(named, ("supply",)) is None
    assert scatter_named(document(effect("markov", acts_on="scatter")), ("MU_rr",)) == (False, False)


def test_scatter_that_the_noise_has_is_no_false_alarm() -> None:
    """A reseating bearing among noise that reseats is found rightly; elsewhere, or on the mean, it is an alarm."""
    plain, reseats = (Job("", 1, noise=Noise(kind=kind, rho=0.0)) for kind in ("plain", "run_mu"))
    scatters, moves = document(effect("MU_rr", acts_on="scatter")), document(effect("MU_real"))
    assert [false_alarm(d, reseats) for d in (scatters, moves, document())] == [False, True, False]
    assert [false_alarm(d, plain) for d in (scatters, moves, document())] == [True, True, False]
    slow = document(effect("markov", acts_on="scatter"))
    assert [false_alarm(slow, Job("", 1, noise=Noise(rho=rho))) for rho in (0.0, 0.9)] == [True, False]
    assert false_alarm({**document(), "verdict": "unresolved"}, plain)
    label = Job("", 1, ("label@alone",))
    assert [false_alarm(document(effect(n)), label) for n in ("swap", "k2")] == [False, True]
    assert false_alarm(moves, STEP) is None


def test_a_mistake_is_told_by_the_rows_that_a_result_points_at() -> None:
    """As left out, as a place, as a finding of that run; elsewhere or not at all is not told."""
    collects, runs = {7, 8}, {2}
    swapped = effect("swap", shape={"run": 2.0})
    assert told(document(outliers=[{"collect": 7}]), collects, runs)
    assert told(document(swapped), collects, runs)
    assert told(document(disagreements=[{"where": {"runs": [2]}}]), collects, runs)
    others = (document(outliers=[{"collect": 3}]), document(disagreements=[{"where": {"runs": [2, 3]}}]), document())
    assert not any(told(d, collects, runs) for d in (*others, document(effect("swap", shape={"run": 5.0}))))
    assert told(document(swapped), set(), set()) is None
    assert not confidently_wrong(document(swapped), ("pose@collect",), pointed=True)
    assert confidently_wrong(document(effect("k2")), ("pose@collect",), pointed=True)
    data = ("swap", "empirical: runs 4, 9", "empirical: run 14")
    assert all(of_data(effect(name)) for name in data)
    assert not any(of_data(effect(name)) for name in ("empirical: f_S × run", "MU_rr", "k2", "frame"))


def test_what_it_follows_is_judged_where_it_is_said() -> None:
    """The largest driver counts; one that moves nothing hidden is wrong."""
    drivers = [{"driver": "temperature", "probability": 0.1}, {"driver": "time", "probability": 0.9}]
    assert followed(document(follows=drivers), STEP.hidden) == (0.9, True)
    assert followed(document(follows=drivers), ("supply",)) == (0.9, False)
    assert followed(document(), STEP.hidden) is None


def test_engines_see_the_same_files_and_one_that_fails_is_a_result(engine: Any) -> None:
    """A right, a wrong and a broken engine on one sealed case; the table says which is which."""
    names = [
        engine("right", document(effect("jump"))),
        engine("wrong", document(effect("warmup"))),
        engine("broken", ValueError("no such model")),
    ]
    lines = outcomes(STEP, names)
    assert [o["engine"] for o in lines] == names
    assert [o["first"] for o in lines] == [True, False, False]
    assert [o["wrong"] for o in lines] == [False, True, False]
    assert lines[2]["error"] == "ValueError: no such model"
    assert all(o["seconds"] >= 0.0 for o in lines[:2])
    table = tables(json.loads(json.dumps(lines[:2])))
    assert "| right:reconcile | wrong:reconcile | only the first / the last |" in table
    assert "| a step | 1 | first class right | 1.00 [0.03, 1.00] | 0.00 [0.00, 0.97] | 1 / 0 |" in table
    assert "| a step | 1 | confidently wrong | 0.00 [0.00, 0.97] | 1.00 [0.03, 1.00] | 0 / 1 |" in table
    assert "| a step | 1 | failed | – | – | 1 |" in tables(lines)


def test_an_engine_of_another_checkout_is_asked_in_its_own_process(tmp_path: Path) -> None:
    """Its packages are those of the checkout, its answer comes back whole, and what it raises is said."""
    (tmp_path / "hil" / "campaign").mkdir(parents=True)
    for package in ("hil", "hil/campaign"):
        (tmp_path / package / "__init__.py").touch()
    (tmp_path / "hil" / "campaign" / "reader.py").write_text("def read_campaign(folder):\n    return folder.name\n")
    said = json.dumps(document(effect("jump", 0.97))).replace("null", "None")
    (tmp_path / "before.py").write_text(
        f"def reconcile(campaign, model, *, alpha):\n    print('chatter')\n"
        f"    return dict({said}, asked=[campaign, model, alpha])\n"
        "def broken(campaign, model, *, alpha):\n    raise ValueError('no columns')\n"
    )
    first, second = outcomes(STEP, [f"old=before:reconcile@{tmp_path}", f"before:broken@{tmp_path}"])
    assert (first["engine"], first["effects"], first["first"]) == ("old", [("jump", 0.97)], True)
    assert second["error"] == "RuntimeError: ValueError: no columns"
    whole = answer(f"before:reconcile@{tmp_path}", tmp_path / "case", "matrix-6", 0.01)
    assert whole["asked"] == ["case", "matrix-6", 0.01]


def test_an_answer_is_judged_without_any_optional_key(engine: Any) -> None:
    """No acts_on, follows, outliers, kind or overlap; the gap may be unknown."""
    said = document({"id": "jump", "probability": 0.9, "confusable_with": [{"id": "k2", "probability": 0.1}]})
    said["gap"] = {"before": None, "after": None, "noise_floor": 1.0}
    line = outcome(STEP, reconcile_job(STEP, engine("bare", said)))
    assert line["first"]
    assert (line["follows"], line["scatter"], line["told"], line["under"]) == (None, None, None, None)
    assert "stated 0.8 or more is right: 1.00" in tables([line])


def test_kept_lines_are_read_again_and_old_ones_too(
    engine: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A line from before there were engines still makes a table."""
    line = outcomes(STEP, [engine("right", document(effect("jump")))])[0]
    new = ("engine", "asks", "alarm", "mean", "sure", "listed", "scatter", "kin", "told", "follows", "under", "seconds")
    kept = tmp_path / "kept.jsonl"
    kept.write_text(json.dumps({key: value for key, value in line.items() if key not in new}) + "\n")
    main(["--tables", str(kept)])
    assert "| a step | 1 | 1.00 [0.03, 1.00] |" in capsys.readouterr().out
