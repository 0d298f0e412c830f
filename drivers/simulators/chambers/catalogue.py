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


def _box(usual: Path | None) -> Build:
    return lambda plant, o: simulated_box(plant, o.box(usual), faults=o.faults, begins_s=o.begins_s)


def _brought(entry: ChamberDriver | str | Path) -> Build:
    if isinstance(entry, ChamberDriver):
        return entry.simulator or _box(entry.description)
    return _box(Path(entry))


_SHIPPED: Mapping[str, Build] = {
    **{name: _box(driver.description) for name, driver in SHIPPED.items()},
    "voetsch-ascii2": lambda plant, o: SimulatedVoetschAscii(
        plant, faults=o.faults, begins_s=o.begins_s, **o.said("address", "terminator", "layout")
    ),
}

CHAMBER_SIMULATORS: Mapping[str, Build] = Catalogue("hil.chambers", _SHIPPED, _brought)
