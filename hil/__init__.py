"""The controller: configuration, equation, solver, records, twin, reconcile, report, command line.

In a notebook: `hil.read_night(folder)`, `hil.read_campaign(folder)`, `hil.load_bench(name)`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.notebook import Answer, Measured, Night, Picture, load_bench, read_campaign, read_night

__all__ = ["Answer", "Measured", "Night", "Picture", "load_bench", "read_campaign", "read_night"]


def __getattr__(name: str) -> Any:
    """Return what notebooks use; it is loaded when it is first asked for, so that `import hil` costs nothing."""
    if name not in __all__:
        raise AttributeError(f"module 'hil' has no attribute {name!r}; it has {', '.join(__all__)}, and its packages")
    from hil import notebook

    return getattr(notebook, name)
