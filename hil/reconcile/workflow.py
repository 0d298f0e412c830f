"""Find, name, add, prove: the discrepancy workflow on one campaign.

    result = reconcile(read_campaign("my-campaign"), "collins-4")
    result.verdict                       # "named", "ambiguous", "empirical", "unresolved" or "none"
    write_result(result, Path("out"))    # reconciliation.json, model.yaml, reconciliation.html

One posterior over sets of effects, of scatter and of mistakes in the data says what is missing and what it is called.
The rest only reads it: what the model becomes, whether it predicts what it has not seen, where the disagreement was,
and what should be measured next.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.campaign import Campaign
from hil.campaign.plausibility import usable
from hil.campaign.stand_ins import with_stand_ins
from hil.errors import InputError
from hil.model import Model, fitting_campaign
from hil.model.effects.base import Effect, VarianceEffect
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, SERIES_EFFECTS, VARIANCE_EFFECTS
from hil.model.effects.prior import ALPHA
from hil.reconcile.inside import within_collects
from hil.reconcile.naming import Named, Reading, read
from hil.reconcile.outcome.answer import Answer
from hil.reconcile.outcome.shown import shown
from hil.reconcile.proof.held_out import HeldOut, held_out
from hil.reconcile.result import Reconciliation
from hil.reconcile.search.layout import coarse, may_be_calibrated, refined, searches, values_follow
from hil.reconcile.search.posterior import Posterior, beside_lookalikes, served, weigh
from hil.reconcile.search.problem import Problem, as_thermometers_may_be, pose
from hil.solve.wrong_rows import pooled, sound

INSIDE = 0.2  # share of the rate of false alarms that the series' tests have, where there are series
FOLLOW = 5.0  # that the values of a unit follow temperature is so many times as probable as that all of them stand
HOPELESS = 36.0, 21.0
"""What sets are worth so far, this much (log) below what they must be, nothing makes up that is found later.

The first that leads at the noise beside it, and all at noise that is refined beside leading terms.
"""


def reconcile(
    campaign: Campaign,
    model: Model | str,
    *,
    alpha: float = ALPHA,
    catalogue: Sequence[Effect] | None = None,
    scattering: Sequence[VarianceEffect] = VARIANCE_EFFECTS,
    prove: bool = True,
) -> Reconciliation:
    """Compare a campaign with a model, and find, name, add and prove what the model lacks.

    `alpha` is the false-alarm rate of the whole search on data without a missing effect; `prove=False` leaves the
    held-out comparison out (a screening). Raises `InputError` where the model does not fit the campaign.
    """
    if not 0.0 < alpha < 0.5:
        raise InputError(f"alpha {alpha}: the false-alarm rate must lie between 0 and 0.5")
    chosen = fitting_campaign(model, campaign)
    effects = (*BASE_EFFECTS, *EFFECTS) if catalogue is None else tuple(catalogue)
    asked = with_stand_ins(pooled(campaign))
    return shown(campaign, searched(asked, chosen, effects, scattering, alpha, prove=prove))


def searched(
    campaign: Campaign,
    model: Model,
    effects: Sequence[Effect],
    scattering: Sequence[VarianceEffect],
    alpha: float,
    *,
    prove: bool = True,
) -> Answer:
    """Find, name and prove: what is asked, what is probable, what that comes to, its proof, and what that took back.

    The search over averages and the tests inside the collects share `alpha`, the stated rate of false alarms.
    """
    posed = [pose(usable(sound(each)), model, effects) for each in as_thermometers_may_be(campaign)]
    told = [(_likelier(problem, scattering), problem) for problem in posed]
    likeliest, problem = max(told, key=lambda each: each[0].log_evidence)
    posterior = beside_lookalikes(likeliest)
    reading = read(posterior, (1.0 - INSIDE) * alpha if campaign.recorded else alpha)
    proof = held_out(posterior, reading.nothing, reading.found) if prove else None
    reading, reverted = _kept(posterior, reading, proof)
    inside = within_collects(campaign, SERIES_EFFECTS, INSIDE * alpha)
    return Answer(campaign, problem, posterior, reading, proof, reverted, alpha, prove, inside)


def _likelier(problem: Problem, scattering: Sequence[VarianceEffect]) -> Posterior:
    """Weigh what may be missing beside the form's values, or beside values that follow temperature if that is likelier.

    That is a smooth curve with a roughness, of all of the base's values, against as many laws of temperature as the
    form's own need. Nobody asks where they explain nothing.
    """
    stand = coarse(problem, EFFECTS, scattering)
    so_far = weigh(stand, serve=False) if may_be_calibrated(problem) else None
    if so_far is None or not values_follow(problem, so_far, so_far.sets[0]):
        return weigh(refined(problem, stand))
    follow = weigh(searches(problem, EFFECTS, scattering, stand))
    least = follow.log_evidence + np.log(FOLLOW)
    at_first, then = (least - hopeless for hopeless in HOPELESS)
    if served(so_far) < at_first or weigh(refined(problem, stand), serve=False).log_evidence < then:
        return follow
    plain = weigh(stand)
    return plain if plain.log_evidence >= least else follow


def _kept(posterior: Posterior, reading: Reading, proof: HeldOut | None) -> tuple[Reading, Sequence[Named]]:
    """Take back what does not predict held-out rows better, by the log score that serves mean and scatter alike.

    What is wrong with the data without those names stands, and is in what is fitted.
    """
    if not reading.names or proof is None or proof.log_score[1] > proof.log_score[0]:
        return reading, ()
    mended = reading.mended
    return replace(reading, names=(), found=mended, mistakes=posterior.mistakes(mended)), reading.names
