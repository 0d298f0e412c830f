"""How a unit's own parameters scatter from run to run, and which of that no repeat averages, by what repeats showed.

    of = scatter_of_unit(campaign)[2]
    of.sizes["MUA"]        # 4.0: one standard deviation beyond standard errors
    of.lasting             # ("BA",): what ages, or differs from visit to visit, is the same in neighbouring runs

A mean of repeats is as much surer as they are independent. Runs of a unit that ages follow each other along a line, and
what a temperature's history leaves is the same through a visit: more of them tell no more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from hil.campaign import BoolArray, Campaign, FloatArray, IntArray
from hil.solve.repeats import SensorRepeats, repeats
from hil.solve.runs import RunSolution, solve_campaign
from hil.solve.uncertain import RARE


@dataclass(frozen=True)
class UnitScatter:
    """One sensor's: `sizes` by parameter, deg/hr and deg/hr/g, and the `lasting`, which repeats do not average."""

    sizes: Mapping[str, float]
    lasting: tuple[str, ...]


def scatter_of_unit(campaign: Campaign) -> dict[int, UnitScatter]:
    """Return what repeats show beyond standard errors of each sensor that has some."""
    solutions = solve_campaign(campaign)
    return {
        number: UnitScatter(
            dict(zip(shown.names, shown.spread.beyond.tolist(), strict=True)),
            tuple(dict.fromkeys([*_ageing(campaign, number, shown, solutions), *shown.of_visits])),
        )
        for number, shown in repeats(campaign, solutions).items()
        if shown.repeated
    }


def _ageing(campaign: Campaign, number: int, shown: SensorRepeats, solutions: Sequence[RunSolution]) -> list[str]:
    group = {run: k for k, mean in enumerate(shown.means) for run in mean.runs}
    own = [each for each in solutions if each.sensor == number and each.runs[0] in group]
    conditions = campaign.sensors[number].conditions
    when_s = [float(conditions.start_s[conditions.run == each.runs[0]].mean()) for each in own]
    told = [{name: of.value for name, of in shown.of_run(each).items()} for each in own]
    values = np.array([[of.get(name, np.nan) for name in shown.names] for of in told])
    follow = follows_time(values, np.array([group[each.runs[0]] for each in own]), np.array(when_s))
    return [name for name, so in zip(shown.names, follow, strict=True) if so]


def follows_time(values: FloatArray, group: IntArray, when_s: FloatArray) -> BoolArray:
    """Return which of p parameters of r runs (r, p), NaN where not told, follow a line over time, (p,).

    The line is the same at every temperature, which `group` (r,) numbers; by an F test at `RARE` for all together.
    """
    found = []
    for column in values.T:
        known = np.isfinite(column)
        y, t = (_about_means(of[known], group[known]) for of in (column, when_s))
        left, line = float(y @ y), float(y @ t) ** 2 / max(float(t @ t), 1e-300)
        freedom = len(y) - len(np.unique(group[known])) - 1
        odd = freedom > 0 and fdtrc(1, freedom, freedom * line / max(left - line, 1e-300)) * values.shape[1] < RARE
        found.append(bool(odd))
    return np.array(found)


def _about_means(values: FloatArray, group: IntArray) -> FloatArray:
    """Return values (k,) less the mean of each group."""
    at = np.unique(group, return_inverse=True)[1]
    return np.asarray(values - (np.bincount(at, values) / np.bincount(at))[at])
