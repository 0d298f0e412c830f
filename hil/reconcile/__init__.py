"""Find where simulation and measurement disagree, name the missing effect, add it, and prove that the gap shrank."""

from hil.reconcile.outcome.page import write_result
from hil.reconcile.result import Reconciliation
from hil.reconcile.workflow import reconcile

__all__ = ["Reconciliation", "reconcile", "write_result"]
