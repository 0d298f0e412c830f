"""Effects of time and chance on averages: drift, ageing, jumps; and those that only scatter them."""

from collections.abc import Hashable, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.base import Base, Effect, Parameter, ShapeParameter, VarianceEffect
from hil.model.effects.columns import HOUR_S, LEVEL, begun_min, channel_labels, column, middle_hr, per_channel
from hil.model.effects.history import collect_interval_s, place_in_run
from hil.model.effects.scatter import Scatter, averaged_s, white
from hil.model.forms import mu_columns

_FEW_RUNS = 4  # beside so many others, a run that stands alone is not told from the others' scatter
_FEWEST_CYCLES = 3
_EITHER_SIDE = 2  # runs
_MANY_RUNS = 8  # of which MU of one may be another, and not that of all
_FELT_G = 0.1  # along the spin axis: what is less says next to nothing of MU
_WITH_TEMPERATURE = MappingProxyType({"bias_T": 1.0})
_WHITE_TYPICAL = {"RLG": (0.001, 0.1), "FOG": (0.002, 0.1), "DTG": (0.01, 0.1), "MEMS": (0.05, 0.5)}
_WANDERING_TYPICAL = {"RLG": (0.001, 0.02), "FOG": (0.01, 1.5), "DTG": (0.02, 0.5), "MEMS": (0.5, 15.0)}
_TURN_ON_TYPICAL = {"RLG": (0.001, 0.005), "FOG": (0.1, 1.0), "DTG": (0.05, 1.0), "MEMS": (5.0, 50.0)}


class Drift(Effect):
    """Each collect is a little further than the one before, anew in every run.

    What goes on through all runs goes on while nothing is collected too: that is `ageing`.
    """

    id = "drift"
    follows = "time"
    title = "Linear drift between collects"
    equation = "R += d k, k = how many collects after the middle of the run: -1, 0, 1 of three"
    per_channel = True
    parameters = (Parameter("d", "deg/hr/collect", (0.1, 5.0)),)
    signature = "Depends on the order of positions: 1-2-3 gives bias -d/2, MU 3d/2; sigmas 1 : 0.5 : 1.5."
    confusable_with = ("MU_real", "GS", "warmup", "bias_Tdot", "settle")
    incidental = True
    experiment = "Order 1-3-2 moves it all into GS; the palindrome 1-3-2-2-3-1 cancels it."

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return the time from collect to collect, and the middle of a run; none where no run has two collects."""
        interval = collect_interval_s(conditions)
        middle = 0.5 * (float(np.median(np.unique(conditions.run, return_counts=True)[1])) - 1.0)
        return (
            ShapeParameter("interval_s", "s", (interval,) if interval > 0.0 else ()),
            ShapeParameter("middle", "collects", (middle,)),
        )

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        place = place_in_run(conditions, shape["interval_s"]) - shape["middle"]
        return per_channel(place, conditions.sensor)


class Ageing(Effect):
    """Bias that grows in proportion to time over the whole campaign."""

    id = "ageing"
    follows = "time"
    title = "Ageing of the bias"
    equation = "B += a t, t from the record's first collect on"
    per_channel = True
    parameters = (Parameter("a", "deg/hr/day", (0.3, 10.0), {"RLG": (0.001, 0.01), "MEMS": (1.0, 100.0)}),)
    signature = "A straight line against time, blind to temperature, position and order."
    confusable_with = ("rrw", "jump", "bias_T", "warmup", "supply")
    lasts = True
    odds = 1.0 / 1.5  # the published list of effects lacks it: it leads where nothing of that explains as much
    kin = _WITH_TEMPERATURE
    experiment = "A second night; in each, return to the first temperature at the end."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return per_channel(middle_hr(conditions) / 24.0, conditions.sensor)


class _Steps(Effect):
    """Something that steps and stays, or comes back after one run.

    A step within a run lies between two of its collects, wherever between them it really was.
    """

    follows = "time"
    lasts = True

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return the run from which the step holds, for how many runs (0: to the end), after how many collects."""
        runs = tuple(float(run) for run in np.unique(conditions.run))
        held = (0.0, 1.0) if len(runs) > _FEW_RUNS + 1 else (0.0,)
        places = int(_place_among_collects(conditions).max(initial=0)) + 1
        return (
            ShapeParameter("from_run", "", runs),
            ShapeParameter("runs_held", "runs", held),
            ShapeParameter("from_collect", "collects", tuple(float(k) for k in range(places)), default=0.0),
        )

    def shape_grid(self, conditions: Conditions) -> Sequence[Mapping[str, float]]:
        """Return every place of a step but the beginning; at either end of many runs it is one that is another."""
        grid, runs = super().shape_grid(conditions), np.unique(conditions.run)
        none = {*runs[:1], *((runs[1], runs[-1]) if any(shape["runs_held"] for shape in grid) else ())}
        return [
            s
            for s in grid
            if not (s["from_collect"] if s["runs_held"] else s["from_run"] in none and not s["from_collect"])
        ]

    def happens(self, conditions: Conditions, shape: Mapping[str, float]) -> Hashable:
        """Return whether one run alone is another, or a step stays."""
        return "one run" if shape["runs_held"] else "stays"

    def begins_within(self, shape: Mapping[str, float]) -> Sequence[int]:
        """Return the run in which a step lies between two collects."""
        return [int(shape["from_run"])] if shape.get("from_collect") else []

    def holds(self, conditions: Conditions, shape: Mapping[str, float]) -> FloatArray:
        """Return 1 in every row after the step, 0 elsewhere, (n,)."""
        within = conditions.run == shape["from_run"]
        if shape.get("runs_held"):
            return np.asarray(within, dtype=np.float64)
        began = within & (_place_among_collects(conditions) >= shape.get("from_collect", 0.0))
        return np.asarray(began | (conditions.run > shape["from_run"]), dtype=np.float64)


