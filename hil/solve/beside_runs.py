"""What is known of runs beside their own solutions: by their records, and by what the other runs say of them."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Self

import numpy as np

from hil.campaign import Campaign, Collects, Conditions
from hil.campaign.warnings import NO_EARTH, off_gravity, off_in_words
from hil.solve.omissions import not_settled
from hil.solve.precision import stated_noise, unstated
from hil.solve.residuals import Changes, Squares, changes, unstated_changes
from hil.solve.wrong_rows import WrongRows
from procedures.verdict import Judgement, Verdict
from procedures.words import listed, numbered


@dataclass(frozen=True)
class BesideRuns:
    """What is known of runs beside their solutions: `lacking` have no standard error, `moving` runs had not settled.

    What their runs differ by is in errors, `differ`, or `unstated`, (c,) each at every temperature; `used` are the
    collects, rates (n, c), that numbers are made from.
    """

    judged: Sequence[Mapping[int, Judgement]]
    not_compared: Mapping[int, tuple[str, ...]]
    moving: Set[int]
    lacking: Mapping[int, list[int]]
    differ: Changes
    unstated: Squares
    used: Collects
    campaign: Campaign

    @classmethod
    def of(cls, campaign: Campaign, sensor: int, wrong: WrongRows, used: Collects) -> Self:
        """Gather it from a campaign, from what its rows say of each other, and from those that are `used`."""
        rows = campaign.sensors[sensor]
        here = {run: of for (run, number), of in campaign.contradicted.items() if number == sensor}
        soak = {run: Judgement(Verdict.MARGINAL, of) for run, of in not_settled(campaign)[sensor].items()}
        weight = {} if campaign.centrifuge else _off_gravity(rows.conditions)
        lacks, collect = np.asarray(unstated(rows).any(axis=1)), rows.conditions.collect
        lacking = {run: collect[of[lacks[of]]].tolist() for run, of in rows.conditions.of_each_run.items()}
        left_out = "latitude_deg" in campaign.site and not campaign.rebuilt and not np.any(rows.conditions.w_deg_per_hr)
        earth = dict.fromkeys(rows.conditions.of_each_run if left_out else (), Judgement(Verdict.MARGINAL, NO_EARTH))
        judged = (campaign.verdicts, here, wrong.judged, soak, weight, earth)
        known, none = stated_noise(used) is not None, set[int]()
        settled = set(used.conditions.run.tolist()).difference(soak)
        sound = settled.difference(wrong.judged)
        # What is doubted and used is no standard error's fault; where none is stated it is the noise that there is.
        differ, left = changes(used, sound if known else none), unstated_changes(used, none if known else settled)
        return cls(judged, wrong.not_compared, soak.keys(), lacking, differ, left, used, campaign)

    def assumed(self, runs: Sequence[int], *, compared: bool) -> Iterator[str]:
        """Yield what is assumed of runs: where nothing is there to compare them with, that each is what it says."""
        if there := [self.not_compared[run] for run in runs if run in self.not_compared and not compared]:
            alike = numbered("run", sorted(run for run, of in self.not_compared.items() if of == there[0]))
            yield (
                f"{f'{listed(there[0])} of {alike}' if there[0] else alike} cannot be compared with others (it takes "
                "runs that repeat others, three of them at a temperature, or four temperatures): that each collect is "
                "what it says, where no residual tells otherwise"
            )
        if lacking := [collect for run in runs for collect in self.lacking.get(run, ())]:
            largest = "not all standard errors are stated: the largest of the others stands for the rest"
            yield f"{numbered('collect', lacking)}: {largest}"


def _off_gravity(conditions: Conditions) -> dict[int, Judgement]:
    """Return the runs with a collect in which f is not what a unit at rest feels: nobody knows what is per g there."""
    off, found = off_gravity(conditions), {}
    for run, rows in conditions.of_each_run.items():
        if len(own := rows[off[rows]]):
            which = "" if len(own) == len(rows) else f"{numbered('collect', conditions.collect[own].tolist())}: "
            words = f"{which}{off_in_words(conditions.rows(own))}: f is wrong, and every parameter per g with it"
            found[run] = Judgement(Verdict.INCONCLUSIVE, words)
    return found
