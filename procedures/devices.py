"""The devices of a bench as the procedures hold them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from drivers.chambers import Chamber
from drivers.clock import Clock
from drivers.errors import WrongDevice
from drivers.imu.stream import StreamImu
from drivers.positioners.positioner import Positioner
from procedures.pose import PoseTable


@dataclass(frozen=True)
class BenchDevices:
    """One clock, one chamber, and a unit with what moves it. Real or simulated: nothing here can tell.

    `units` are the devices of every unit in the chamber by its name, this one's among them; where nothing is said there
    is this one, without a name. They share clock and chamber, and, where one fixture turns them all, the positioner.

    `simulation_declared` says that the bench file calls its devices simulated. A simulated device says so itself when
    it is asked who it is; one that nobody declared is refused, for its data would pass for measurements. `poses` is
    what the unit's accelerometers should show at each position; None where it has none, or nobody knows.
    """

    clock: Clock
    imu: StreamImu
    chamber: Chamber
    positioner: Positioner
    simulation_declared: bool = True
    poses: PoseTable | None = None
    units: Mapping[str, "BenchDevices"] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.units:
            object.__setattr__(self, "units", {"": self})

    def with_all(self, made: Callable[[Any], Any]) -> "BenchDevices":
        """Return the devices with their chamber and what turns each unit replaced by what is `made` of them."""
        one = made(self.chamber)
        turned = {id(each.positioner): made(each.positioner) for each in self.units.values()}
        units = {
            name: replace(each, chamber=one, positioner=turned[id(each.positioner)], units={})
            for name, each in self.units.items()
        }
        return replace(next(iter(units.values())), units=units)

    def refuse_undeclared_simulation(self, *answers: str) -> None:
        """Raise `WrongDevice` where a device calls itself simulated on a bench that is said to be real."""
        told = [answer for answer in answers if "simulat" in answer.lower()]
        if told and not self.simulation_declared:
            raise WrongDevice(
                f"a device answers {told[0]!r}, but the bench file has no simulation section; its data would pass for "
                "measurements: copy the simulation section from the bench file that is being simulated"
            )
