"""The same posterior with next to nothing left out: what an observer with the same prior and likelihood would say.

    python -m benchmarks.blind.score --only singles --engine exhaustive=benchmarks.blind.exhaustive:reconcile

Three times as many sets are grown, three times as far, at four times as many points of the noise, each tried at four
times as many: twenty times the work. Where the quick search says the same, what is lost is not lost in searching.
"""

from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

from hil.campaign import Campaign
from hil.reconcile import Reconciliation
from hil.reconcile import reconcile as quick
from hil.reconcile.search import block_search, likely_noise, posterior, set_in_block, sets

WIDER: dict[Any, dict[str, Any]] = {
    posterior: {"WIDTH": (24, 15, 12, 9, 6), "GROWTH": 30, "PER_NAME": 9, "WORTH": 14.0},
    block_search: {"SCANNED": 40, "GLANCED": 20},
    sets: {"LEADING": 60},
    likely_noise: {"POINTS": 200, "DEPTH": 12.0},
    set_in_block: {"DEPTH": 30.0},
}


def reconcile(campaign: Campaign, model: str, *, alpha: float) -> Reconciliation:
    """Reconcile with everything that bounds the search widened."""
    with ExitStack() as wider:
        for module, constants in WIDER.items():
            wider.enter_context(patch.multiple(module, **constants))
        return quick(campaign, model, alpha=alpha)
