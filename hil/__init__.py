"""The controller: configuration, equation, solver, records, twin, reconcile, report, command line.

In a notebook: `hil.read_night(folder)`, `hil.read_campaign(folder)`, `hil.load_bench(name)`.
"""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.cli.notebook import Answer, Measured, Night, Picture, load_bench, read_campaign, read_night

__all__ = ["Answer", "Measured", "Night", "Picture", "load_bench", "read_campaign", "read_night"]


def _refuse_others_floors() -> None:
    """Say so where `drivers` or `procedures` is somebody else's: nothing below would be what it is taken for."""
    ours = Path(__file__).resolve().parents[1]
    for floor in ("drivers", "procedures"):
        spec = find_spec(floor)
        where = Path(spec.origin).resolve().parent if spec is not None and spec.origin else None
        if where != ours / floor:
            sentence = (
                f"hil: the package {floor!r} that Python finds is not hil's own ({where or 'none is installed'}): "
                "start in another folder, or install hil in an environment of its own, as pipx install hil does"
            )
            if Path(*sys.argv[:1]).stem in ("-m", "hil"):  # somebody at a terminal, who needs no traceback
                raise SystemExit(sentence)
            raise ImportError(sentence)


_refuse_others_floors()


def __getattr__(name: str) -> Any:
    """Return what notebooks use; it is loaded when it is first asked for, so that `import hil` costs nothing."""
    if name not in __all__:
        raise AttributeError(f"module 'hil' has no attribute {name!r}; it has {', '.join(__all__)}, and its packages")
    from hil.cli import notebook

    return getattr(notebook, name)
