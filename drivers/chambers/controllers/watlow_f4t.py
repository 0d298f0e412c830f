"""The ramp of a Watlow F4T, which is set over SCPI on a second port; the controller itself is `boxes/watlow-f4t.yaml`.

    scpi = open_port("socket://192.0.2.5:5025", clock=clock)
    controller = WatlowF4t(transport, clock, load_box(path), ramp_port=scpi)
    chamber = SupervisedChamber(controller, clock, Supervision(limits=limits, safe=safe))

SCPI has a unit of its own (`:UNIT:TEMPERATURE?`), which must be °C before a ramp rate is sent. Its mnemonics are those
of a chamber maker's list and of public clients; Byte-exact is none of its replies, whose formats are inferred. No timer
stops a chamber left alone. Port 5025, LF; reply awaited 2 s, and 0.5 s after a setting. Ramp rates in 0.1 °C/min.
"""

from drivers.chambers.controllers.described import SetpointBox
from drivers.chambers.controllers.description import BoxDescription
from drivers.clock import Clock
from drivers.errors import ProtocolError, WrongDevice
from drivers.transports import Transport
from drivers.transports.framing import lines
from drivers.transports.lines import LineExchange
from drivers.transports.transport import Timing


class WatlowF4t(SetpointBox):
    """A `Controller` of loop 1 of an F4T. `ramp_port` is its other port, where the ramp is wanted."""

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        description: BoxDescription,
        *,
        ramp_port: Transport | None = None,
    ) -> None:
        super().__init__(transport, clock, description)
        self._ramp_port = ramp_port
        if ramp_port is not None:
            timing = Timing(pause_after_query_s=0.05, late_s=3.0)
            device = f"chamber on {ramp_port.name}"
            self._scpi = LineExchange(ramp_port, clock, device=device, framings=lines(b"\n"), timing=timing)

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Bound the setpoint's rate; False without SCPI, `WrongDevice` for °F, `ProtocolError` for another rate."""
        if self._ramp_port is None:
            return False
        unit = self._scpi.query(":UNIT:TEMPERATURE?", str.upper)
        if unit != "C":
            raise WrongDevice(f"{self.device} speaks °{unit} over SCPI; set its communication unit to °C at its panel")
        wanted = max(round(degC_per_min, 1), 0.1)
        for command in ("RSCALE MINUTES", f"RRATE {wanted:.1f}", "RACTION SETPOINT"):
            self._scpi.tell(f":SOURCE:CLOOP1:{command}")
        found = self._scpi.query(":SOURCE:CLOOP1:RRATE?", self._number)
        scale, action = (self._scpi.query(f":SOURCE:CLOOP1:{name}?", str.upper) for name in ("RSCALE", "RACTION"))
        if abs(found - wanted) > 0.05 or (scale, action) != ("MINUTES", "SETPOINT"):
            raise ProtocolError(
                f"{self.device} reads back a ramp of {found:g} per {scale} on {action} instead of {wanted:g} per "
                "MINUTES on SETPOINT"
            )
        return True

    def close(self) -> None:
        """Release both ports."""
        super().close()
        if self._ramp_port is not None:
            self._ramp_port.close()

    def _number(self, line: str) -> float:
        try:
            return float(line)
        except ValueError:
            raise ProtocolError(f"{self.device} answered {line!r} where a number was asked for") from None
