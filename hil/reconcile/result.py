"""The result of the discrepancy workflow (schema hil.reconciliation/1), as objects and as the JSON document."""

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any

from hil.campaign import Campaign
from hil.files.document import picked, plain
from hil.files.numbers import degrees, number, rounded
from hil.model import Model
from hil.model.effects.document import shape_in_words
from hil.reconcile.rivals import Rival
from hil.solve.between_runs import ASKS
from hil.solve.both_sensors import BothSensors
from hil.solve.document import not_passed, not_passed_of, reasons
from hil.solve.repeats import SensorRepeats, repeats
from hil.solve.runs import solve_campaign
from hil.solve.temperatures import runs_by_temperature
from procedures.verdict import Verdict
from procedures.words import listed, percent, unit_in_words

LEFT_OUT = "runs_left_out"
"""What the finding of bad runs has in its shape, and no other: how many they are."""


@dataclass(frozen=True)
class Disagreement:
    """One place where simulation and measurement differ beyond the noise, with the error rate of the whole map."""

    where: Mapping[str, Any]
    size_deg_per_hr: float
    se_deg_per_hr: float
    q_value: float


def stated(parameters: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """Yield of each parameter of an effect its name with sensor and unit, where it holds, and its value.

    What follows a recorded number by an amplitude per power of it is told by how far it moves the rate.
    """
    for each in parameters:
        of = ", ".join([f" (sensor {each['sensor']}", *each.get("channels", ())]) + ")" if each.get("sensor") else ""
        value, se, unit = each["value"], each["se"], each["unit"]
        moves = each.get("moves_deg_per_hr")
        if moves is not None:
            value, se, unit = moves, each["moves_se_deg_per_hr"], "deg/hr from one end of these collects to the other"
        yield (
            f"{each['name']}{', ' * ('when' in each)}{each.get('when', '')}{of}, {unit_in_words(unit)}",
            unit_in_words(str(each.get("at") or "")),
            rounded(value, se),
        )


def before_and_after_in_words(values: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Yield of each of a unit's parameters what it is, and was without what was found, at each temperature."""
    lines: dict[str, list[str]] = {}
    for each in values:
        degC, run = each["temperature_degC"], each["run"]
        at = "" if degC is None else f" at {degrees(degC, each['temperature_of'])}"
        at += f" in run {run}" * (run is not None)
        told = f"{number(each['after'], 1)}{at}, without it {number(each['before'], 1)}"
        lines.setdefault(f"{each['name']} of sensor {each['sensor']}, {each['unit']}", []).append(told)
    yield from (f"{name}: {'; '.join(told)}" for name, told in lines.items())


def without_collects(why: str) -> dict[str, Any]:
    """Return the next experiment where it is no further collect that settles the question."""
    unknown = dict.fromkeys(("expected_difference_deg_per_hr", "power"))
    return {"why": why.rstrip("."), "collects": [], **unknown, "impossible": False}


@dataclass(frozen=True)
class Shape:
    """What shape of an effect fits one sensor best, where each part of it may be, and `more`: of several steps."""

    values: Mapping[str, float] = field(default_factory=dict)
    may_be: Mapping[str, Sequence[float]] = field(default_factory=dict)
    more: tuple["Shape", ...] = ()

    @property
    def in_words(self) -> str:
        """From which run a step holds, or what time constant or width fits best; empty where there is none."""
        every = [shape_in_words(each.values, each.may_be) for each in (self, *self.more)]
        return listed(every) if all(every) else ""


@dataclass(frozen=True)
class FoundEffect:
    """One effect that was added: its name, fitted parameters, stated probability, that `of_sensor`, and rivals.

    `inside_collects` is what shows in the series only and leaves the averages as they are, `follows` what terms do.
    """

    id: str
    title: str
    probability: float
    kind: str
    equation: str = ""
    parameters: Sequence[Mapping[str, Any]] = ()
    confusable_with: Sequence[Rival] = ()
    shapes: Mapping[int, Shape] = field(default_factory=dict)
    sensors: Sequence[int] = ()
    physics: str = ""
    experiment: str = ""
    inside_collects: bool = False
    acts_on: str = "mean"
    follows: Set[str] = frozenset()
    mends_labels: bool = False
    of_sensor: Mapping[int, float] = field(default_factory=dict)

    @property
    def sure(self) -> str:
        """Say how probable it is, and that it is in each sensor where that differs."""
        each = {number: percent(own) for number, own in self.of_sensor.items()}
        apart = ", ".join(f"sensor {number}: {own}" for number, own in each.items())
        return percent(self.probability) + f"; {apart}" * bool({*each.values()} - {percent(self.probability)})

    @property
    def shape(self) -> Mapping[str, float]:
        """That of the first sensor."""
        return next(iter(self.shapes.values()), Shape()).values

    @property
    def shape_in_words(self) -> str:
        """Say the shape, of each sensor where they differ."""
        said = {number: shape.in_words for number, shape in self.shapes.items()}
        if len(set(said.values())) > 1:
            return listed(f"{words} (sensor {number})" for number, words in said.items() if words)
        return next(iter(said.values()), "")

    def document(self) -> dict[str, Any]:
        """Return the JSON object."""
        first = next(iter(self.shapes.values()), Shape())
        shape = {"shape": first.values, "shape_range": first.may_be, "shape_in_words": self.shape_in_words}
        if len({each.in_words for each in self.shapes.values()}) > 1:
            shape["shape_of_sensor"] = {str(number): each.values for number, each in self.shapes.items()}
        if len(self.of_sensor) > 1:
            shape["probability_of_sensor"] = {str(number): own for number, own in self.of_sensor.items()}
        as_it_is = "id title equation parameters sensors kind inside_collects probability acts_on"
        return picked(self, as_it_is, confusable_with=[rival.document() for rival in self.confusable_with], **shape)


@dataclass(frozen=True)
class Gap:
    """Held-out residuals before and after, beside the noise: raw rms in deg/hr, and standardised mean squares.

    `each` is what is held out at a time, a run or a collect; empty where nothing can be.
    """

    before: float
    after: float
    noise_floor: float
    held_out: str
    standardised_before: float
    standardised_after: float
    improved_p_value: float
    log_score: Mapping[str, float] | None = None
    each: str = ""

    def document(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {
            "unit": "deg/hr",
            "statistic": "rms of held-out residuals (raw in deg/hr; standardised by their covariance)",
            **picked(self, "before after noise_floor held_out"),
            "standardised": picked(self, "before=standardised_before after=standardised_after"),
            **picked(self, "improvement_p_value=improved_p_value"),
            **({"log_score": self.log_score} if self.log_score else {}),
        }


@dataclass(frozen=True)
class Solved:
    """The runs that `hil solve` does not pass, `of_sensors`; whose residuals exceed their errors; and all reasons.

    Of `but_for_errors` it says nothing else than that.
    `widens`: whether repeats or residuals tell it by how much its ± have to be wider than standard errors say; `errors`
    is what is to be known of the ± of each sensor, `small` whether some standard errors are too small, `misstated`
    whether some are so far off that others have to be stated. The runs are by verdict and sensor; `not_passed` by
    verdict alone. `temperatures` are those at which some run tells every parameter, of the sensor that has most;
    `shown` is what repeats show of each sensor.
    """

    of_sensors: Mapping[str, Mapping[str, Sequence[int]]] = field(default_factory=dict)
    beyond_errors: Sequence[int] = ()
    but_for_errors: Sequence[int] = ()
    reasons: Sequence[str] = ()
    widens: bool = False
    errors: Sequence[str] = ()
    small: bool = False
    misstated: bool = False
    temperatures: int = 0
    shown: Mapping[int, SensorRepeats] = field(default_factory=dict, compare=False)

    @property
    def not_passed(self) -> dict[str, list[int]]:
        """The runs that some sensor does not pass, by verdict."""
        return not_passed(self.of_sensors)

    @classmethod
    def of(cls, campaign: Campaign, beside: str = "", solved: "Solved | None" = None) -> "Solved":
        """Solve a campaign; of what `solved` does not say of standard errors it is said what they are `beside`."""
        every = solve_campaign(campaign)
        beyond = sorted({run for each in every if each.exceeds_errors for run in each.runs})
        odd = [each for each in every if each.verdict is not Verdict.PASS]
        else_odd = {run for each in odd if not each.exceeds_errors or each.causes != [each.judged] for run in each.runs}
        why = [f"{verdict}, {where}: {each}".replace(ASKS, "") for verdict, where, each in reasons(odd)]
        shown = repeats(campaign, every)
        widens = any(each.repeated for each in shown.values()) or any(e.degrees_of_freedom for e in every)
        known = () if solved is None else solved.errors
        errors = [
            same if (same := f"sensor {number}: {said}") in known else f"sensor {number}: {beside}{said}"
            for number, each in shown.items()
            for said in each.cautions
        ]
        small = any(times > 1.0 for each in shown.values() for times in each.times_of.values())
        misstated = any(each.misstated for each in shown.values())
        whole = {(each.sensor, run) for each in every if not each.unobservable for run in each.runs}
        made = {n: runs_by_temperature(rows.conditions) for n, rows in campaign.sensors.items()}
        at = [
            sum(any((n, run) in whole for run in runs) for degC, runs in of if degC is not None)
            for n, of in made.items()
        ]
        only = [run for run in beyond if run not in else_odd]
        return cls(not_passed_of(every), beyond, only, why, widens, errors, small, misstated, max(at, default=0), shown)


@dataclass(frozen=True)
class Reconciliation:
    """What the workflow found. `picture` is for the page: residuals by row before and after, on one scale."""

    campaign: str
    source: str
    model_before: str
    verdict: str
    disagreements: Sequence[Disagreement]
    effects: Sequence[FoundEffect]
    gap: Gap
    false_alarm_rate: float
    p_value: float
    next_experiment: Mapping[str, Any] | None
    model_after: Model
    input_model: Model
    outliers: Sequence[Mapping[str, Any]] = ()
    within_collects: Sequence[Mapping[str, Any]] = ()
    as_it_stands: Mapping[str, Any] | None = None
    notes: Sequence[str] = ()
    simulated: bool = False
    calibration: str = "one set"
    picture: Mapping[str, Any] = field(default_factory=dict)
    follows: Sequence[tuple[str, float]] = ()
    follows_one_of: Mapping[str, Any] | None = None
    noise: Sequence[Mapping[str, Any]] = ()
    rows: Sequence[Mapping[str, Any]] = ()
    values: Sequence[Mapping[str, Any]] = ()
    twin: Mapping[str, Any] | None = None
    tested: bool = True
    contradicted: Sequence[int] = ()
    warned: bool = False  # whether its records have warnings, which may ask for something
    doubtful: Mapping[str, Sequence[int]] = field(default_factory=dict)  # by verdict, runs that are not measured well
    without: Mapping[str, Any] = field(default_factory=dict)  # which runs are in no search or had not settled
    solved: Solved = field(default_factory=Solved)  # what `hil solve` says of these collects
    left: Solved = field(default_factory=Solved)  # and would say without what was found
    both: BothSensors | None = None
    look_for: str = ""  # what two sensors have in common beside what was found
    to_record: Sequence[str] = ()  # what nobody recorded that changes from run to run may follow

    @property
    def calibrated(self) -> bool:
        """Whether values follow temperature, so that the model was calibrated at each."""
        return self.calibration != "one set"

    def document(self) -> dict[str, Any]:
        """Return the JSON document of formats/reconciliation.md; keys beyond the contract are additions."""
        document = {
            "schema": "hil.reconciliation/1",
            **picked(self, "campaign source simulated model_before"),
            "model_after": "model.yaml",
            **picked(self, "verdict tested contradicted_runs=contradicted"),
            "doubtful_runs": self.doubtful,
            "runs_beyond_errors": self.solved.beyond_errors,
            "runs_not_solved": self.solved.not_passed,
            "runs_not_solved_after": self.left.not_passed,
            "runs_not_solved_after_by_sensor": self.left.of_sensors,
            "to_record": list(self.to_record),
            **self.without,
            "both_sensors": None if self.both is None else self.both.document(),
            **picked(self, "p_value calibration"),
            "disagreements": [vars(each) for each in self.disagreements],
            "effects": [effect.document() for effect in self.effects],
            "gap": self.gap.document(),
            **picked(self, "false_alarm_rate next_experiment outliers as_it_stands within_collects notes"),
            "follows": [{"driver": driver, "probability": share} for driver, share in self.follows],
            **picked(self, "follows_one_of noise rows values"),
            **({"twin": self.twin} if self.twin else {}),
        }
        return dict(plain(document))
