"""Find where simulation and measurement disagree, name the missing effect, add it, and prove that the gap shrank."""

from hil.reconcile.fleet import Screen, SharedFinding, UnitFinding
from hil.reconcile.outcome.page import write_result
from hil.reconcile.result import Disagreement, FoundEffect, Gap, Reconciliation, Rival
from hil.reconcile.workflow import reconcile

__all__ = [
    "Disagreement",
    "FoundEffect",
    "Gap",
    "Reconciliation",
    "Rival",
    "Screen",
    "SharedFinding",
    "UnitFinding",
    "reconcile",
    "write_result",
]
