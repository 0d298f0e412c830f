"""Whether a result is right: its names, its probabilities, its places, its gap, against the sealed truth."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence, Set
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from scipy.stats import beta

from benchmarks.blind.cases import HIDDEN, Case, base_columns, whitened
from benchmarks.blind.faults import FAULTS
from benchmarks.blind.jobs import Job
from benchmarks.blind.poses import MISTAKES
from benchmarks.blind.scatter import SCATTER

CONFIDENT = 0.8
Name = TypeVar("Name", str, list[str])
_SAME = 0.95
_SLOW = {"markov", "rrw", "flicker", "turnon"}
"""Scatter that is correlated in time: limits of one another, which a night can hardly part."""
_NOISE = {"walk": ("rrw",), "run_mu": ("MU_rr",), "cold": ("hash",), "row_ar": ("markov", "flicker")}
"""Kinds of noise that are an effect on the scatter: to find it is no false alarm."""
_OF_DATA = {
    *("swap", "swapped", "pose", "position", "label", "labels", "sign", "clip", "clipped", "saturation"),
    *("row", "rows", "run", "runs", "outlier", "outliers", "bad"),
}
"""Words in the ids of mistakes in the data."""
_OUTSIDE_FOLLOWS = {
    "MU × supply": ("supply", "supply_V"),
    "GS × dT/dt": ("temperature_rate", "dTdt_degC_per_min"),
    "one position, cold": ("pose", "temperature", "temperature_degC"),
    "MU step in temperature": ("temperature", "temperature_degC"),
    "GS ripple in temperature": ("temperature", "temperature_degC"),
}
_FOLLOWS = {
    "time": "ageing jump warmup drift rrw markov flicker base",
    "run": "jump MU_rr GS_rr turnon frost",
    "temperature": "bias_T GS_T demod hash frost",
    "temperature_rate": "bias_Tdot bias_grad T_lag",
    "temperature_history": "hyst soak_insufficient bias_grad T_lag bias_Tdot warmup",
    "pose": "MU_real k2 phase scale index misalign g_sensitivity settle drift earth frame mag MU_rr GS_rr",
    "supply": "supply",
    "heading": "earth frame mag",
    "supply_V": "supply",
    "spin_period_us": "spin",
    "vibration_rms_g": "vre",
    "case_degC": "demod",
    "temperature_degC": "bias_T GS_T demod",
    "dTdt_degC_per_min": "bias_Tdot bias_grad T_lag",
}
"""What each driver moves, by the equations of the effects; what has no entry of the catalogue stands before."""


def answers(hidden: Sequence[str]) -> tuple[str, ...]:
    """The ids that are right: a hidden thing's form stands behind an @; a wrong label alone is nothing to find."""
    return tuple(name.partition("@")[0] for name in hidden if name != "label@alone")


def kind_hidden(hidden: Sequence[str]) -> str:
    """What is asked for: "mean", "scatter", "both", "fault" or "nothing"."""
    mean = any(name in HIDDEN or name == "g_sensitivity" for name in hidden)
    if any(name in FAULTS or name in MISTAKES for name in hidden):
        return "fault" if answers(hidden) else "nothing"
    if any(name in SCATTER for name in hidden):
        return "both" if mean else "scatter"
    return "mean" if mean else "nothing"


def on_scatter(effect: dict[str, Any]) -> bool:
    """Whether a found effect scatters averages and moves none."""
    return bool(effect.get("acts_on", "mean") == "scatter")


def of_data(effect: dict[str, Any]) -> bool:
    """Whether a found effect is a mistake in the data, by its id; of empirical terms those of whole runs."""
    kind, _, rest = effect["id"].lower().partition(": ")
    if kind == "empirical":
        return re.fullmatch(r"runs? [\d, to–-]+", rest) is not None
    return bool(set(re.split(r"\W|_", kind)) & _OF_DATA)


