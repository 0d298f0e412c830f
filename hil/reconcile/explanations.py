"""One calibration pursued to its end: is anything missing beside it, what, and what else; and how probable all that is.

The plain calibration (one set of values) is pursued first. Where it needs more than one ordinary name, the same form
calibrated at each temperature is pursued too, and the more probable of the two is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import Campaign, FloatArray
from hil.model import Model
from hil.model.effects.base import Effect
from hil.reconcile.naming import IDEAL, LARGE, Naming, prior_weight, weigh, with_rivals
from hil.reconcile.search.calibration import ONE_SET, PER_TEMPERATURE, log_evidence, may_differ
from hil.reconcile.search.evidence import pruned
from hil.reconcile.search.fit import Added, BlockNoise, estimate_noise
from hil.reconcile.search.hypotheses import build_evidence, hypotheses
from hil.reconcile.search.problem import LEAST_FREEDOM, Problem, pose, rich_columns
from hil.reconcile.search.scan import Scan, Search, level, null_statistics, p_value
from hil.reconcile.search.shapes import between_the_grid
from hil.solve.likelihood import NoiseTable
from hil.solve.rows import is_repeated

_MOST_EFFECTS = 5
_FURTHER = 10.0  # an effect after the first must be as many times rarer by chance
_ROUNDS = 3
_OTHERS = 2  # how often the search is done again without what was odd
_EVEN = 1.0  # log evidence by which what has no name must be ahead of names that explain the same
_TEMPERATURE = "temperature_degC"
CERTAIN = 4.0  # log evidence above the threshold from which a disagreement is called certain


@dataclass(frozen=True)
class Branch:
    """What the search found beside one calibration. `log_evidence` is against the plain calibration alone."""

    calibration: str
    problem: Problem
    search: Search
    first: Scan | None
    threshold: float
    chance: float
    steps: Sequence[Step]
    log_evidence: float = 0.0

    @property
    def is_repeated(self) -> bool:
        """Whether a run can be held out without losing its setpoint altogether."""
        return is_repeated(self.search.blocks)

    @property
    def is_settled(self) -> bool:
        """Whether one name of the catalogue is all that is missing."""
        if len(self.steps) != 1 or self.steps[0].naming.leader.tier != 1:
            return False
        return self.is_repeated or self.steps[0].added.hypothesis.candidate.form == "constant"

    @property
    def is_certain(self) -> bool:
        """Whether what was found is far beyond what noise does."""
        return bool(self.steps) and self.first is not None and self.first.statistic > self.threshold + CERTAIN

    def preferred(self, other: Branch | None) -> Branch:
        """Return this or the other calibration, whichever is more probable.

        Without a second run at any temperature the two rest on different noise and cannot be compared: what changes
        from run to run and what changes with temperature are one. Then the other is kept if it is certain of something.
        """
        if other is None:
            return self
        if not self.is_repeated:
            return other if other.is_certain else self
        if not other.steps and self.is_listed:
            return self
        in_pieces = self.calibrates_in_pieces and other.log_evidence > 0.0 and len(other.steps) < len(self.steps)
        return other if in_pieces or other.log_evidence > self.log_evidence else self

    @property
    def is_listed(self) -> bool:
        """Whether all that was found are effects of the catalogue that follow temperature smoothly or not at all."""
        return all(s.naming.leader.tier == 1 and s.added.hypothesis.candidate.form != "table" for s in self.steps)

    @property
    def calibrates_in_pieces(self) -> bool:
        """Whether the steps only say, one by one, that several parameters have their own value at each setpoint.

        Two parameters or more follow temperature, and one of them at least in no smooth way.
        """
        candidates = [step.added.hypothesis.candidate for step in self.steps]
        follow = {c.target or c.name for c in candidates if c.form != "constant" or _TEMPERATURE in c.driver}
        irregular = any(c.form == "table" or (c.tier == 2 and _TEMPERATURE in c.driver) for c in candidates)
        return irregular and len(follow) > 1


def pursue(problem: Problem, search: Search, alpha: float, draws: int, rng: np.random.Generator) -> Branch:
    """Search beside one calibration."""
    first, threshold, stricter, chance = detect(search, alpha, draws, rng)
    steps: Sequence[Step] = []
    if first is not None and first.statistic > threshold:
        steps, search = find(problem, search, first, stricter)
    return Branch(ONE_SET, problem, search, first, threshold, chance, steps, _weight(search, steps))


def other_calibration(
    plain: Branch,
    campaign: Campaign,
    model: Model,
    effects: Sequence[Effect],
    alpha: float,
    draws: int,
    rng: np.random.Generator,
) -> Branch | None:
    """Pursue the form calibrated at each temperature; None where it cannot or need not be asked about."""
    asked = plain.steps or (not plain.is_repeated and all(block.sigma_stated for block in plain.search.blocks))
    if not asked or plain.is_settled or not may_differ(model, campaign):
        return None
    problem, tables, rich = posed(campaign, model, effects, PER_TEMPERATURE)
    gain = log_evidence(plain.search.blocks, problem.blocks, plain.search.noise, plain.search.rich)
    if gain is None:
        return None
    search = Search(problem.blocks, tables, rich, hypotheses(problem.candidates, problem.blocks))
    found = pursue(problem, search, alpha, draws, rng)
    return replace(found, calibration=PER_TEMPERATURE, log_evidence=found.log_evidence + gain)


def _weight(search: Search, steps: Sequence[Step]) -> float:
    """Log evidence of the steps, one on top of the other, with what each had to pay to be chosen."""
    total, present = 0.0, search
    for step in steps:
        hypothesis = step.added.hypothesis
        evidence = build_evidence([hypothesis], present.blocks, present.noise, present.rich)
        factors, _ = evidence.log_factors([block.y[:, None] for block in present.blocks])
        total += float(factors[0, 0]) + hypothesis.log_prior
        present = present.with_base(joined_columns([step.added], len(present.blocks)))
    return total


def posed(
    campaign: Campaign, model: Model, effects: Sequence[Effect], calibration: str = ONE_SET
) -> tuple[Problem, list[NoiseTable], list[list[FloatArray]]]:
    """Pose the problem, with the noise tables of its blocks and rich models of their means, each (N, p)."""
    problem = pose(campaign, model, effects, calibration)
    rich = [rich_columns(b, campaign.sensors[b.sensor].conditions) for b in problem.blocks]
    tables = [pruned(block, NoiseTable.of(block), extra) for block, extra in zip(problem.blocks, rich, strict=True)]
    return problem, tables, rich


def detect(
    search: Search, alpha: float, draws: int, rng: np.random.Generator
) -> tuple[Scan | None, float, float, float]:
    """Return the first scan, what noise alone exceeds with probability alpha and with alpha/10, and the p-value.

    Whatever noise does, what is less probable than nothing missing is not detected.
    """
    freedom = min(len(b.y) - b.base.shape[1] for b in search.blocks)
    if not search.hypotheses or freedom < LEAST_FREEDOM:
        return None, np.inf, np.inf, 1.0
    scan = search.scan()
    null = null_statistics(scan, search.blocks, draws, rng)
    threshold, stricter = (max(level(null, rate), 0.0) for rate in (alpha, alpha / _FURTHER))
    return scan, threshold, stricter, p_value(null, scan.statistic)


def find(problem: Problem, search: Search, first: Scan, threshold: float) -> tuple[list[Step], Search]:
    """Add what is found, one effect after the other, then look at each again beside all the others.

    `threshold` is for every effect after the first: the first has passed its own. One cause of a size that hardly any
    unit has, or one without a name, may stand in for several ordinary ones: these are looked for as well, and weighed
    against it. Returned with the search that found them, which held-out rows are to repeat.
    """
    explanations = [_one_by_one(problem, search, first, threshold)]
    odd: set[str] = set()
    tiers = {1, 2}
    for _ in range(_OTHERS):
        leaders = [step.naming.leader for step in explanations[-1][0]]
        more = {leader.name for leader in leaders if leader.excess > LARGE or leader.tier == 2} - odd
        tiers = {1} if any(leader.tier == 2 for leader in leaders) else tiers
        odd |= more
        others = replace(search, hypotheses=[h for h in search.hypotheses if h.name not in odd and h.tier in tiers])
        scan = others.scan() if more and others.hypotheses else None
        if scan is None or scan.statistic <= threshold:
            break
        explanations.append(_one_by_one(problem, others, scan, threshold))
    return _most_probable(search, explanations)


def _most_probable(search: Search, explanations: Sequence[tuple[list[Step], Search]]) -> tuple[list[Step], Search]:
    """The most probable of several explanations, with what the next one has in its place.

    Where names of the catalogue alone explain nearly as much as what has no name, they are it.
    """
    weights = np.array([_plausible_weight(search, steps) for steps, _ in explanations])
    listed = np.array([all(step.naming.leader.tier == 1 for step in steps) for steps, _ in explanations])
    order = np.argsort(-(weights + _EVEN * listed), kind="stable")
    chosen, its_search = explanations[order[0]]
    if len(order) == 1:
        return chosen, its_search
    share = 1.0 / float(np.sum(np.exp(weights - weights[order[0]])))
    return _beside(chosen, explanations[order[1]][0], share), its_search


def _beside(chosen: Sequence[Step], left: Sequence[Step], share: float) -> list[Step]:
    """The more probable of two explanations, its names as probable as it is, the other's names among their rivals."""
    return [replace(step, naming=_beside_another(step.naming, chosen, left, share)) for step in chosen]


