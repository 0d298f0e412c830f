r"""The box of a description with a chamber behind it: it answers as the description says it would.

    device = SimulatedSetpointBox(ChamberPlant(), load_box("configs/chambers/temptronic-ats.yaml"))
    device.receive(b"TEMP?\n", 0.0)
    device.transmit(0.1)                  # b"22.0\n"

It shows whether a description hangs together and how a bench would run with it. It cannot show that a real box answers
like this.
"""

from typing import Any

from drivers.chambers import ChamberLimits
from drivers.chambers.controllers.description import BoxDescription, Command
from drivers.simulators.chambers.lines import SimulatedLines
from drivers.simulators.chambers.plant import ChamberPlant

_TERMINATORS = {"CR": b"\r", "LF": b"\n", "CR LF": b"\r\n"}


class SimulatedSetpointBox(SimulatedLines):
    """A `SimulatedDevice` made from a description. What it does not understand it does not answer."""

    _usual_alarm = "4"

    def __init__(self, plant: ChamberPlant, description: BoxDescription, **settings: Any) -> None:
        self._box = description
        self.ramp_degC_per_min = 0.0
        self.dead_man_s = 0.0
        super().__init__(
            plant,
            terminator=_TERMINATORS[description.terminator],
            reply_terminator=_TERMINATORS[description.reply_terminator or description.terminator],
            **settings,
        )

    def _respond(self, request: str, now_s: float) -> str | None:
        answer = self._answer_to(request, now_s)
        if answer is not None:
            return answer
        self._refuse_if_locked()
        return self._set(request) or self._switch(request)

    def _answer_to(self, request: str, now_s: float) -> str | None:
        box = self._box
        word = next((word for word, mode in box.state.modes.items() if mode == self.mode), "")
        unit = box.unit and (box.unit.fahrenheit if self.fahrenheit else box.unit.celsius)
        answers = [
            (box.identify, f"{box.identify.expect or box.name} SIMULATED"),
            (box.unit, unit or ""),
            (box.temperature, f"{self._air(now_s):.1f}"),
            (box.setpoint, f"{self._shown(self.setpoint_degC):.1f}"),
            (box.low_limit, f"{self._shown(self.limits.low_degC):.1f}"),
            (box.high_limit, f"{self._shown(self.limits.high_degC):.1f}"),
            (box.state, word),
            (box.alarms, self.alarms[0] if self.alarms else box.alarms.none[0]),
            (box.ramp_degC_per_min, f"{self.ramp_degC_per_min:g}"),
            (box.dead_man_s, f"{self.dead_man_s:g}"),
        ]
        for question, value in answers:
            if question is not None and request == question.ask:
                return question.answer(value)
        return None

    def _set(self, request: str) -> str | None:
        box = self._box
        for name, quantity in (
            ("setpoint", box.setpoint),
            ("low", box.low_limit),
            ("high", box.high_limit),
            ("ramp", box.ramp_degC_per_min),
            ("dead_man", box.dead_man_s),
        ):
            if quantity is None or (value := quantity.taken(request)) is None:
                continue
            match name:
                case "setpoint":
                    self.setpoint_degC = self._taken(value)
                case "low":
                    self.limits = ChamberLimits(self._taken(value), self.limits.high_degC)
                case "high":
                    self.limits = ChamberLimits(self.limits.low_degC, self._taken(value))
                case "ramp":
                    self.ramp_degC_per_min = value
                    self._bound_ramp(value, value)
                case _:
                    self.dead_man_s = value
            return quantity.confirm
        return None

    def _switch(self, request: str) -> str | None:
        box = self._box
        commands: list[tuple[Command | None, str]] = [
            (box.start, "CONSTANT"),
            (box.stop, "OFF"),
            (box.standby, "STANDBY"),
            (box.end_program, "OFF"),
        ]
        for command, mode in commands:
            if command is not None and request == command.send:
                self.mode = mode
                return command.confirm
        return None