def scatter_named(document: dict[str, Any], hidden: Sequence[str]) -> tuple[bool, bool] | None:
    """Whether the hidden effect on the scatter was named, and whether it or one of its kin was; None: none hidden."""
    true = set(answers([name for name in hidden if name in SCATTER]))
    if not true:
        return None
    classes = [
        ids for e, ids in zip(document["effects"], named_ids(document), strict=True) if on_scatter(e) or e["id"] in true
    ]
    kin = true | (_SLOW if true & _SLOW else set())
    return any(true & ids for ids in classes), any(kin & ids for ids in classes)


def on_the_mean(document: dict[str, Any], hidden: Sequence[str], sure: float | None = None) -> bool:
    """Whether anything was found that does not scatter, and is not hidden; `sure`: named with that probability.

    A bias per power cycle may be found as a bias of each or as their scatter: either is what is hidden.
    """
    found = [e for e in document["effects"] if not on_scatter(e) and e["id"] not in answers(hidden)]
    return bool(found) if sure is None else any(_is_name(e) and e["probability"] >= sure for e in found)


def in_the_noise(job: Job) -> set[str]:
    """Return the effects on the scatter that the noise of a case has, whatever is hidden beside it."""
    noise, has = job.noise, set[str]()
    if job.form == "night":
        has |= set(_NOISE.get(noise.kind, ()))
        has |= _SLOW if noise.rho and noise.kind != "white" else set()
        has |= {"arw"} if noise.extra or noise.stated != 1.0 else set()
    return has


def false_alarm(document: dict[str, Any], job: Job) -> bool | None:
    """Whether anything is found where nothing is hidden, but for scatter that the noise really has."""
    if kind_hidden(job.hidden) != "nothing":
        return None
    allowed = in_the_noise(job)
    found = document["effects"]
    if not found:
        return bool(document["verdict"] != "none")
    # A wrong label is nothing wrong with the unit, and may be pointed at.
    return any(not (on_scatter(e) and e["id"] in allowed) and not (job.hidden and of_data(e)) for e in found)


def _is_name(effect: dict[str, Any]) -> bool:
    return effect.get("kind") != "empirical" and not effect["id"].startswith("empirical")


def listed(document: dict[str, Any], hidden: Sequence[str]) -> bool:
    """Whether each hidden effect is among what is said: in an effect's class, or in its 90 % set of names."""
    said = set().union(*named_ids(document), *(_probable(effect) for effect in document["effects"]))
    return bool(hidden) and set(answers(hidden)) <= said


def told(document: dict[str, Any], collects: Set[int], runs: Set[int]) -> bool | None:
    """Whether the result points at spoiled collects or runs, left out, found or as a place; None: there are none."""
    if not collects:
        return None
    if any(outlier.get("collect") in collects for outlier in document.get("outliers", ())):
        return True
    if any(set(place["where"].get("runs", [-1])) <= runs for place in document["disagreements"]):
        return True
    return any(of_data(effect) and _run_of(effect) in runs for effect in document["effects"])


def _run_of(effect: dict[str, Any]) -> int | None:
    run = effect.get("shape", {}).get("run", effect.get("shape", {}).get("from_run"))
    return None if run is None else int(run)


def followed(
    document: dict[str, Any], hidden: Sequence[str], noise: Set[str] = frozenset()
) -> tuple[float, bool] | None:
    """(probability stated for the first driver, whether a hidden effect follows it); None where nothing is said.

    `noise` are the effects that the noise itself has.
    """
    if not document.get("follows"):
        return None
    first = max(document["follows"], key=lambda one: one["probability"])
    moved = set(_FOLLOWS.get(first["driver"], "").split())
    moved |= {name for name, drivers in _OUTSIDE_FOLLOWS.items() if first["driver"] in drivers}
    return first["probability"], bool((set(answers(hidden)) | noise) & moved)


def named_ids(document: dict[str, Any]) -> list[set[str]]:
    """For each added effect, its id and those that the result calls the same within the data (overlap above .95)."""
    out = []
    for effect in document["effects"]:
        same = {rival["id"] for rival in effect["confusable_with"] if rival.get("overlap", 0.0) > _SAME}
        out.append({effect["id"]} | same)
    return out


