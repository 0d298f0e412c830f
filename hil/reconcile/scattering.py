"""What makes repeats scatter, and which rows are wrong: the search's posterior with nothing unknown on the mean.

    found = what_scatters(read_campaign("night"))
    found.named               # ("MU_rr",), or none where these repeats cannot tell
    found.document()          # what `hil scatter --json` prints

The base has values of its own at each temperature, so that what follows temperature is no scatter; what scatters, and
mistakes in the data, compete under the priors that `hil reconcile` has, and in its words. Whether something moves the
mean is not asked: `hil reconcile` asks that, and its answer is the fuller one.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil.campaign import Campaign, Conditions
from hil.campaign.plausibility import usable
from hil.model import load_model
from hil.model.effects.catalogue import EFFECTS, VARIANCE_EFFECTS
from hil.model.forms import default_form
from hil.reconcile.naming import CERTAIN, Reading, read, scatter_of
from hil.reconcile.outcome import mistakes, scatter
from hil.reconcile.search.fitted import Fitted, fitted
from hil.reconcile.search.layout import searches
from hil.reconcile.search.posterior import Posterior, weigh
from hil.reconcile.search.problem import pose
from hil.reconcile.unrecorded import with_stand_ins
from hil.solve.temperatures import runs_by_temperature
from hil.solve.wrong_rows import in_words, otherwise, pooled, without
from procedures.words import unit_in_words

ORDINARY = "ordinary"
"""White noise and an offset from run to run: what is called no effect."""


@dataclass(frozen=True)
class Scattering:
    """Probabilities of what scatters, by id; sizes of what is named; noise by channel; what is wrong with rows."""

    campaign: Campaign
    probabilities: dict[str, float]
    titles: dict[str, str]
    sizes: tuple[scatter.FoundScatter, ...]
    noise: list[dict[str, Any]]
    rows: list[dict[str, Any]]

    @property
    def named(self) -> tuple[str, ...]:
        """What is named: the cause that is as probable as any name has to be; none where these repeats cannot tell."""
        likely = [name for name, probability in self.probabilities.items() if probability >= CERTAIN]
        return tuple(name for name in likely if name != ORDINARY)

    def sentences(self) -> list[str]:
        """Say what scatters, by how much, and what is wrong with the rows."""
        ranked = [f"{self.titles[n]} ({p:.2f})" for n, p in self.probabilities.items() if p >= 1.0 - CERTAIN]
        if self.named:
            values = [
                f"sensor {s.sensor}: {s.value:.3g} ± {s.se:.2g} {unit_in_words(s.parameter.unit)}" for s in self.sizes
            ]
            first = f"{self.titles[self.named[0]]} (probability {self.probabilities[self.named[0]]:.2f}), "
            first += f"about {', '.join(dict.fromkeys(n['under'] for n in self.noise))}: "
            told = [first + "; ".join(values)]
        elif self.probabilities.get(ORDINARY, 0.0) >= CERTAIN:
            told = [f"nothing but ordinary noise: {ranked[0]}"]
        else:
            told = [f"these repeats cannot tell: {'; '.join(ranked)}" if ranked else "too few repeats to tell anything"]
        alone = [
            f"sensor {number}: nothing was repeated: what is observed is what a smooth model leaves of single runs"
            for number, collects in self.campaign.sensors.items()
            if not _repeated(collects.conditions)
        ]
        asked = (
            "what moves the mean is not asked here: hil reconcile may explain some of this, and rows that are left out"
        )
        rows = [*in_words({"rows": self.rows, **without(self.campaign)}), *otherwise(self.campaign, self.rows)]
        return [*alone, *told, *scatter.in_words(self.noise), *rows, asked]

    def document(self) -> dict[str, Any]:
        """Return what `hil scatter --json` prints."""
        return {
            "schema": "hil.scatter/2",
            "title": self.campaign.title,
            "simulated": self.campaign.simulated,
            "warnings": list(self.campaign.warnings),
            "named_from": CERTAIN,
            "named": list(self.named),
            "causes": [
                {"id": name, "title": self.titles[name], "probability": probability}
                for name, probability in self.probabilities.items()
            ],
            "sizes": [
                {"id": s.effect.id, "sensor": s.sensor, "value": s.value, "se": s.se, **s.interval}
                | {"unit": s.parameter.unit, "under": next(n["under"] for n in self.noise if n["sensor"] == s.sensor)}
                for s in self.sizes
            ],
            "noise": self.noise,
            "rows": self.rows,
            **without(self.campaign),
            "sentences": self.sentences(),
        }


def what_scatters(campaign: Campaign) -> Scattering:
    """Weigh what may scatter in a campaign; raises `InputError` where no form fits a sensor."""
    campaign = pooled(campaign)
    chosen = usable(with_stand_ins(campaign))
    form = default_form(next(iter(chosen.sensors.values())).conditions).name
    problem = replace(pose(chosen, load_model(form), ()), candidates=())
    posterior = weigh(searches(problem, EFFECTS, VARIANCE_EFFECTS, calibrated=True))
    reading = read(posterior, 1.0 - CERTAIN)
    fit = fitted(posterior, reading.found)
    titles = {
        ORDINARY: "white noise, and an offset of each run",
        **{n: e.title for n, e in scatter_of(posterior).items()},
    }
    weights = {name: float(sum(np.exp(f.log_weight) for f in posterior.sets if f.kind == name)) for name in titles}
    weights[ORDINARY] = 1.0 - sum(weights.values()) if len(titles) > 1 else 0.0
    told = len(titles) > 1 and any(_repeated(rows.conditions) for rows in campaign.sensors.values())
    ranked = dict(sorted(weights.items(), key=lambda pair: -pair[1])) if told else {}
    return _read(campaign, posterior, reading, fit, ranked, titles, form)


def _repeated(conditions: Conditions) -> bool:
    return any(len(runs) > 1 for _, runs in runs_by_temperature(conditions))


def _read(
    campaign: Campaign,
    posterior: Posterior,
    reading: Reading,
    fit: Fitted,
    ranked: dict[str, float],
    titles: dict[str, str],
    model: str,
) -> Scattering:
    conditions = {number: rows.conditions for number, rows in campaign.sensors.items()}
    kind = reading.found.kind if ranked else ""
    found = scatter.found_scatter(posterior, reading.found.terms, fit, kind, conditions) if kind else []
    rows = mistakes.rows_found(reading, campaign, mistakes.outliers_found(reading, campaign, fit, posterior))
    noise = scatter.ordinary(posterior, reading.found.terms, fit, conditions, found, [model])
    return Scattering(campaign, ranked, titles, tuple(scatter.pooled(found)), noise, rows)
