"""Auditing a published table of parameters: which of its identities close, by how much, and what would mend them.

    result = audit_table("rd-gc-86-1-table-1")      # a path, or the name of a table that ships
    result.inconsistent                             # the identities that do not close

Nothing is ever corrected: a reading is a candidate for whoever has the page.
"""

from hil.analysis.published.audit import Audit, Finding, audit_table

__all__ = ["Audit", "Finding", "audit_table"]