class Jump(_Steps):
    """Bias that steps and stays, or comes back after one run: a bearing or retainer that seats itself elsewhere."""

    id = "jump"
    title = "Bearing or retainer jump"
    equation = "B += J from run r on, or in run r alone"
    per_channel = True
    parameters = (Parameter("J", "deg/hr", (5.0, 15.0), {"DTG": (0.1, 1.0), "MEMS": (1.0, 50.0)}),)
    signature = "A step between two runs, at no particular temperature; two states if it comes back."
    confusable_with = ("ageing", "rrw", "swap", "hyst", "MU_rr")
    kin = _WITH_TEMPERATURE
    experiment = "Changepoint inside the collects; many repeats at one temperature."

    def kin_for(self, conditions: Conditions, shape: Mapping[str, float]) -> Mapping[str, float]:
        """Return its kin; of a first run that is another than all after it, with what only that may show much of.

        And of a run alone with its turn-on, unless power was on in others of the same cycle.
        """
        of_a_first_run = {"warmup": 1.0, "soak_insufficient": 1.0}
        cycle, held = _power_cycle_or_run(conditions), shape.get("runs_held")
        own = conditions.run == shape.get("from_run")
        turned_on = held and not np.isin(cycle[own], cycle[~own]).any()
        kin = {**self.kin, "turnon": 1.0} if turned_on else self.kin  # one state, or scatter
        begun = np.unique(conditions.run)[:1] if held else np.unique(conditions.run)[1:2]
        return {**kin, **of_a_first_run} if not shape.get("from_collect") and shape.get("from_run") in begun else kin

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return per_channel(self.holds(conditions, shape), conditions.sensor)


