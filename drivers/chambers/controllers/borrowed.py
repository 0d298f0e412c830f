"""A chamber that a device of another library drives: pymeasure, ophyd, ophyd-async; limits and safe state stay ours.

    def build(port, clock, options):
        oven = Value(ECO560(adapter), "temperature"), Value(ECO560(adapter), "temperature_setpoint")
        return supervised(BorrowedController(port, *oven, model="ECO560"), clock, options)

Temperatures in °C, or in the `unit` that is said. Nothing here is on a wire: bytes, pauses and time-outs are the
library's. No timer stops a chamber left alone.
"""

from collections.abc import Callable

from drivers.borrowed import Value
from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, Unit, Which
from drivers.transports import Transport


class BorrowedController(Controller):
    """A `Controller` by values of a device: its temperature and its setpoint.

    `running` is true while it conditions, and is set to let it; without one it cannot be stopped over the line.
    `alarms` gives what stands, `close` releases the device. `port` is what the bench file calls it, such as own://oven.
    """

    sees_programs = False

    def __init__(
        self,
        port: Transport,
        temperature: Value,
        setpoint: Value,
        *,
        model: str,
        unit: Unit | None = None,
        running: Value | None = None,
        alarms: Callable[[], tuple[str, ...]] = tuple,
        close: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(port)
        self._temperature, self._setpoint, self._running = temperature, setpoint, running
        self._identity, self._alarms, self._release = ControllerIdentity(model, unit), alarms, close
        self.can_stop = running is not None

    def identify(self) -> ControllerIdentity:
        """Return what was said of it, once it gives a temperature; raise `DeviceError` where it does not."""
        self._temperature.get()
        return self._identity

    def state(self) -> ControllerState:
        conditions = self._running is None or bool(self._running.get())
        temperature, setpoint = float(self._temperature.get()), float(self._setpoint.get())
        mode: Mode = "CONSTANT" if conditions else "OFF"
        return ControllerState(temperature, setpoint, mode, self._alarms(), unit=self._identity.unit)

    def write(self, which: Which, value: float) -> None:
        if which == "setpoint":
            self._setpoint.put(value)

    def start(self) -> None:
        if self._running is not None:
            self._running.put(True)

    def stop(self, *, off: bool) -> None:
        if self._running is not None:
            self._running.put(False)

    def end_program(self) -> None:
        """Do nothing: a device that is driven by its setpoint runs no program."""

    def close(self) -> None:
        self._release()
        super().close()
