"""What a campaign's own residuals would show of a wrong site: how far latitude and heading may be off unseen.

The earth rate that is subtracted rests on both. In the collects of one heading what is wrong of it looks like bias and
acceleration sensitivity, and leaves no residual.
"""

from collections.abc import Mapping

import numpy as np

from hil.campaign import Campaign
from hil.campaign.data import EARTH_RATE_DEG_PER_HR
from hil.model.effects.geometry import local_frame
from hil.model.effects.setup import EarthRateError
from hil.model.forms import default_form
from hil.solve.identifiability import orthonormal, project_out
from hil.solve.precision import stated_noise

_SIGMAS = 3.0
_LEFT = 1e-3  # of what an error does to the rates, beside the parameters: less is the rounding of f and w


def smallest_seen_deg(campaign: Campaign) -> Mapping[str, float]:
    """Return how large an error of `latitude` and `heading`, deg, must be to show in the residuals; inf where none is.

    Nothing where no earth rate is given, or no latitude.
    """
    latitude = np.deg2rad(campaign.site.get("latitude_deg", np.nan))
    up, north, east = np.eye(3)
    turns = np.stack([np.cos(latitude) * up - np.sin(latitude) * north, np.cos(latitude) * east], -1)
    seen, used = np.zeros(2), False
    for collects in campaign.sensors.values():
        for run in np.unique(collects.conditions.run):
            rows = collects.rows(collects.conditions.run == run)
            sigma = stated_noise(rows)
            if not np.any(local_frame(rows.conditions).north) or not np.isfinite(latitude):
                continue
            used = True
            weights = 1.0 / (np.ones_like(rows.rates_deg_per_hr) if sigma is None else sigma).reshape(-1, 1)
            known = np.isfinite(rows.rates_deg_per_hr).reshape(-1) & np.isfinite(weights[:, 0])
            design = default_form(rows.conditions).columns(rows.conditions).reshape(len(known), -1)
            per_deg = EarthRateError().columns(rows.conditions, None, {}).reshape(len(known), 3) @ turns
            wrong = weights[known] * per_deg[known] * np.deg2rad(EARTH_RATE_DEG_PER_HR)
            left = np.linalg.norm(project_out(orthonormal(weights[known] * design[known]), wrong), axis=0)
            seen += np.where(left > _LEFT * np.linalg.norm(wrong, axis=0), left, 0.0) ** 2
    with np.errstate(divide="ignore"):
        return dict(zip(("latitude", "heading"), (_SIGMAS / np.sqrt(seen)).tolist(), strict=True)) if used else {}