def _plausible_weight(search: Search, steps: Sequence[Step]) -> float:
    return _weight(search, steps) + sum(prior_weight(step.naming.leader) for step in steps)


def _beside_another(naming: Naming, chosen: Sequence[Step], left: Sequence[Step], share: float) -> Naming:
    """One name of the chosen explanation, with what the other explanation has in its place."""
    here = {step.naming.leader.name for step in chosen}
    if naming.leader.name in {step.naming.leader.name for step in left}:
        return naming
    instead = [
        replace(step.naming.leader, probability=step.naming.leader.probability * (1.0 - share), overlap=0.0)
        for step in left
        if step.naming.leader.name not in here
    ]
    return with_rivals(naming, share, instead)


def _one_by_one(problem: Problem, search: Search, first: Scan, threshold: float) -> tuple[list[Step], Search]:
    """Add the most probable name, again and again, until nothing more is found; then name each beside the others.

    Returned with the search, which has got the shapes that were found between the points of the grid.
    """
    steps: list[Step] = []
    scan, present = first, search
    while len(steps) < _MOST_EFFECTS and (not steps or scan.statistic > threshold + _left_by(steps)):
        naming = _name(scan, present)
        finer = between_the_grid(naming.leader.added, problem, present.blocks, _noise(scan, present))
        if finer is not None:
            search, present = search.with_hypothesis(finer), present.with_hypothesis(finer)
            scan = present.scan()
            naming = _name(scan, present)
        steps.append(Step(scan, naming))
        present = search.with_base(joined_columns([s.added for s in steps], len(search.blocks)))
        if min(len(b.y) - b.base.shape[1] for b in present.blocks) < LEAST_FREEDOM:
            break
        scan = present.scan()
    return _refined(search, steps, threshold) if len(steps) > 1 else steps, search


