"""What every chamber does once, and one controller's protocol per file in `controllers`."""

from drivers.chambers.catalogue import CHAMBER_DRIVERS, ChamberOptions
from drivers.chambers.chamber import Chamber, ChamberLimits, ChamberReading, SafeState

__all__ = ["CHAMBER_DRIVERS", "Chamber", "ChamberLimits", "ChamberOptions", "ChamberReading", "SafeState"]
