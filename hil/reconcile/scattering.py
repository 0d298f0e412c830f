"""What makes repeats scatter, and which rows are wrong: a view of the posterior that `hil reconcile` reads.

    found = what_scatters(read_campaign("night"))
    found.named               # ("MU_rr",), or none where these repeats cannot tell
    found.document()          # what `hil scatter --json` prints

It is asked about the form of model that fits the sensor; what moves the mean, what scatters and mistakes in the data
compete there, so that nothing is called scatter which something else explains.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.campaign import Campaign
from hil.campaign.plausibility import usable
from hil.campaign.stand_ins import with_stand_ins
from hil.files.document import picked
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS
from hil.model.effects.prior import ALPHA
from hil.model.forms import default_form
from hil.reconcile.naming import CERTAIN
from hil.reconcile.outcome import scatter
from hil.reconcile.outcome.sentences import scatter_in_words
from hil.reconcile.result import Solved
from hil.reconcile.workflow import searched
from hil.solve.both_sensors import BothSensors, common_and_differential
from hil.solve.omissions import in_words, otherwise, without
from hil.solve.temperatures import runs_by_temperature
from hil.solve.wrong_rows import pooled
from procedures.words import listed, percent, unit_in_words

ORDINARY = "ordinary"
"""White noise and an offset from run to run: what is called no effect."""


@dataclass(frozen=True)
class Scattering:
    """Probabilities of what scatters, by id; what is `named` of it, what `moves` the mean, and what may `instead`.

    `errors` is what repeats and residuals say of standard errors.
    """

    campaign: Campaign
    probabilities: dict[str, float]
    titles: dict[str, str]
    named: tuple[str, ...]
    moves: tuple[str, ...]
    instead: tuple[str, ...]
    sizes: tuple[scatter.FoundScatter, ...]
    noise: Sequence[dict[str, Any]]
    rows: Sequence[dict[str, Any]]
    both: BothSensors | None
    errors: Sequence[str]

    def sentences(self) -> list[str]:
        """Say what scatters, by how much, and what is wrong with the rows."""
        taken = {size.effect.id for size in self.sizes}  # `hil reconcile` reads the most probable set, which has them
        likely = {n: p for n, p in self.probabilities.items() if p >= 1.0 - CERTAIN or n in taken}
        ranked = [f"{self.titles[name]} ({percent(probability)})" for name, probability in likely.items()]
        if self.named:
            values = [
                f"{self.titles[s.effect.id]}, sensor {s.sensor}: {s.value:.3g} {unit_in_words(s.parameter.unit)} "
                f"({s.interval['low']:.2g} … {s.interval['high']:.2g}), by all runs and what is typical"
                for s in self.sizes
            ]
            first = listed([f"{self.titles[name]} ({percent(self.probabilities[name])})" for name in self.named])
            first += f", about {', '.join(dict.fromkeys(n['under'] for n in self.noise))}: "
            told = [first + "; ".join(values)]
        elif self.probabilities.get(ORDINARY, 0.0) >= CERTAIN:
            more = scatter_in_words(self.noise) or self.errors
            told = [f"{'what scatters has no name' if more else 'nothing certainly scatters'}: {ranked[0]}"]
        else:
            told = [f"these repeats cannot tell: {'; '.join(ranked)}" if ranked else "too few repeats to tell anything"]
        left = {of["sensor"] for of in self.noise if of["observed_deg_per_hr"] is not None}
        alone = [
            f"sensor {number}: nothing was repeated: what changes from run to run is not known"
            + "; what is observed is what a smooth model leaves of single runs" * (number in left)
            for number, collects in self.campaign.sensors.items()
            if not any(len(runs) > 1 for _, runs in runs_by_temperature(collects.conditions))
        ]
        told += [f"or it is no scatter, and moves the mean: {listed(self.instead)}"] if self.instead else []
        beside = [f"beside it something moves the mean: {listed(self.moves)}; see hil reconcile"] if self.moves else []
        rows = [
            *in_words({"rows": self.rows, **without(self.campaign)}, searched=True),
            *otherwise(self.campaign, self.rows),
        ]
        both = [] if self.both is None else self.both.sentences()
        return [
            *alone,
            *told,
            *both,
            *(() if self.named else self.errors),
            *scatter_in_words(self.noise),
            *beside,
            *rows,
        ]

    def document(self) -> dict[str, Any]:
        """Return what `hil scatter --json` prints."""
        return {
            "schema": "hil.scatter/2",
            **picked(self.campaign, "title simulated warnings"),
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
            "both_sensors": None if self.both is None else self.both.document(),
            **without(self.campaign),
            "sentences": self.sentences(),
        }


def what_scatters(campaign: Campaign) -> Scattering:
    """Weigh what may scatter in a campaign; raises `InputError` where no form fits a sensor."""
    both, errors = common_and_differential(campaign), Solved.of(campaign).errors
    campaign = with_stand_ins(pooled(campaign))
    model = load_model(default_form(next(iter(usable(campaign).sensors.values())).conditions).name)
    answer = searched(campaign, model, (*BASE_EFFECTS, *EFFECTS), VARIANCE_EFFECTS, ALPHA)
    posterior, names = answer.posterior, answer.reading.names
    titles = {ORDINARY: "white noise, and an offset of each run"}
    titles |= {name: effect.title for name, effect in posterior.scatter.items()}
    weights = {name: float(sum(np.exp(f.log_weight) for f in posterior.sets if name in f.scatter)) for name in titles}
    weights[ORDINARY] = float(1.0 - sum(np.exp(f.log_weight) for f in posterior.sets if f.scatter))
    ranked = dict(sorted(weights.items(), key=lambda pair: -pair[1])) if posterior.scatter else {}
    moves = tuple(each.name for each in names if each.acts_on == "mean")
    named = tuple(each.name for each in names if each.acts_on == "scatter" and each.kind == "named")
    rivals = [rival for each in names if each.acts_on == "scatter" for rival in each.rivals if rival.terms]
    instead = tuple(
        f"{rival.title} ({percent(rival.probability)})" for rival in rivals if rival.probability > 1.0 - CERTAIN
    )
    sizes = tuple(scatter.pooled(answer.scatter))
    return Scattering(campaign, ranked, titles, named, moves, instead, sizes, answer.noise, answer.rows, both, errors)