class AxialDriftJump(_Steps):
    """MU that steps and stays, or comes back after one run: balls that roll on another track."""

    id = "MU_jump"
    title = "MU jump"
    equation = "MU += J from run r on, or in run r alone"
    rotor_only = True
    parameters = tuple(Parameter(name, "deg/hr/g", (5.0, 15.0), {"DTG": (0.1, 1.0)}) for name in ("JMUA", "JMUB"))
    signature = "MU steps between two runs, at no particular temperature, and the bias does not."
    confusable_with = ("jump", "MU_rr", "MU_T")
    kin = MappingProxyType({"MU_T": 1.0})
    odds = 0.5  # the reference has one entry for both; that of the bias is the usual one
    experiment = "Collect 3 beside another position, many times at one temperature."

    def shape_grid(self, conditions: Conditions) -> Sequence[Mapping[str, float]]:
        """Return every step between runs, of which two at least on either side feel MU; and each that is alone of many.

        Of few of which one is another nobody can tell a step from MU that differs from run to run.
        """
        felt = np.unique(conditions.run[np.any(np.abs(mu_columns(conditions)) > _FELT_G, axis=(1, 2))])

        def fewer(shape: Mapping[str, float]) -> int:
            after = np.searchsorted(felt, shape["from_run"], side="right" if shape["from_collect"] else "left")
            return int(min(np.searchsorted(felt, shape["from_run"]), len(felt) - after))

        told = [
            each
            for each in super().shape_grid(conditions)
            if (len(felt) > _MANY_RUNS if each["runs_held"] else fewer(each) >= _EITHER_SIDE)
        ]
        return sorted(told, key=lambda shape: shape["from_collect"] > 0.0)  # of what is the same, whole runs come first

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return np.asarray(mu_columns(conditions) * self.holds(conditions, shape)[:, None, None])


@lru_cache(maxsize=8)
def _place_among_collects(conditions: Conditions) -> FloatArray:
    """How many collects of its own run came before each row, (n,)."""
    order = np.lexsort((conditions.collect, conditions.run))
    of_run = np.diff(conditions.run[order], prepend=-np.inf) != 0.0
    another = of_run | (np.diff(conditions.collect[order], prepend=-np.inf) != 0.0)
    count = np.cumsum(another)
    place = np.zeros(len(conditions))
    place[order] = count - np.maximum.accumulate(np.where(of_run, count, 0))
    return place


class AngleRandomWalk(VarianceEffect):
    """White noise of the rate: averages scatter with one over the root of the averaging time."""

    id = "arw"
    follows = "duration_s"
    title = "Angle random walk"
    equation = "sigma = N / sqrt(duration)"
    parameters = (Parameter("N", "deg/sqrt(hr)", (0.1, 0.2), _WHITE_TYPICAL),)
    signature = "Sigmas of a bias solved without MU, one beside it, and MU as 1 : 0.707 : 1.225; nothing correlates."
    confusable_with = ("hash", "beat", "base")
    experiment = "Longer collects: the scatter falls with the root of the time."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """Return one over the root of the duration, in hr, of each row; rows of no duration count as one second."""
        return white(np.sqrt(HOUR_S / averaged_s(conditions)), conditions)


class Quantisation(VarianceEffect):
    """Angle increments are rounded."""

    id = "quant"
    follows = "duration_s"
    title = "Quantisation"
    equation = "sigma = Q / duration"
    parameters = (Parameter("Q", "arcsec", (0.1, 1.0), {"RLG": (0.1, 2.0), "MEMS": (0.1, 50.0)}),)
    signature = "Values on a lattice; averages hardly move: 0.003 deg/hr."
    confusable_with = ("arw",)
    experiment = "Look at the last digits of the samples."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """Return one over the duration (arcsec/s is deg/hr) of each row; rows of no duration count as one second."""
        return white(1.0 / averaged_s(conditions), conditions, of_angle=True)


