"""Units of one layout, some with a fault, and the folder of a fleet that several tests screen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hil.campaign import Campaign
from hil.campaign.writer import write_campaign
from tests.hil.reconcile.hidden_effects import EIGHT, base_rates, both, campaign_of, lay_out, noise

ROWS = lay_out(np.random.default_rng(0), EIGHT[::2], 3)
FAULTY = (3, 9)
MODEL = ("--model", "matrix-6-thermal")
SHORT = lay_out(np.random.default_rng(0), (-20.0, 0.0, 20.0, 40.0), 3)


def unit(i: int, size: float = 0.0) -> Campaign:
    """One unit with a supply effect of this size."""
    made = campaign_of(
        ROWS, base_rates(ROWS) + noise(ROWS, np.random.default_rng(i)) + both(ROWS.supply - 28.0, size, -size)
    )
    return replace(
        made, title=f"unit {i}", source=f"bench 2, 2024-{1 + i % 12:02d}-15", identity={"serial": f"A{i:03d}"}
    )


def written_fleet(folder: Path) -> Path:
    """Fourteen units, two with a fault; one with a rate missing, two of other layouts, one that is no campaign."""
    for i in range(14):
        write_campaign(unit(i, 20.0 * (i in FAULTY)), folder / f"u{i:02d}")
    rates = unit(20).sensors[2].rates_deg_per_hr.copy()
    rates[5, 0] = np.nan
    holed = replace(unit(20).sensors[2], rates_deg_per_hr=rates)
    write_campaign(replace(unit(20), sensors={2: holed}), folder / "v-holed")
    other = campaign_of(SHORT, base_rates(SHORT) + noise(SHORT, np.random.default_rng(9)))
    write_campaign(other, folder / "w-other")
    write_campaign(replace(unit(3, 20.0), identity={"serial": "B003"}), folder / "u99")
    (folder / "x-broken").mkdir()
    (folder / "x-broken" / "campaign.yaml").write_text("schema: nonsense\n")
    return folder
