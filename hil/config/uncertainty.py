"""How well a bench is known: the `uncertainties` section of a bench file, one standard deviation each."""

from typing import Annotated

from pydantic import Field

from hil.files.strict import Section
from hil.files.units import BiasPerDegree, Degrees, DegreesPerHour, DegreesPerHourPerMinute, Gravities, RandomWalk


class UncertaintySection(Section):
    """What the error budget reckons with. What a file does not give is what is usual for a well set up bench.

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
