r"""A Watlow F4T with a chamber behind it: its registers as described, and the SCPI port beside them.

    device = SimulatedWatlowF4t(ChamberPlant(), load_box(path))
    scpi = SimulatedF4tScpi(device)
    scpi.receive(b":SOURCE:CLOOP1:RRATE 2.0\n", 0.0)

SCPI settings are not answered, questions are (formats inferred).
"""

from typing import Any

from drivers.simulators.chambers.controller import SimulatedLines
from drivers.simulators.chambers.described import SimulatedRegisterBox
from drivers.transports.framing import lines


class SimulatedWatlowF4t(SimulatedRegisterBox):
    """A `SimulatedDevice`: an F4T."""

    def __init__(self, *described: Any, **settings: Any) -> None:
        self.ramp = {"RSCALE": "HOURS", "RRATE": "0.0", "RACTION": "OFF"}
        super().__init__(*described, **settings)

    def set_ramp(self, name: str, value: str) -> None:
        """Set one of the three things that make a ramp; together they bound the air from the next setpoint on."""
        self.ramp[name] = value
        rate = float(self.ramp["RRATE"]) / (1.0 if self.ramp["RSCALE"] == "MINUTES" else 60.0)
        bound = rate if self.ramp["RACTION"] in ("SETPOINT", "BOTH") else 0.0
        self.plant.ramp_degC_per_min = (bound, bound)


class SimulatedF4tScpi(SimulatedLines):
    """A `SimulatedDevice`: the SCPI port of an F4T, its loop, output and ramp. `unit` is that of communication."""

    def __init__(self, device: SimulatedWatlowF4t, *, unit: str = "C") -> None:
        self._device = device
        self._unit = unit
        super().__init__(device.plant, lines(b"\n"))

    def _condition(self, at_s: float) -> None:
        """Leave the air to the controller itself."""

    def _respond(self, request: str, now_s: float) -> str | None:
        device, request = self._device, request.upper()
        loop, at = request.partition(":SOURCE:CLOOP1:")[2], device.plant.advance(now_s)
        answers = {
            "*IDN?": "Watlow Electric,F4T,SIMULATED,04:07:0012",
            ":UNIT:TEMPERATURE?": self._unit,
            ":UNIT:TEMPERATURE:DISPLAY?": "F" if device.fahrenheit else "C",
            ":OUTPUT1:STATE?": "OFF" if device.mode == "OFF" else "ON",
            ":SOURCE:CLOOP1:PVALUE?": f"{at if self._unit == 'C' else at * 1.8 + 32.0:.1f}",
            ":SOURCE:CLOOP1:SPOINT?": f"{device.setpoint_degC:.1f}",
            ":SOURCE:CLOOP1:ERROR?": "NONE",
            **{f":SOURCE:CLOOP1:{name}?": value for name, value in device.ramp.items()},
        }
        name, _, value = loop.partition(" ")
        if name in device.ramp and value:
            device.set_ramp(name, value)
        return answers.get(request)
