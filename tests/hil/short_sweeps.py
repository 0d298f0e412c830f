"""A short sweep at room temperature, two positions each time: what a test needs a whole night for."""

from __future__ import annotations


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
