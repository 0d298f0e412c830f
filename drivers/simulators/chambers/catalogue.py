"""Every simulated chamber controller, under the name of the driver that speaks to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.chambers.catalogue import SHIPPED, ChamberDriver, Spoken
from drivers.outside import Catalogue
from drivers.simulators.chambers.controller import ChamberFault, SimulatedController
from drivers.simulators.chambers.described import simulated_box
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.chambers.voetsch_ascii import SimulatedVoetschAscii


@dataclass(frozen=True)
class SimulatorOptions(Spoken):
    """What a bench file says about its simulated chamber."""

    faults: tuple[ChamberFault, ...] = ()
    begins_s: float = 0.0


Build = Callable[[ChamberPlant, SimulatorOptions], SimulatedController]


def _box(description: Path | None) -> Build:
    """Return what makes the box of a description, the bench file's own where it has one."""

    def build(plant: ChamberPlant, options: SimulatorOptions) -> SimulatedController:
        path = options.description or description
        if path is None:
            raise ValueError("it has no description, and no simulator of its own")
        return simulated_box(plant, options.box(path), faults=options.faults, begins_s=options.begins_s)

    return build


def _brought(entry: ChamberDriver | str | Path) -> Build:
    """Return the simulator that a distribution brings: its driver's own, or the box of its description."""
    driver = entry if isinstance(entry, ChamberDriver) else None
    return driver.simulator or _box(driver.description) if driver else _box(Path(str(entry)))


_SHIPPED: Mapping[str, Build] = {
    **{name: _box(driver.description) for name, driver in SHIPPED.items()},
    "voetsch-ascii2": lambda plant, o: SimulatedVoetschAscii(
        plant, faults=o.faults, begins_s=o.begins_s, **o.said("address", "terminator", "layout")
    ),
}

CHAMBER_SIMULATORS: Mapping[str, Build] = Catalogue("hil.chambers", _SHIPPED, _brought)
