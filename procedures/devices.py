"""The devices of a bench as the procedures hold them."""

from dataclasses import dataclass

from drivers.chambers import Chamber
from drivers.clock import Clock
from drivers.errors import WrongDevice
from drivers.imu.stream import StreamImu
from drivers.positioners.positioner import Positioner
from procedures.pose import PoseTable


@dataclass(frozen=True)
class BenchDevices:
    """One clock, one unit, one chamber, and what moves the unit. Real or simulated: nothing here can tell.

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

    def refuse_undeclared_simulation(self, *answers: str) -> None:
        """Raise `WrongDevice` where a device calls itself simulated on a bench that is said to be real."""
        told = [answer for answer in answers if "simulat" in answer.lower()]
        if told and not self.simulation_declared:
            raise WrongDevice(
                f"a device answers {told[0]!r}, but the bench file has no simulation section; its data would pass for "
                "measurements: copy the simulation section from the bench file that is being simulated"
            )
