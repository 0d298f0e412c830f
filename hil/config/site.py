"""Where a bench stands, and how level it is, as its file says it."""

from __future__ import annotations

from pydantic import model_validator

from hil.files.strict import Section, validated_inside
from hil.files.units import Degrees, Gravities
from hil.model.earth import Site


class SiteSection(Section):
    """Where the bench stands and how level it is. G2 and G3 are what axes 2 and 3 measure of gravity at rest."""

    latitude: Degrees
    heading: Degrees
    G2: Gravities | None = None
    G3: Gravities | None = None
    axis_2_elevation: Degrees | None = None
    axis_3_elevation: Degrees | None = None

    @model_validator(mode="after")
    def _one_description_of_level(self) -> SiteSection:
        by_gravity = self.G2 is not None or self.G3 is not None
        by_angle = self.axis_2_elevation is not None or self.axis_3_elevation is not None
        if by_gravity and by_angle:
            raise ValueError("give G2 and G3, or axis_2_elevation and axis_3_elevation, not both")
        if max(abs(self.G2 or 0.0), abs(self.G3 or 0.0)) > 0.5:
            raise ValueError("G2 and G3 are components of a nearly level bench and must be within 0.5 g")
        self.site()  # the remaining limits are the site's own
        return self

    def site(self) -> Site:
        """Return the site, which knows gravity and earth rate in the bench frame."""
        if self.G2 is not None or self.G3 is not None:
            return Site.from_gravity(self.latitude, self.heading, self.G2 or 0.0, self.G3 or 0.0)
        return Site(self.latitude, self.heading, self.axis_2_elevation or 0.0, self.axis_3_elevation or 0.0)


def site_of(given: object) -> Site:
    """Return the site that a file's section describes; raise `ValueError` with the place of what is wrong."""
    return validated_inside(SiteSection, given).site()
