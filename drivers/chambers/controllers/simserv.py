"""What `boxes/simserv.yaml` cannot say of S!MPAC SimServ: alarms are texts in a list of messages, gradients are two.

    controller = SimServ(transport, clock, load_box(path))      # transport: open_port("socket://192.0.2.2:2049", ...)
    chamber = SupervisedChamber(controller, clock, Supervision(limits=limits, safe=safe))

Computed from the clients that the description names, and inferred as it says. No timer stops a chamber left alone.
Gradients 0.01 to 5 °C/min up and to 3.5 down; pauses and time-outs are those of the description.
"""

from dataclasses import replace

from drivers.chambers.controller import ControllerState
from drivers.chambers.controllers.described import SetpointBox
from drivers.chambers.controllers.description import Number, Quantity, Question

_ALARM_MESSAGE = 1
_GRADIENTS = (("11068", "11066", 5.0), ("11072", "11070", 3.5))  # set and asked, up and down; the fastest


class SimServ(SetpointBox):
    """A `Controller` behind SimServ: control variable 1 is the air's temperature."""

    def state(self) -> ControllerState:
        """Look as described, and at the messages where there is an alarm."""
        state = super().state()
        return replace(state, alarms=self._messages() or state.alarms) if state.alarms else state

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Bound the gradients up and down, no faster than it can; raise `ProtocolError` where others are read back."""
        for told, asked, fastest in _GRADIENTS:
            gradient = Quantity(
                ask=f"{asked}¶1¶1", reply="1¶{value}", send=f"{told}¶1¶1¶{{value:g}}", confirm=("1",), step=0.01
            )
            self._set(gradient, max(round(min(degC_per_min, fastest), 2), 0.01))
        return True

    def _messages(self) -> tuple[str, ...]:
        """Return the texts of the alarms that are active."""
        found = []
        for number in range(1, self._number("17002¶1") + 1):
            if self._number(f"17005¶1¶{number}") == _ALARM_MESSAGE and self._number(f"17009¶1¶{number}") == 1:
                text = Question(ask=f"17007¶1¶{number}", reply="1¶{value}")
                found.append(self._ask([text])[id(text)])
        return tuple(found)

    def _number(self, ask: str) -> int:
        question = Number(ask=ask, reply="1¶{value}")
        return int(self._ask([question])[id(question)])