def _left_by(steps: Sequence[Step]) -> float:
    """Log evidence that effects of this size leave for another by their columns being only nearly true."""
    return 0.5 * float(np.sum([(IDEAL * step.naming.leader.norm) ** 2 for step in steps]))


def _refined(search: Search, steps: list[Step], threshold: float) -> list[Step]:
    """Name each effect again with the others in the base, and drop what the others made superfluous.

    What was named first may have carried part of another.
    """
    for _ in range(_ROUNDS):
        names = [step.naming.leader.name for step in steps]
        place = 0
        while place < len(steps) and len(steps) > 1:
            others = [s.added for i, s in enumerate(steps) if i != place]
            present = search.with_base(joined_columns(others, len(search.blocks)))
            scan = present.scan()
            if scan.statistic > threshold + _left_by([s for i, s in enumerate(steps) if i != place]):
                steps[place] = Step(scan, _name(scan, present))
                place += 1
            else:
                del steps[place]
        if [step.naming.leader.name for step in steps] == names:
            break
    return steps


def _name(scan: Scan, present: Search) -> Naming:
    return weigh(scan, present.blocks, _noise(scan, present))


def _noise(scan: Scan, present: Search) -> list[BlockNoise]:
    """The noise of every block as the most probable name leaves it."""
    noise = []
    candidate, _ = scan.best(next(iter(scan.shares)))
    columns = joined_columns([Added(candidate, candidate.units)], len(present.blocks))
    for block, table, extra in zip(present.blocks, present.noise, columns, strict=True):
        noise.append(estimate_noise(block if extra is None else block.with_base(extra), table))
    return noise


def joined_columns(added: Sequence[Added], count: int) -> list[FloatArray | None]:
    """Return the columns of several added effects in each block, side by side, (N, p); None where there are none."""
    out: list[FloatArray | None] = [None] * count
    for effect in added:
        for b, columns in enumerate(effect.columns(count)):
            if columns is not None:
                present = out[b]
                out[b] = columns if present is None else np.hstack([present, columns])
    return out


@dataclass(frozen=True)
class Step:
    """One effect that the search found, in the order found."""

    scan: Scan
    naming: Naming

    @property
    def added(self) -> Added:
        """What joined the base."""
        return self.naming.leader.added
