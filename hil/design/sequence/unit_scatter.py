"""How a unit's own parameters scatter from run to run, and which of that no repeat averages, by what repeats showed.

    of = scatter_of_unit(campaign)[2]
    of.sizes["MUA"]        # 4.0: one standard deviation beyond standard errors
    of.lasting             # ("BA",): what ages, jumps or differs from visit to visit is the same in neighbouring runs

A mean of repeats is as much surer as they are independent. Runs of a unit that ages follow each other along a line, and
what a temperature's history leaves is the same through a visit: more of them tell no more.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from hil.campaign import Campaign
from hil.solve.between_runs import TIME, WAY
from hil.solve.repeats import repeats
from hil.solve.runs import solve_campaign


@dataclass(frozen=True)
class UnitScatter:
    """One sensor's: `sizes` by parameter, deg/hr and deg/hr/g, the `lasting`, which repeats do not average, and why."""

    sizes: Mapping[str, float]
    lasting: tuple[str, ...]
    said: tuple[str, ...]


def scatter_of_unit(campaign: Campaign) -> dict[int, UnitScatter]:
    """Return what repeats show beyond standard errors of each sensor that has some."""
    out = {}
    for number, shown in repeats(campaign, solve_campaign(campaign)).items():
        ages = [name for name, columns in shown.between.follow.items() if {TIME, WAY} & {*columns}]
        if shown.repeated:
            lasting = dict.fromkeys([*ages, *shown.between.jumps, *shown.of_visits])
            sizes = dict(zip(shown.names, shown.spread.beyond.tolist(), strict=True))
            out[number] = UnitScatter(sizes, tuple(lasting), tuple(shown.between.in_words))
    return out
