"""What a search came to, whole: what was asked, what is probable, what it is called, and what held-out rows say."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hil.campaign import Campaign
from hil.model.effects.base import Effect
from hil.reconcile.inside import Wander
from hil.reconcile.naming import Named, Reading
from hil.reconcile.outcome.findings import gap_of
from hil.reconcile.outcome.mistakes import certain, mended, outliers_found, rows_found
from hil.reconcile.outcome.ordinary import ordinary
from hil.reconcile.outcome.scatter import FoundScatter, found_scatter, likeliest_with, pooled
from hil.reconcile.outcome.stated import beside, not_repeated, wanders
from hil.reconcile.outcome.values import taken_out
from hil.reconcile.proof.held_out import HeldOut
from hil.reconcile.result import Gap, Solved
from hil.reconcile.rivals import CERTAIN
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.fitted import Fitted, Values, fitted
from hil.reconcile.search.posterior import Posterior
from hil.reconcile.search.problem import Problem, SensorProblem
from procedures.words import listed, percent

ORDINARY = "ordinary"  # white noise and an offset from run to run: what is called no effect


@dataclass(frozen=True)
class Answer:
    """What is asked of a campaign, what is probable, how it reads, its proof, and the names that the proof took back.

    `alpha` is the rate of false alarms of the whole search; `prove`, whether rows were to be held out; `inside`, what
    the series show.
    """

    campaign: Campaign
    problem: Problem
    posterior: Posterior
    reading: Reading
    proof: HeldOut | None
    reverted: Sequence[Named]
    alpha: float
    prove: bool
    inside: Sequence[Mapping[str, Any]]

    @cached_property
    def fit(self) -> Fitted:
        """All that was found, fitted."""
        return fitted(self.posterior, self.reading.found)

    @cached_property
    def before(self) -> Fitted:
        """What is without anything that was found, fitted."""
        return fitted(self.posterior, self.reading.nothing)

    @property
    def names(self) -> Sequence[Named]:
        """The names, as sure as what was not recorded leaves them."""
        return self.reading.names

    @cached_property
    def terms(self) -> Sequence[tuple[Candidate, Values]]:
        """What the names are in each sensor, with their values."""
        places = [(n, j) for named in self.names for n, js in named.terms.items() for j in js]
        return [(self.posterior.term(n, j).candidate, self.fit.of_term(n, j, alone=True)) for n, j in places]

    @property
    def alike(self) -> Mapping[str, Sequence[Effect]]:
        """What follows temperature, or lasts, and looks the same in these collects as what was found, by its id."""
        term, out = self.posterior.term, dict[str, Sequence[Effect]]()
        for named in self.names:
            same = [term(n, j) for of in named.rivals if of.alike for n, j in of.terms.items()]
            effects = [(of.follows, each) for of in same if (each := of.candidate.effect) is not None]
            followed = [effect for follows, effect in effects if follows == "temperature" or effect.lasts]
            out |= {e.id: followed for n, js in named.terms.items() for j in js if (e := term(n, j).candidate.effect)}
        return out

    @cached_property
    def scatter(self) -> Sequence[FoundScatter]:
        """What the effect on the scatter is, if one was found, channel by channel."""
        return [each for n in self.names if n.acts_on == "scatter" for each in found_scatter(self.posterior, n.name)]

    @cached_property
    def scatters_by(self) -> Mapping[str, tuple[str, float]]:
        """What may scatter averages, by id: title and probability, most probable first; none where nothing can."""
        posterior = self.posterior
        titles = {name: effect.title for name, effect in posterior.scatter.items()}
        likely = {name: posterior.likely.get(name, 0.0) for name in titles}
        likely[ORDINARY] = float(1.0 - sum(np.exp(f.log_weight) for f in posterior.sets if f.scatter))
        likely |= {each.name: each.probability for each in self.names if each.name in likely}
        ranked = sorted(likely.items(), key=lambda pair: -pair[1])
        white, told = "white noise", [each["run_offset_se_deg_per_hr"] is not None for each in self.noise]
        if any(told) or any(each["run_offset_deg_per_hr"] for each in self.noise):
            white += f" and{', as may be by chance,' * (not any(told))} an offset of each run"
        return {name: (titles.get(name, white), share) for name, share in ranked} if titles else {}

    @property
    def untold(self) -> str:
        """Say between what these runs cannot tell; empty where a name is settled, or that there is none."""
        if once := not_repeated(self.noise, self.left.shown, self.problem.model):
            return (
                f"these collects cannot tell whether {once} changed from run to run or followed temperature: repeat one"
            )
        names = [each for each in self.names if each.acts_on == "scatter"]
        ordinary = self.scatters_by.get(ORDINARY, ("", 1.0))[1]
        if any(each.kind == "named" for each in names) or ordinary >= CERTAIN:
            return ""
        rivals = {each.name for each in names} | {rival.id for each in names for rival in each.rivals}
        told = [
            f"{title} ({percent(share)})"
            for name, (title, share) in self.scatters_by.items()
            if share >= 1.0 - CERTAIN or name in rivals
        ]
        return f"these repeats cannot tell what scatters: {'; '.join(told)}"

    @cached_property
    def solved(self) -> Solved:
        """What `hil solve` says of the campaign."""
        return Solved.of(self.campaign)

    @cached_property
    def taken_off(self) -> Campaign:
        """The campaign with what is known, and what was found, taken off."""
        sure = mended(self.problem.sensors, certain(self.reading.mistakes, self.fit, self.campaign))
        return taken_out(self.problem, sure, self.terms, pooled(self.scatter))

    @cached_property
    def left(self) -> Solved:
        """What it would say of that."""
        model, wrong = self.problem.model, self.reading.mistakes
        off = ["what the model knows"] * bool(model.terms or model.noise)
        off += ["what was found"] * bool(self.names or wrong)
        return Solved.of(self.taken_off, f"with {listed(off)} taken off, ", self.solved) if off else self.solved

    @cached_property
    def noise(self) -> Sequence[dict[str, Any]]:
        """What every channel's averages scatter by beside what moves them, found or probable: key `noise`."""
        model, beside = self.problem.model, self.fit
        if not self.reverted and (likely := likeliest_with(self.posterior, beside.found)) != beside.found:
            beside = fitted(self.posterior, likely)
        added = [n.name for n in self.names if n.acts_on == "mean"]
        added += sorted(self.posterior.names(beside.found) - self.posterior.names(self.fit.found))
        forms = {number: sensor.form.name for number, sensor in self.problem.sensors.items()}
        about = {n: [model.title if name == model.form else name, *added] for n, name in forms.items()}
        return ordinary(beside, self.scatter, about, self.left.shown)

    @cached_property
    def wanders(self) -> Mapping[int, Wander]:
        """How noise is coloured inside the collects, by sensor."""
        return wanders(self.problem.model, self.problem.campaign, self.noise, self.inside)

    @cached_property
    def beyond_flicker(self) -> Sequence[dict[str, Any]]:
        """What averages scatter by beyond that, as `noise`."""
        return beside(self.noise, self.wanders)

    @cached_property
    def outliers(self) -> Sequence[dict[str, Any]]:
        """Single rates that are wrong."""
        return outliers_found(self.fit, self.campaign)

    @cached_property
    def rows(self) -> Sequence[dict[str, Any]]:
        """What is wrong with the rows: key `rows`."""
        return rows_found(self.reading.mistakes, self.fit, self.campaign, self.outliers)

    @cached_property
    def sensors(self) -> Mapping[int, SensorProblem]:
        """The sensors with what is wrong in their rows put right."""
        return mended(self.problem.sensors, self.reading.mistakes)

    @cached_property
    def calibrated(self) -> frozenset[int]:
        """The sensors whose values are calibrated at each temperature."""
        return frozenset(block.search.block.sensor for block in self.fit.blocks if block.calibrated)

    @cached_property
    def gap(self) -> Gap:
        """The gap before and after."""
        return gap_of(self.proof, self.fit, self.before, self.reading.chance)
