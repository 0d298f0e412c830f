"""Whether a night is good: the worst of how it was measured, how it was solved, and whether it is whole."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from hil.campaign import Campaign
from hil.errors import Damaged, InputError
from hil.records.export import campaign_of_night
from hil.solve import RunSolution, solve_campaign
from procedures.verdict import Judgement, Verdict, combine
from procedures.words import counted


def night_solutions(folder: Path) -> tuple[Campaign | None, Sequence[RunSolution]]:
    """Return a night's campaign and what `hil solve` makes of it; nothing where too little is there.

    Raises `Damaged` where its records are not what was written.
    """
    try:
        return (campaign := campaign_of_night(folder)), solve_campaign(campaign)
    except Damaged:
        raise
    except InputError:  # or one that a later version recorded
        return None, ()


def night_verdict(state: str, solutions: Iterable[RunSolution]) -> Judgement:
    """Return the verdict on a night that has ended in `state` (of hil.status/1), with its first reason."""
    in_turn = sorted(solutions, key=lambda each: (each.run, each.sensor))
    judged = [Judgement(each.verdict, f"sensor {each.sensor}, run {each.run}: {each.reason}") for each in in_turn]
    nothing = Judgement(Verdict.INCONCLUSIVE, "nothing was solved")
    whole = max(judged, key=lambda each: each.severity, default=nothing)
    bad = sum(each.verdict is whole.verdict for each in judged)
    if whole.verdict is not Verdict.PASS and bad:
        whole = Judgement(whole.verdict, f"{bad} of {counted(len(judged), 'solution')}; the first is {whole.reason}")
    missing = [] if state == "complete" else [Judgement(Verdict.INCONCLUSIVE, f"it is {state}: something is missing")]
    return combine([whole, *missing], passed="everything that was asked for is there, and measured well")


def of_units(
    judged: Mapping[str, Judgement], in_spec: Mapping[str, Mapping[str, str]]
) -> tuple[Judgement, dict[str, str] | None]:
    """Return the verdict on a night of several units, the worst of theirs, and the worst of what each must be."""
    worst = max(judged, key=lambda unit: judged[unit].severity)
    whole = judged[worst]
    if whole.verdict is not Verdict.PASS:
        alike = [unit for unit, each in judged.items() if each.verdict is whole.verdict]
        whole = Judgement(whole.verdict, f"{counted(len(alike), 'unit')} of {len(judged)}; {worst}: {whole.reason}")
    order = ("in spec", "cannot tell", "out of spec")
    unit = max(in_spec, key=lambda name: order.index(in_spec[name]["verdict"]), default=None)
    if unit is None:
        return whole, None
    alike = [name for name, each in in_spec.items() if each["verdict"] == in_spec[unit]["verdict"]]
    how_many = f"{counted(len(alike), 'unit')} of {len(in_spec)}"
    return whole, {**in_spec[unit], "reason": f"{how_many}; {unit}: {in_spec[unit]['reason']}"}
