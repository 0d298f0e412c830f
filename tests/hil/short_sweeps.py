"""Short sweeps for what a test needs a whole night: at room temperature, or at few of the published temperatures."""

from __future__ import annotations

import re
from pathlib import Path

from hil.config import load_sweep


def short_sweep(collect: str = "settle: 5 s, duration: 20 s", self_calibrations: int = 1) -> str:
    """Return the text of a sweep file; `collect` is what stands in its section."""
    return f"""
title: A short night
temperatures: [23 degC]
self_calibrations_per_temperature: {self_calibrations}
positions: [1, 3]
restabilisation: {{at_least: 10 min, window: 5 min, ceiling: 60 min, unit_band: 5 degC, unit_slope: 2 degC/min}}
collect: {{{collect}}}
"""


def published(path: Path, temperatures: str) -> str:
    """Write the published sweep at other temperatures, and return where it is."""
    text = Path(load_sweep("rd-gc-86-1").source).read_text("utf-8")
    path.write_text(re.sub(r"(?m)^temperatures: .*", f"temperatures: [{temperatures}]", text), "utf-8")
    return str(path)
