"""Where a bench stands, how level it is, and how well it is known, as its file says it."""

from typing import Annotated

import numpy as np
from pydantic import Field

from hil.campaign import Conditions, FloatArray
from hil.files.strict import Section
from hil.files.units import BiasPerDegree, Degrees, DegreesPerHour, DegreesPerHourPerMinute, Gravities, RandomWalk
from hil.model.earth import Site


class SiteSection(Section):
    """Where the bench stands and how level it is. G2 and G3 are what axes 2 and 3 measure of gravity at rest."""

    latitude: Degrees
    heading: Degrees
    G2: Gravities | None = None
    G3: Gravities | None = None
    axis_2_elevation: Degrees | None = None
    axis_3_elevation: Degrees | None = None

    def _check(self) -> None:
        by_gravity = self.G2 is not None or self.G3 is not None
        by_angle = self.axis_2_elevation is not None or self.axis_3_elevation is not None
        if by_gravity and by_angle:
            raise ValueError("give G2 and G3, or axis_2_elevation and axis_3_elevation, not both")
        if max(abs(self.G2 or 0.0), abs(self.G3 or 0.0)) > 0.5:
            raise ValueError("G2 and G3 are components of a nearly level bench and must be within 0.5 g")
        self.site()  # the remaining limits are the site's own

    def site(self) -> Site:
        """Return the site, which knows gravity and earth rate in the bench frame."""
        if self.G2 is not None or self.G3 is not None:
            return Site.from_gravity(self.latitude, self.heading, self.G2 or 0.0, self.G3 or 0.0)
        return Site(self.latitude, self.heading, self.axis_2_elevation or 0.0, self.axis_3_elevation or 0.0)


class UncertaintySection(Section):
    """What the error budget reckons with: one standard deviation each, by default that of a well set up bench.

    `angle_random_walk` is the noise of the rates (0.12 deg/sqrt(hr) is 0.93 deg/hr over 60 s, Table 1's quiet cells),
    `bias_instability` the part of it that longer averaging does not take away (0.664 of it stays in every average);
    `tilt` how far the bench's level may have moved since it was measured; `accelerometer` the error with which G2 and
    G3 were measured; `heading`, `latitude` and `earth_rate` (each component, beyond those two) what is wrong with W;
    `index` the error of each move of the unit; `drift` a steady drift of each rate during a self-calibration (0.05
    deg/hr/min is a rate random walk of 1 deg/hr/sqrt(hr) over seven minutes); `bias_slope` by how much the biases
    change with temperature (BB at Table 1's cold end: 1.6 deg/hr/degC); `gravity` the local gravity's departure from
    the g in which coefficients are stated.
    """

    angle_random_walk: Annotated[RandomWalk, Field(gt=0.0)] = 0.12
    bias_instability: Annotated[DegreesPerHour, Field(ge=0.0)] = 0.5
    tilt: Annotated[Degrees, Field(ge=0.0)] = 0.0115  # 0.2 mrad
    accelerometer: Annotated[Gravities, Field(ge=0.0)] = 1e-4
    heading: Annotated[Degrees, Field(ge=0.0)] = 0.5
    latitude: Annotated[Degrees, Field(ge=0.0)] = 0.01
    earth_rate: Annotated[DegreesPerHour, Field(ge=0.0)] = 0.01
    index: Annotated[Degrees, Field(ge=0.0)] = 0.0172  # 0.3 mrad
    drift: Annotated[DegreesPerHourPerMinute, Field(ge=0.0)] = 0.05
    bias_slope: Annotated[BiasPerDegree, Field(ge=0.0)] = 1.6
    gravity: Annotated[Gravities, Field(ge=0.0)] = 5e-4

    def of_collects(self, conditions: Conditions) -> FloatArray:
        """Return what the noise of the rates leaves in the averages of collects, deg/hr, (n, c): N / √(T / 3600)."""
        noise = 60.0 * self.angle_random_walk / np.sqrt(conditions.duration_s)
        return np.repeat(noise[:, None], len(conditions.sensor.channels), axis=1)