def first_is_right(document: dict[str, Any], hidden: Sequence[str]) -> bool:
    """Whether the first effect's class holds a hidden one."""
    classes = named_ids(document)
    return bool(classes) and any(name in classes[0] for name in answers(hidden))


def all_right(document: dict[str, Any], hidden: Sequence[str], noise: Set[str] = frozenset()) -> bool:
    """Whether exactly the hidden effects were found, each by its class, beside what the noise itself has."""
    true = answers(hidden)
    classes = [ids for ids in named_ids(document) if ids & set(true) or not ids & noise]
    return len(classes) == len(true) and all(any(name in c for c in classes) for name in true)


def confidently_wrong(
    document: dict[str, Any], hidden: Sequence[str], *, pointed: bool = False, noise: Set[str] = frozenset()
) -> bool:
    """Whether any effect is named at .8 or more whose class holds none that is hidden or of the noise itself.

    A mistake in the data under another word is no wrong name where the result points at the spoiled rows (`pointed`).
    """
    if document["verdict"] != "named":
        return False
    right = set(answers(hidden)) | noise
    return any(
        effect["probability"] >= CONFIDENT and not ids & right and not (pointed and of_data(effect))
        for effect, ids in zip(document["effects"], named_ids(document), strict=True)
    )


def stated(
    document: dict[str, Any], hidden: Sequence[str], *, pointed: bool = False, noise: Set[str] = frozenset()
) -> list[tuple[float, bool]]:
    """(probability stated for a catalogue name, whether that very name is hidden or the noise's), one per effect."""
    return [
        (e["probability"], e["id"] in answers(hidden) or e["id"] in noise or (pointed and of_data(e)))
        for e in document["effects"]
        if _is_name(e)
    ]


def ninety_percent_set(document: dict[str, Any]) -> set[str]:
    """The first effect's most probable names that together reach 90 %."""
    if not document["effects"]:
        return set()
    return _probable(document["effects"][0])


def _probable(effect: dict[str, Any]) -> set[str]:
    names = [(effect["probability"], effect["id"])] + [(r["probability"], r["id"]) for r in effect["confusable_with"]]
    return set(_most_probable(names))


def ninety_percent_classes(document: dict[str, Any]) -> list[list[str]]:
    """The same with names that these collects cannot part (overlap above .95 with the first) as one class."""
    if not document["effects"]:
        return []
    effect = document["effects"][0]
    same = [r for r in effect["confusable_with"] if r.get("overlap", 0.0) > _SAME]
    first = [effect["id"], *(r["id"] for r in same)]
    classes = [(effect["probability"] + sum(r["probability"] for r in same), first)]
    classes += [(r["probability"], [r["id"]]) for r in effect["confusable_with"] if r["id"] not in first]
    return _most_probable(classes)


def _most_probable(weighed: list[tuple[float, Name]]) -> list[Name]:
    """The fewest that together reach 90 %."""
    chosen, total = [], 0.0
    for probability, one in sorted(weighed, reverse=True):
        chosen.append(one)
        total += probability
        if total >= 0.9:
            break
    return chosen


def places_f1(document: dict[str, Any], case: Case, job: Job) -> dict[str, float]:
    """F1 of the places called disagreeing, against where the hidden terms are above 30 % of their largest.

    Two readings of the truth: what the hidden terms contribute themselves, and what the fitted base leaves of that
    (generalised least squares with the noise that was drawn). Two finenesses: collect by collect and channel, which is
    position, setpoint and run; and channel by position only, a cell counting where anything in it does.
    """
    found = _called(document, case)
    signal = sum(case.signals, np.zeros((len(case.night), 2)))
    out = {}
    for reading, part in (("itself", signal), ("residual", _left_by_base(signal, case, job))):
        truth = np.abs(part) > 0.3 * np.abs(part).max()
        out[f"{reading}, by collect"] = _f1(found, truth)
        out[f"{reading}, by position"] = _f1(_by_position(found, case), _by_position(truth, case))
    return out


