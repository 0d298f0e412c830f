"""Where the bench stands: gravity and earth rate in the bench frame 1-2-3, from latitude, heading and attitude.

    >>> site = Site(latitude_deg=34.6, heading_deg=30.0)
    >>> site.gravity_g()
    array([1., 0., 0.])
    >>> site.earth_rate_deg_per_hr().round(2)
    array([ 8.54, 10.72,  6.19])

Convention: on a level bench axis 1 points up, axis 2 lies horizontal `heading_deg` clockwise from true north, and
axis 3 = axis 1 × axis 2 completes a right-handed frame, so that W1 = Ω sin L, W2 = Ω cos L cos h, W3 = Ω cos L sin h.
A bench that is not level is described by what a spirit level shows: how far axes 2 and 3 rise above the horizontal.
That turns gravity and earth rate together.

The unit of acceleration is the local gravity: |G| = 1 by definition here, so a coefficient in deg/hr/g is per local g
(9.7803 to 9.8322 m/s² over the Earth, ±0.3 %). G is the acceleration reaction: at rest, +1 along the axis that is up.
The report gives neither its latitude nor its heading nor any G or W; 34.6° is Redstone Arsenal, 30° is an assumption.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray
from hil.campaign.data import EARTH_RATE_DEG_PER_HR


@dataclass(frozen=True)
class Site:
    """Latitude, heading of bench axis 2 (clockwise from true north), and how far axes 2 and 3 rise above level.

    Raises ValueError for a latitude beyond the poles, or elevations that no orthogonal frame can have.
    """

    latitude_deg: float
    heading_deg: float
    axis_2_elevation_deg: float = 0.0
    axis_3_elevation_deg: float = 0.0

    def __post_init__(self) -> None:
        values = (self.latitude_deg, self.heading_deg, self.axis_2_elevation_deg, self.axis_3_elevation_deg)
        if not np.all(np.isfinite(values)) or abs(self.latitude_deg) > 90.0:
            raise ValueError(f"latitude {self.latitude_deg} deg: it must be from -90 to +90, and every angle finite")
        if abs(self.axis_2_elevation_deg) + abs(self.axis_3_elevation_deg) >= 90.0:
            raise ValueError("elevations of axes 2 and 3: together they must stay below 90 deg, or axis 1 is not up")

    @classmethod
    def from_gravity(cls, latitude_deg: float, heading_deg: float, g2_g: float, g3_g: float) -> Site:
        """Describe the attitude by the measured components G2 and G3 in g, such as (0.001, -0.016)."""
        return cls(latitude_deg, heading_deg, float(np.rad2deg(np.arcsin(g2_g))), float(np.rad2deg(np.arcsin(g3_g))))

    def frame(self) -> FloatArray:
        """Return the bench axes as rows in (east, north, up), shape (3, 3); right-handed."""
        heading, rise_2, rise_3 = np.deg2rad([self.heading_deg, self.axis_2_elevation_deg, self.axis_3_elevation_deg])
        level = np.cos(rise_2)
        axis_2 = np.array([level * np.sin(heading), level * np.cos(heading), np.sin(rise_2)])
        steepest = (np.array([0.0, 0.0, 1.0]) - np.sin(rise_2) * axis_2) / level  # as near up as axis 2 allows
        sideways = np.cross(steepest, axis_2)
        sine = np.sin(rise_3) / level
        cosine = np.sqrt(1.0 - sine**2)
        return np.array([cosine * steepest - sine * sideways, axis_2, cosine * sideways + sine * steepest])

    def gravity_g(self) -> FloatArray:
        """Return (G1, G2, G3) in local g, shape (3,)."""
        return np.asarray(self.frame()[:, 2])

    def earth_rate_deg_per_hr(self) -> FloatArray:
        """Return (W1, W2, W3) in deg/hr, shape (3,)."""
        latitude = np.deg2rad(self.latitude_deg)
        return np.asarray(EARTH_RATE_DEG_PER_HR * (self.frame() @ np.array([0.0, np.cos(latitude), np.sin(latitude)])))