class BiasInstability(VarianceEffect):
    """Flicker noise: slow wander that averaging does not remove."""

    id = "flicker"
    follows = "time"
    title = "Bias instability"
    equation = "Allan deviation floor 0.664 B_f"
    parameters = (
        Parameter("B_f", "deg/hr", (0.5, 3.0), {"RLG": (0.001, 0.01), "FOG": (0.01, 1.0), "MEMS": (0.5, 10.0)}),
    )
    signature = "As slow drift of either sign; longer collects do not help."
    confusable_with = ("drift", "rrw")
    kin = _WITH_TEMPERATURE
    experiment = "Allan variance of one to three hours at rest, at each temperature."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """Return 1/f noise, as Gauss-Markov processes a factor 4 apart in time constant.

        Equal variances B² ln 4/π sum to the one-sided density B²/(π f) between the shortest and longest: the two-sided
        B²/(2π f) of IEEE Std 952, whose Allan deviation is 0.664 B.
        """
        longest = max(float(np.ptp(middle_hr(conditions))) * HOUR_S, 100.0) * 4.0
        taus = 10.0 * 4.0 ** np.arange(np.ceil(np.log(longest / 10.0) / np.log(4.0)) + 1)
        each = per_channel(np.full(len(conditions), np.sqrt(np.log(4.0) / np.pi)), conditions.sensor)
        return tuple(Scatter(each, tau_s=float(tau)) for tau in taus)


class RateRandomWalk(VarianceEffect):
    """The bias walks at random."""

    id = "rrw"
    follows = "time"
    title = "Rate random walk"
    equation = "variance of B(t2) - B(t1) = K^2 (t2 - t1)"
    parameters = (Parameter("K", "deg/hr/sqrt(hr)", (0.5, 5.0), {"FOG": (0.01, 0.1), "MEMS": (0.5, 10.0)}),)
    signature = "Differences between runs grow with the root of the time between them."
    confusable_with = ("ageing", "turnon", "jump", "flicker")
    kin = _WITH_TEMPERATURE
    experiment = "Allan variance; structure function against the distance of runs."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        return (Scatter(per_channel(np.ones(len(conditions)), conditions.sensor), tau_s=np.inf, walk=True),)


class GaussMarkovBias(VarianceEffect):
    """The bias wanders about its value, exponentially correlated: the first-order Gauss-Markov process of IEEE Std 952.

    Correlated over much less than a collect's distance it is a bias of each collect, over much more one of the night:
    turn-on bias and rate random walk are its limits. Sizes and times are assumed.
    """

    id = "markov"
    odds = 3.0  # what the field describes a bias that wanders by: its limits are special cases
    follows = "time"
    title = "Bias that wanders, correlated over a time"
    equation = "cov(B(t1), B(t2)) = sigma_m^2 exp(-|t2 - t1| / tau)"
    parameters = (Parameter("sigma_m", "deg/hr", (0.5, 5.0), _WANDERING_TYPICAL),)
    shapes = (ShapeParameter("tau_hr", "hr", (0.5, 2.0, 8.0, 40.0), continuous=True),)
    signature = "Neighbours in time are alike, and the likeness fades; the whole does not grow, as a walk's does."
    confusable_with = ("turnon", "rrw", "flicker", "ageing")
    kin = _WITH_TEMPERATURE
    experiment = "Hours at rest at one temperature: the autocorrelation of the averages; a second night."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        each = per_channel(np.ones(len(conditions)), conditions.sensor)
        return (Scatter(each, tau_s=HOUR_S * shape["tau_hr"]),)


class TurnOnBias(VarianceEffect):
    """Bias that differs from one power cycle to the next (run to run where power cycles are not recorded)."""

    id = "turnon"
    follows = "run"
    title = "Turn-on bias"
    equation = "B of power cycle k = B + N(0, s_b)"
    parameters = (Parameter("s_b", "deg/hr", (1.0, 5.0), _TURN_ON_TYPICAL),)
    signature = "Contractor's and matrix bias scatter together, MU not at all: sigmas 1 : 1 : 0."
    confusable_with = ("bias_T", "rrw", "jump")
    kin = _WITH_TEMPERATURE
    experiment = "Several power cycles at one temperature."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        every = per_channel(np.ones(len(conditions)), conditions.sensor)
        return (Scatter(every, group=_power_cycle_or_run(conditions)),)