def _called(document: dict[str, Any], case: Case) -> np.ndarray:
    """The collects and channels that the result calls disagreeing, (n, 2)."""
    found = np.zeros((len(case.night), 2), dtype=bool)
    for item in document["disagreements"]:
        where = item["where"]
        rows = np.ones(len(case.night), dtype=bool)
        if "position" in where:
            rows &= case.night.position == where["position"]
        if "collect_of_run" in where:
            rows &= case.night.order == where["collect_of_run"] - 1
        if "temperature_degC" in where:
            low, high = where["temperature_degC"]
            rows &= (case.night.rotor >= low) & (case.night.rotor <= high)
        if "runs" in where:
            rows &= np.isin(case.night.run, where["runs"])
        channels = np.array([0, 1] if "channel" not in where else [0 if where["channel"] == "RA" else 1])
        found[np.ix_(np.flatnonzero(rows), channels)] = True
    return found


def _by_position(collects: np.ndarray, case: Case) -> np.ndarray:
    position = case.night.position
    return np.array([collects[position == label].any(axis=0) for label in np.unique(position)])


def _left_by_base(signal: np.ndarray, case: Case, job: Job) -> np.ndarray:
    """What a fitted base leaves of a signal (n, 2), deg/hr."""
    base, column = base_columns(case.filed, job.model), signal.T.ravel()
    both = whitened(case.covariance, np.column_stack([base, column]))
    fitted = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=None)[0]
    return (column - base @ fitted).reshape(2, -1).T


def _f1(found: np.ndarray, truth: np.ndarray) -> float:
    return 2.0 * float((found & truth).sum()) / max(float(found.sum() + truth.sum()), 1.0)


def oracle_gap(case: Case, job: Job) -> float:
    """Rms in deg/hr of what is left out by run when the hidden terms and the noise are known, deg/hr."""
    night = case.filed
    white = whitened(case.covariance, np.eye(2 * len(night)))
    columns = [base_columns(night, job.model)] + [s.T.ravel()[:, None] for s in case.signals]
    design, y = np.hstack(columns), (case.rates - night.w[:, :2]).T.ravel()
    left = np.empty_like(y)
    for run in np.unique(night.run):
        out = np.tile(night.run == run, 2)
        # A row that is left out has no weight: its noise is made endless.
        weight = white.copy()
        weight[:, out] = 0.0
        rows = ~out
        beta_hat = np.linalg.lstsq((weight @ design)[rows], (weight @ y)[rows], rcond=None)[0]
        left[out] = y[out] - design[out] @ beta_hat
    return float(np.sqrt(np.mean(left**2)))


def follow_up(job: Job, document: dict[str, Any]) -> Job | None:
    """The case measured again as the result asks for, the effect as large as it was; None where nothing is asked."""
    advice = document["next_experiment"]
    if document["verdict"] != "ambiguous" or not advice or advice.get("impossible"):
        return None
    design = job.design
    what = advice["what"]
    if what.startswith("Collect "):
        label = {"4": "4", "at 45 deg": "5", "at 135 deg": "6"}[what.removeprefix("Collect ")]
        larger = replace(design, positions=(*design.positions, label))
    elif "heading" in what:
        turned = tuple((h + 90.0) % 360.0 for h in design.headings_deg)
        larger = replace(
            design, headings_deg=(*design.headings_deg, *turned), temperatures_degC=2 * design.temperatures_degC
        )
    elif "reverse" in what:
        larger = replace(design, temperatures_degC=(*design.temperatures_degC, *reversed(design.temperatures_degC)))
    else:
        return None
    rows = (
        len(larger.positions) * len(larger.temperatures_degC) / (len(design.positions) * len(design.temperatures_degC))
    )
    return replace(job, row="measured again as advised", design=larger, d=job.d * float(np.sqrt(rows)))


def share(flags: Iterable[bool]) -> str:
    """A proportion with its exact 95 % interval."""
    values = list(flags)
    k, n = sum(values), len(values)
    if n == 0:
        return "–"
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{k / n:.2f} [{low:.2f}, {high:.2f}]"
