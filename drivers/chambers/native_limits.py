"""A controller's own limits, the second safety layer: what they shall be, and what they are, beside the setpoint."""

from drivers.chambers.chamber import ChamberLimits
from drivers.chambers.controller import Controller, ControllerState
from drivers.chambers.setpoints import Settings, limits_around


class NativeLimits:
    """Limits `margin_degC` beyond the bench's `limits`, in tenths, of a controller that has such limits or has none."""

    def __init__(self, controller: Controller, limits: ChamberLimits, margin_degC: float) -> None:
        self._controller = controller
        self._margin_degC = margin_degC
        self._usual = ChamberLimits(round(limits.low_degC - margin_degC, 1), round(limits.high_degC + margin_degC, 1))

    def around(self, setpoint_degC: float, present: ControllerState) -> Settings:
        """Return what to write with a setpoint: where a limit raises an alarm, none that the air is still beyond."""
        limits = self._usual
        if self._controller.native_limits == "alarm":
            limits = limits_around(limits, present.temperature, self._margin_degC)
        return Settings(limits.low_degC, setpoint_degC, limits.high_degC)

    def held(self, state: ControllerState) -> Settings:
        """Return what the controller holds; a limit that it does not have is as it should be."""
        low = self._usual.low_degC if state.low is None else state.low
        high = self._usual.high_degC if state.high is None else state.high
        return Settings(low, state.setpoint, high)