class PowerCycleBias(Effect):
    """A bias of its own after each power-on, where several power cycles of several runs each are recorded."""

    id = "turnon"
    follows = "run"
    title = "Turn-on bias, one per power cycle"
    equation = "B of power cycle k = B + b_k"
    per_channel = True
    parameters = (
        Parameter("b", "deg/hr", (1.0, 5.0), {"RLG": (0.001, 0.005), "FOG": (0.1, 1.0), "MEMS": (5.0, 50.0)}),
    )
    needs = frozenset({"time_since_power_on_s"})
    named_by_data = True
    signature = "All positions move together, and stay until the power is cycled; MU not at all."
    confusable_with = ("bias_T", "rrw", "jump")
    experiment = "Several power cycles at one temperature."
    asks_for = "three power cycles of several runs each; of one run each it is what changes from run to run"

    def aliases_for(self, conditions: Conditions) -> Mapping[str, float]:
        """Return a bias that follows temperature, where each cycle stood at one that no other visited."""
        temperature = column(conditions, LEVEL)
        pairs = set(zip(power_cycles(conditions).tolist(), np.round(temperature).tolist(), strict=True))
        alone = len(pairs) == len({cycle for cycle, _ in pairs}) == len({level for _, level in pairs})
        return {"bias_T": 1.0} if alone else {}

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return how many power cycles there are; none where they are few, or no more than a run or so long."""
        count = len(np.unique(power_cycles(conditions)))
        several = _FEWEST_CYCLES <= count <= 0.6 * len(np.unique(conditions.run))
        return (ShapeParameter("power_cycles", "", (float(count),) if several else ()),)

    def labels_for(self, conditions: Conditions) -> Sequence[str]:
        """Return _1_A, _1_B, _2_A, …: one per power cycle and channel."""
        cycles = range(1, len(np.unique(power_cycles(conditions))) + 1)
        return [f"_{cycle}_{label}" for cycle in cycles for label in channel_labels(conditions.sensor)]

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        cycle = power_cycles(conditions)
        return per_channel(np.equal.outer(cycle, np.unique(cycle)).astype(np.float64), conditions.sensor)


def power_cycles(conditions: Conditions) -> FloatArray:
    """Return when each row's power cycle began, in minutes of the campaign, (n,); 0 where no power-on is recorded."""
    return np.nan_to_num(begun_min(conditions, "time_since_power_on_s"))


def _power_cycle_or_run(conditions: Conditions) -> IntArray:
    """Return the power cycle of each row, (n,), or its run where cycles are not recorded."""
    recorded = np.all(np.isfinite(column(conditions, "time_since_power_on_s")))
    return power_cycles(conditions).astype(np.int64) if recorded else conditions.run


class RetainerNoise(VarianceEffect):
    """Ball retainer and stiff lubricant: white noise that appears in the cold."""

    id = "hash"
    follows = "temperature"
    title = "Ball-retainer noise"
    equation = "sigma = N_c max(0, 5 degC - T)/30 degC / sqrt(duration)"
    parameters = (Parameter("N_c", "deg/sqrt(hr)", (0.1, 0.5)),)
    needs = frozenset({"temperature_degC"})
    signature = "Only the variance rises, below 0 °C, in bursts, and falls with running time."
    confusable_with = ("arw", "frost")
    experiment = "Spin-motor current and noise density against temperature."

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """Return the white noise that grows below 5 °C, one at −25 °C after an hour of averaging."""
        cold = np.nan_to_num(np.maximum(5.0 - column(conditions, "temperature_degC"), 0.0) / 30.0)
        return white(cold * np.sqrt(HOUR_S / averaged_s(conditions)), conditions)
