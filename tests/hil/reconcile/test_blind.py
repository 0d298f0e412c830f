"""A handful of sealed cases from the blind benchmark's generator: silent, right or honest, never confidently wrong."""

from __future__ import annotations

import pytest

from benchmarks.blind.cases import Noise
from benchmarks.blind.jobs import Job
from benchmarks.blind.judge import all_right, confidently_wrong, first_is_right
from benchmarks.blind.score import reconcile_job
from benchmarks.blind.wider import FOUR, ORDINARY

QUICK = ("hyst",)  # a history, which the columns only approximate
SLOW = ("supply", "warmup", "k2", "bias_Tdot")


@pytest.mark.slow  # quick in test_nothing_missing
@pytest.mark.parametrize("kind", ["plain", "heavy"])
def test_a_night_with_nothing_hidden_gets_no_name(kind: str) -> None:
    """Scatter of two kinds is no effect; MU that changes from run to run is one, and is found."""
    document = reconcile_job(Job(kind, 91_000, noise=Noise(kind=kind)))
    assert not confidently_wrong(document, ())


@pytest.mark.slow
def test_what_wanders_from_run_to_run_is_no_sure_name_on_the_averages() -> None:
    """Offsets correlated .97 look like ageing (.91): that nothing stands in its place is too probable to call it so."""
    document = reconcile_job(Job("offsets", 5_758_023, noise=Noise(rho=0.97)))
    assert not confidently_wrong(document, ())


@pytest.mark.slow
def test_offsets_that_wander_beside_an_unbalance_that_differs_from_run_to_run_are_no_effect_on_the_averages() -> None:
    """Two kinds of scatter at once: with one alone the offsets were called ageing (.94)."""
    document = reconcile_job(Job("both", 1_110_017, noise=Noise(kind="run_mu")))
    effects, places = document["effects"], [each["where"] for each in document["disagreements"]]
    assert {effect["acts_on"] for effect in effects} == {"scatter"}
    of_each = {effect["id"]: [each["name"] for each in effect["parameters"]] for effect in effects}
    assert of_each == {"MU_rr": ["s_mu"], "rrw": ["K"]}
    assert [(where["channel"], where["effect"]) for where in places] == [
        ("RA", "MU_rr"),
        ("RB", "MU_rr"),
        ("RB", "rrw"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_a_sealed_effect_of_twelve_sigma_is_in_the_first_class(name: str) -> None:
    """Continuous time constants and a Preisach hysteresis, which the catalogue's columns only approximate."""
    document = reconcile_job(Job(name, 92_000, (name,), 12.0))
    assert first_is_right(document, (name,))
    assert all_right(document, (name,))


@pytest.mark.slow
def test_a_step_that_the_base_alone_takes_for_noise_is_found() -> None:
    """Six terms explain more at the noise that is probable without a step: it is looked at anew beside a step, too."""
    document = reconcile_job(Job("step", 343_005, ("jump@any collect",), 12.0, noise=ORDINARY, design=FOUR))
    assert first_is_right(document, ("jump@any collect",))


@pytest.mark.slow
def test_what_may_be_the_earths_rate_is_not_called_a_mass_unbalance() -> None:
    """Four collects about one axis, no earth rate recorded: its level part is MUB to these, and no MUA is beside it."""
    effect = reconcile_job(Job("earth", 3_610_000, ("earth@left out",), model="collins-4"))["effects"][0]
    assert (effect["id"], effect["kind"]) == ("earth", "ambiguous")
    assert "MU_real" in {rival["id"] for rival in effect["confusable_with"]}


@pytest.mark.slow
def test_a_sealed_effect_outside_the_catalogue_is_called_empirical() -> None:
    """An unbalance that follows the supply has no name, and gets none."""
    document = reconcile_job(Job("MU × supply", 93_000, ("MU × supply",), 12.0))
    assert document["verdict"] == "empirical"
