"""What makes repeats scatter, and which rows are wrong: a view of the posterior that `hil reconcile` reads.

    found = what_scatters(read_campaign("night"))
    found.named               # ("MU_rr",), or none where these repeats cannot tell
    found.document()          # what `hil scatter --json` prints

It is asked about the form of model that fits the sensor; what moves the mean, what scatters and mistakes in the data
compete there, so that nothing is called scatter which something else explains.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from hil.campaign import Campaign
from hil.campaign.plausibility import usable
from hil.campaign.stand_ins import with_stand_ins
from hil.files.document import picked
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS
from hil.model.effects.document import shape_in_words
from hil.model.effects.prior import ALPHA
from hil.model.forms import default_form
from hil.reconcile.follows import repeated
from hil.reconcile.outcome import scatter
from hil.reconcile.outcome.answer import ORDINARY, Answer
from hil.reconcile.outcome.findings import id_of
from hil.reconcile.outcome.stated import beyond_chance, flicker_in_words, lacking, scatter_in_words
from hil.reconcile.rivals import CERTAIN
from hil.reconcile.workflow import searched
from hil.solve.both_sensors import BothSensors, common_and_differential
from hil.solve.omissions import in_words, otherwise, without
from hil.solve.repeats import OF_MEANS
from hil.solve.wrong_rows import pooled
from procedures.words import listed, percent, unit_in_words


@dataclass(frozen=True)
class Scattering:
    """What the search came to, read for what scatters."""

    answer: Answer
    both: BothSensors | None
    to_record: Sequence[str]
    otherwise: Sequence[str]

    @property
    def named(self) -> tuple[str, ...]:
        """The effects, by id, that scatter."""
        return tuple(n.name for n in self.answer.names if n.acts_on == "scatter" and n.kind == "named")

    @property
    def moves(self) -> tuple[str, ...]:
        """What moves the mean beside it, by id."""
        return tuple(id_of(n, self.answer.fit) for n in self.answer.reading.names if n.acts_on == "mean")

    @cached_property
    def sizes(self) -> tuple[scatter.FoundScatter, ...]:
        """How large what scatters is, by effect and sensor."""
        return tuple(scatter.pooled(self.answer.scatter))

    def sentences(self) -> list[str]:
        """Say what scatters, by how much, and what is wrong with the rows."""
        found, noise = self.answer, self.answer.noise
        likely = {name: f"{title} ({percent(share)})" for name, (title, share) in found.scatters_by.items()}
        if self.named:
            values = [
                f"{', '.join(filter(None, [s.effect.title, shape_in_words(s.shape), f'sensor {s.sensor}', *s.some]))}: "
                f"{s.value:.3g} {unit_in_words(s.parameter.unit)} "
                f"({s.interval['low']:.2g} … {s.interval['high']:.2g}), by all runs and channels and what is typical"
                for s in self.sizes
            ]
            about = ", ".join(dict.fromkeys(n["under"] for n in noise))
            told = [f"{listed([likely[name] for name in self.named])}, about {about}: {'; '.join(values)}"]
        elif likely:
            beyond = any([*beyond_chance(channel)] for channel in noise)
            more = beyond or scatter_in_words(noise) or self.answer.left.small
            nothing = "what scatters has no name" if more else "nothing certainly scatters"
            nothing = nothing if next(iter(likely)) == ORDINARY else "what scatters is not certain"
            told = [found.untold or f"{nothing}: {next(iter(likely.values()))}"]
        else:
            told = ["too few repeats to tell anything"]
        shown = found.left.shown  # what single runs leave is asked only where nothing in a run tells its noise
        left = {
            of["sensor"]
            for of in noise
            if of["observed_deg_per_hr"] is not None
            and (of["run_offset_deg_per_hr"] or not ((n := of["sensor"]) in shown and shown[n].noise_told))
        }
        single = "no run was repeated: what changes from run to run is not known"
        alone = [
            f"sensor {number}: {OF_MEANS if found.campaign.rebuilt else single}"
            + "; what is observed is what a smooth model leaves of single runs" * (number in left)
            for number, collects in found.campaign.sensors.items()
            if not repeated([collects.conditions])
        ]
        instead = [
            f"{rival.title} ({percent(rival.probability)})"
            for each in found.names
            for rival in each.rivals
            if each.acts_on == "scatter" and (rival.terms or rival.remedy) and rival.probability > 1.0 - CERTAIN
        ]
        if instead:
            scatters = listed([likely[n.name] for n in found.names if n.acts_on == "scatter"])
            either = f"either something moves the mean, {listed(instead)}, or averages scatter, {scatters}"
            told = [f"{either}: these collects cannot tell, and sizes are of what scatters"]
        return [
            *alone,
            *told,
            *([f"it may follow {listed(self.to_record)}, which nobody recorded"] if self.to_record else []),
            *([] if self.both is None else self.both.sentences()),
            *flicker_in_words(self.answer.wanders),
            *self.answer.left.errors,
            *scatter_in_words(noise),
            *([f"beside it something moves the mean: {listed(self.moves)}; see hil reconcile"] if self.moves else []),
            *in_words({"rows": found.rows, **without(found.campaign)}, searched=True),
            *self.otherwise,
        ]

    def document(self) -> dict[str, Any]:
        """Return what `hil scatter --json` prints."""
        noise = self.answer.noise
        return {
            "schema": "hil.scatter/2",
            **picked(self.answer.campaign, "title simulated warnings"),
            "named_from": CERTAIN,
            "named": list(self.named),
            "causes": [
                {"id": name, "title": title, "probability": probability}
                for name, (title, probability) in self.answer.scatters_by.items()
            ],
            "sizes": [
                {"id": s.effect.id, "sensor": s.sensor, "value": s.value, "se": s.se, **s.interval}
                | {"unit": s.parameter.unit, "under": next(n["under"] for n in noise if n["sensor"] == s.sensor)}
                for s in self.sizes
            ],
            "noise": noise,
            "rows": self.answer.rows,
            "to_record": self.to_record,
            "both_sensors": None if self.both is None else self.both.document(),
            **without(self.answer.campaign),
            "sentences": self.sentences(),
        }


def what_scatters(campaign: Campaign) -> Scattering:
    """Weigh what may scatter in a campaign; raises `InputError` where no form fits a sensor."""
    asked = with_stand_ins(pooled(campaign))
    model = load_model(default_form(next(iter(usable(asked).sensors.values())).conditions).name)
    answer = searched(asked, model, (*BASE_EFFECTS, *EFFECTS), VARIANCE_EFFECTS, ALPHA)
    to_record = lacking(campaign, answer.scatter, answer.noise)
    doubted = otherwise(campaign, answer.rows, answer.taken_off)
    return Scattering(answer, common_and_differential(campaign), to_record, doubted)
