"""What shows inside the collects: tones, settling, ramps, lattices, saturation, bursts, where the campaign has series.

Each test of the catalogue is asked of every collect and channel; the p-values of one effect are combined by the
smallest, corrected for how many were asked, and all effects share the search's rate of false alarms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.campaign import Campaign
from hil.campaign_reader import read_series
from hil.effects.base import SeriesEffect, SeriesFinding


def within_collects(campaign: Campaign, effects: Sequence[SeriesEffect], alpha: float) -> list[dict[str, Any]]:
    """Return what the series show beyond chance, strongest first; empty where the campaign has no series."""
    if not campaign.series_files:
        return []
    found: dict[tuple[str, int, str], list[tuple[int, SeriesFinding]]] = {}
    for number, collects in campaign.sensors.items():
        for collect in collects.conditions.collect.tolist():
            series = read_series(campaign, collect)
            if series is None:
                continue
            for effect in effects:
                if effect.applies_to(collects.conditions.sensor):
                    for finding in effect.test(series, collects.conditions.sensor):
                        found.setdefault((effect.id, number, finding.channel), []).append((collect, finding))
    tests = max(len(found), 1)
    out = []
    for (identifier, number, channel), findings in found.items():
        asked = [(collect, f) for collect, f in findings if np.isfinite(f.p_value)]
        if not asked:
            continue
        collect, strongest = min(asked, key=lambda pair: pair[1].p_value)
        p_value = min(1.0, strongest.p_value * len(asked) * tests)
        if p_value < alpha:
            out.append(
                {
                    "id": identifier,
                    "sensor": number,
                    "channel": channel,
                    "collect": collect,
                    "collects": sum(f.p_value * len(asked) * tests < alpha for _, f in asked),
                    "q_value": p_value,
                    "estimates": dict(strongest.estimates),
                    "sentence": f"Collect {collect}, channel {channel}: {strongest.sentence}",
                }
            )
    return sorted(out, key=lambda item: item["q_value"])
