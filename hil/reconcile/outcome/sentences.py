"""What a result says in sentences: what is missing, how sure that is, what it mends, and what somebody has to do."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drivers.strict_yaml import packaged
from hil.model.effects.catalogue import entries
from hil.model.effects.prior import ALPHA
from hil.reconcile.follows import AGAIN, MOST
from hil.reconcile.naming import LIKELY
from hil.reconcile.outcome.stated import at_most, not_between_repeats, not_repeated
from hil.reconcile.result import LEFT_OUT, FoundEffect, Gap, Reconciliation
from hil.reconcile.rivals import CERTAIN, Rival, in_times
from hil.reconcile.search.terms import NO_NAME
from hil.solve.document import of_sensors_in_words
from hil.solve.repeats import MAY_FOLLOW, MISSTATED
from hil.solve.temperatures import too_few
from hil.solve.wrong_rows import LEFT_OUT as OMITTED
from procedures.words import listed, numbered, percent

LEAST = 1e-4  # p-values are said down to it
_FALLS = 0.98  # of what it was: from there on a gap is said to fall
_MORE_THAN_NOISE = 1.15  # times the noise: from there on it is not said that nothing else is left
_EXPECTED = 5.0  # times as usual at its size, from which on physics is said to expect a name

_ACT = packaged("hil.reconcile.outcome", "what_to_do.yaml")


def _explained(result: Reconciliation) -> dict[str, dict[str, list[int]]]:
    """Return by sensor which runs, of those not measured well, hil solve FAILs only as long as nothing is taken off."""
    before, left = (of.of_sensors.get("FAIL", {}) for of in (result.solved, result.left))
    asked = {run for verdict, runs in result.doubtful.items() if verdict != "FAIL" for run in runs}
    found = {n: [run for run in runs if run in asked.difference(left.get(n, ()))] for n, runs in before.items()}
    return {"FAIL by hil solve, no longer with what is known taken off": found}


def what_to_do(result: Reconciliation) -> tuple[str, str]:
    """Return the verdict and what somebody has to do now; "labels": only those were wrong, "untested": none was.

    And "scatter": the mean lacks nothing that can be told, but what scatters makes `hil solve` FAIL; "apart": neither,
    but simulated nights can be told from the measured one.
    """
    only = result.verdict in {"named", "ambiguous"} and all(effect.mends_labels for effect in result.effects)
    kind = "labels" if only else result.verdict if result.tested else "untested"
    if kind == NO_NAME and any(_named(each) for effect in result.effects for each in effect.confusable_with):
        kind = "ambiguous"
    after = (result.twin or {}).get("after", {})
    apart = after.get("p_value", 1.0) < ALPHA
    beyond = result.left.beyond_errors
    kind = ("scatter" if beyond else "apart" if apart else kind) if kind == "none" else kind
    measured = [f"{numbered('run', runs)} ({verdict})" for verdict, runs in result.doubtful.items()]
    doubts = ", ".join([*measured, *(told for _, told in of_sensors_in_words(_explained(result)))])
    first = ["what is missing of the measurement (hil report says what)"] * bool(result.without.get("missing"))
    first += [f"what was not measured well (hil report says why): {doubts}"] if doubts else []
    runs = numbered("run", result.contradicted) if result.contradicted else ""
    first += [f"what its own records contradict (notes): {runs}"] * bool(runs)
    wrong = not only and any(effect.mends_labels for effect in result.effects)
    first += ["what the record has wrong of labels and signs (below)"] * wrong
    omitted = [row for row in result.rows if row["done"] == OMITTED]
    said = {
        *result.contradicted,
        *(row["run"] for row in omitted),
        *(result.left.but_for_errors if kind == "scatter" else ()),
    }
    said |= {run for runs in result.doubtful.values() for run in runs}
    doubts = ", ".join(told for _, told in of_sensors_in_words(result.left.of_sensors, said))
    why = " (hil report says" if result.left == result.solved else ", even with what is known taken off (notes say"
    first += [f"what hil solve does not pass{why} why): {doubts}"] if doubts else []
    spoiled = sorted({collect for row in omitted for collect in row["collects"]})
    first += [f"what is left out (below): {numbered('collect', spoiled)}"] if spoiled else []
    first += [f"{result.look_for} (notes)"] * bool(result.look_for)
    model = ", or the noise that the model states" * bool(result.input_model.noise)
    wrong = kind != "scatter" and result.left.misstated
    first += [f"standard errors{model}: repeats and residuals show others (notes)"] * wrong
    if once := not_repeated(result.noise, result.left.shown, result.input_model):
        first.append(f"{AGAIN}: {once} may have followed it, or changed by the run")
    follow = not_between_repeats(result.noise) if kind in {"none", "apart"} else ""
    first += [f"what {follow} follows: runs of one temperature differ less (hil thermal)"] if follow else []
    first += [f"a record of {MAY_FOLLOW.format(listed(own))}" for own in [result.to_record] if own]
    act = _ACT["open" if kind == "ambiguous" and not result.next_experiment else kind]
    if kind == "none" and (first or result.warned):
        act = "The model itself lacks nothing that can be told." if first else _ACT["warned"]
    act = _ACT["errors"] if kind == "scatter" and result.left.small else act
    useless = sorted(map(int, result.without.get("runs_used_though_failed", {})))
    nothing = bool(useless) and {number for effect in result.effects for number in effect.sensors} <= {*useless}
    if useless:
        said_of = f"Use nothing of {numbered('sensor', useless)}: every run FAILed by what was recorded."
        others = numbered("sensor", [number for number in result.solved.shown if number not in useless])
        act = said_of if nothing else f"{said_of} For {others}: {act}"
    if kind == "scatter":
        of = {n: [run for run in runs if run in beyond] for n, runs in result.left.of_sensors.get("FAIL", {}).items()}
        where = ", ".join(told for _, told in of_sensors_in_words({"FAIL": of}))
        act = f"{act} No effect is named, but averages scatter more than their standard errors say: {where}."
    elif kind in {"none", "apart"} and (more := at_most(result.noise)):
        known = ["the ± of hil solve"] * (result.solved.widens and not once and not follow)
        act += (
            f" Averages scatter {more}; {listed([*known, 'the noise of model.yaml'])} {'have' if known else 'has'} it."
        )
    if (
        kind in {"none", "apart"}
        and (result.input_model.noise or result.input_model.terms)
        and result.solved.of_sensors
        and not result.left.of_sensors
    ):
        doubts = ", ".join(told for _, told in of_sensors_in_words(result.solved.of_sensors, set()))
        states = listed(["terms"] * bool(result.input_model.terms) + ["noise"] * bool(result.input_model.noise))
        act += f" That is by the {states} that the model states; hil solve without --model does not pass {doubts}."
    warmth = result.calibrated or dict(result.follows).get("temperature", 0.0) > LIKELY
    likely = kind in {"none", "named", "ambiguous"} and warmth and not nothing
    added = [effect for effect in result.effects if not effect.mends_labels]
    warm = {each.id for each in entries() if each.follows == "temperature"}
    untold = {rival.id for effect in added for rival in effect.confusable_with if rival.untold}
    told = warm & untold or any("temperature" in effect.follows for effect in added)
    if likely and not result.calibrated and added and not told:
        alone = any(len(mean.runs) == 1 for each in result.left.shown.values() for mean in each.means)
        tells = f": {AGAIN} tells it from what changes by the run" * alone
        first.append(f"what probably follows temperature, and is not in the model (notes){tells}")
    elif likely and result.solved.temperatures:
        time = ", or time: each temperature was met once" * all(e.visited_once for e in result.solved.shown.values())
        act += f" The model's values follow temperature{time}." * result.calibrated
        tells = f"these cannot tell ({few})" if (few := too_few(result.solved.temperatures)) else "hil thermal says"
        act += f" The model holds at temperatures that were measured: how far off it may be at others, {tells}."
    if apart:
        p_values = {part: 1.0 if p is None else p for part, p in after["parts"].items()}
        by = _ACT["told_by"][min(p_values, key=lambda part: p_values[part])]
        act += f" Nights simulated with the model as it is now can be told from the measured one by {by}."
    return kind, f"First see to {'; '.join(first)}. {act}" if first else act


def summary(result: Reconciliation) -> list[str]:
    """Say what was found in a few sentences: what, how sure, what it mends, what to do next."""
    added = [effect for effect in result.effects if not effect.mends_labels and LEFT_OUT not in effect.shape]
    swapped = [effect for effect in result.effects if effect.mends_labels]
    model = result.input_model.full_title
    per_temperature = " calibrated at each temperature" * result.calibrated
    if not result.effects:
        if not result.tested:
            return ["These collects leave nothing over by which the model could be told from another."]
        if result.verdict == "none":
            how = per_temperature or " fitted to these collects"
            if (off := float(np.sqrt(result.gap.standardised_after))) > _MORE_THAN_NOISE:
                held = "what was held out" if result.gap.each else "what is left"
                noise = f"nothing that can be told from noise, though {held} is {off:.2g} times what noise should leave"
            elif at_most(result.noise) or what_to_do(result)[0] != "none":
                noise = "nothing that can be told from scatter"
            else:
                noise = "nothing but noise"
            follow = ": that its values follow temperature is no finding here" * result.calibrated
            nothing = f"The model {model},{how}, leaves {noise}{follow}."
            return [nothing, *(f"{text[0].upper()}{text[1:]}." for text in values_off(result.as_it_stands, result.gap))]
        return [f"{model} does not describe these collects, and nothing that was tried mends it."]
    said = [f"{effect.title} ({effect.id}): {effect.equation}." for effect in swapped]
    said += [f"{effect.title}: left out." for effect in result.effects if LEFT_OUT in effect.shape]
    for effect in added:
        when = f", {effect.shape_in_words}," if effect.shape_in_words else ""
        missing = "is missing" if effect.probability >= 0.5 else "may be missing"
        sentence = f"{effect.title} ({effect.id}){when} {missing} from {model}"
        sentence += _or_else(result, effect) if effect.kind == "ambiguous" or effect.probability < CERTAIN else ""
        if effect.inside_collects:
            sentence += "; it shows inside the collects and leaves no trace in their averages"
        said.append(sentence + ".")
    said += gap_in_words(result)[:1]
    said += _follows(result) if added else []
    if per_temperature:
        said.append("The model's other values were calibrated at each temperature.")
    if following := result.next_experiment:
        why = titled(result, str(following["why"]))
        what = following.get("what")
        said.append(f"Measure next: {what}: {why}." if what else f"{why[0].upper()}{why[1:]}.")
    return said


def _follows(result: Reconciliation) -> list[str]:
    """Say what is surely followed, whatever its name, and of which few one surely is."""
    one_of = result.follows_one_of
    sure = [each for each in result.follows if each[1] >= CERTAIN] or result.follows[: not one_of]
    told = [([driver], share) for driver, share in sure]
    told += [(one_of["drivers"], one_of["probability"])] if one_of else []
    said = []
    for drivers, share in told:
        others = " or ".join(driver.replace("_", " ") for driver in drivers if driver != "run")
        does = ["changes from run to run"] * ("run" in drivers) + [f"follows {others}"] * bool(others)
        said.append(f"{' or '.join(does)} ({percent(share)})")
    return [f"It {listed(said)}."] if said else []


def _or_else(result: Reconciliation, effect: FoundEffect) -> str:
    """Say how probable an ambiguous name is, what it may be instead, and what the data and physics say of those."""
    others = [each for each in effect.confusable_with[:MOST] if not each.beside]
    if not others:
        return f" – probably ({effect.sure}), not certainly" if effect.probability >= 0.5 else f" ({effect.sure})"
    instead = "".join(f", or – {percent(each.share)} – {titled(result, each.id)}" for each in others)
    said = f" ({effect.sure}){instead}"
    if same := [each for each in others if each.untold]:
        them = "them" if same == others else f"{effect.id} and {listed([each.id for each in same])}"
        said += f": these collects cannot tell {them} apart; {_usual(result, effect, same)}"
    if effect.acts_on == "scatter" and others[0].probability > effect.probability:
        said += f"{';' if same else ':'} what may be no more than scatter is written as scatter"
    return said


def _usual(result: Reconciliation, effect: FoundEffect, same: Sequence[Rival]) -> str:
    """Say whether physics alone, by how usual a size is, favours an effect or another that looks the `same`.

    What follows a curve has no name, and nothing expects it.
    """
    named = [each for each in same if _named(each)]
    if not named:
        return f"{effect.id} is the only one of them that has a name"
    odds = {each.id: each.prior_odds if each.prior_odds is not None else 1.0 for each in named}
    most = max(odds, key=lambda name: odds[name])
    expected, by, times, of = titled(result, most), "by how usual it is at this size", odds[most], ""
    if odds[most] < _EXPECTED:
        expected, times, of = effect.id, 1.0 / odds[most], " as any of those" if len(named) > 1 else ""
    if times < _EXPECTED:
        return f"{effect.id} is not known to be much more usual, at this size"
    return f"physics expects {expected}: {by}, {in_times(times)} as probable{of}"


def _named(rival: Rival) -> bool:
    """Whether it is an effect of the catalogue, and no collect tells it apart."""
    return rival.untold and not rival.id.startswith(NO_NAME)


def gap_in_words(result: Reconciliation) -> list[str]:
    """Say by how much the gap shrank; where it lies in the scatter, that each rate became more probable, first."""
    gap, score = result.gap, result.gap.log_score
    if np.isfinite(gap.before) and not gap.noise_floor > 0.0:
        return ["These runs have as many parameters as rates: nothing is left to be noise, and no gap can be stated."]
    if not np.isfinite(gap.before) or not result.effects:
        return []
    how = f"on {gap.each}s that were held out" if gap.each else "of the fit (nothing could be held out)"
    swapped = any(effect.mends_labels for effect in result.effects)
    mended = ["the record put right"] * swapped
    added = sum(
        not (effect.mends_labels or effect.inside_collects or LEFT_OUT in effect.shape) for effect in result.effects
    )
    mended += [f"{'what was found' if swapped else 'them' if added > 1 else 'it'} in the model"] * bool(added)
    if not mended:
        return []
    falls = f"the gap {how} falls from {number(gap.before)} to {number(gap.after)} deg/hr"
    noise = f"noise alone leaves {number(gap.noise_floor)}"
    if gap.after < _FALLS * gap.before or score is None:
        return [f"With {listed(mended)} {falls}; {noise}."]
    better = float(np.exp(score["after"] - score["before"]))
    scatters = all(effect.acts_on == "scatter" for effect in result.effects if not effect.mends_labels)
    stays = f"It scatters and moves no average: the mean gap stays, {number(gap.after)} deg/hr"
    hardly = f"The mean gap hardly shows it, {number(gap.before)} and {number(gap.after)} deg/hr"
    return [
        f"With {listed(mended)} every rate {how} is {in_times(better)} as probable as before.",
        f"{stays if scatters else hardly}; {noise}.",
    ]


def of_few(draws: int) -> str:
    """Say that a p of so few simulated nights is an estimate where none of these can be told; empty of enough."""
    more = f"it is an estimate that others may not repeat: ask for {round(1.0 / ALPHA)} or more"
    return f" (beyond the most unlike of so few draws {more})" * ((draws + 1) * ALPHA <= 1.0)


def errors_in_words(result: Reconciliation) -> str:
    """Say what every ± is: two things, of one number, where a shape is not settled."""
    unsettled = any(
        of.may_be for effect in result.effects for each in effect.shapes.values() for of in (each, *each.more)
    )
    more = "of a place with every shape as it fits best, of a parameter over all shapes that there may be"
    return f"every ± is one standard error{f': {more}' if unsettled else ''}"


def titled(result: Reconciliation, said: str) -> str:
    """Put its title beside every id of an effect or of a rival that stands alone: a title may have an id in it."""
    titles = {effect.id: effect.title for effect in result.effects}
    titles |= {each.id: each.title for effect in result.effects for each in effect.confusable_with}
    titles = {each: title for each, title in titles.items() if title not in ("", each)}
    alone = rf"(?<![(\w])(?:{'|'.join(map(re.escape, titles))})(?![\w)])"
    return re.sub(alone, lambda each: f"{titles[each[0]]} ({each[0]})", said) if titles else said


def number(value: float | None) -> str:
    """Three significant digits without powers of ten, or a dash."""
    if value is None or not np.isfinite(value):
        return "–"
    if 0.0 < abs(value) < LEAST:
        return f"below {LEAST:.4f}"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def values_off(standing: Mapping[str, Any] | None, gap: Gap) -> list[str]:
    """Say where a model's values do not describe the data though its form, fitted anew, may: nothing for a built-in."""
    noise = max(gap.noise_floor, (standing or {"noise_deg_per_hr": 0.0})["noise_deg_per_hr"])
    if standing is None or not standing["rms_deg_per_hr"] > MISSTATED * noise:
        return []
    off = (
        f"the model's values as they stand are off by {standing['rms_deg_per_hr']:.3g} deg/hr rms, where noise leaves "
        f"{noise:.3g}: they are not this unit's now. The verdict is about its form, with values fitted anew"
    )
    return [off]
