"""Watlow F4T (F4T and D4T, in newer ESPEC and TestEquity chambers): Modbus TCP or RTU, and SCPI for its ramp.

    controller = WatlowF4t(transport, clock, ramp_port=open_port("socket://192.0.2.5:5025", clock=clock))
    chamber = SupervisedChamber(controller, clock, limits=limits, safe=safe)

Loop 1. Temperatures are floats in two registers, low word first as the factory sets it; choices are numbers with a
name. The unit is that of the panel (1328; °F from the factory) and is read before anything is written, and at every
look. Setpoint limits (2774, 2776) are the second safety layer. The controller is switched by its control mode (2730:
automatic or off). A chamber's own on-off key, where its maker made one, is for a person to press.

Computed from the register list and checked with an independent server: every Modbus frame. The reply formats of SCPI
are inferred; its mnemonics are those of a chamber maker's list. SCPI has a unit of its own (`:UNIT:TEMPERATURE?`),
which must be °C before a ramp rate is sent. No timer stops a chamber left alone. Inferred too: that alarm states other
than 12, 61 and 88 stand, and that the maker's hardware number needs no check. Modbus TCP port 502, RTU 38400 baud 8N1,
unit 1; SCPI port 5025, LF. Pause 30 ms; reply awaited 1 s (SCPI 2 s, and 0.5 s after a setting). Values in 0.1 °C; ramp
rates in 0.1 °C/min.
"""

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, NativeLimits, Unit, Which
from drivers.clock import Clock
from drivers.errors import ProtocolError, WrongDevice
from drivers.transports import Transport
from drivers.transports.lines import LineExchange, LineTiming
from drivers.transports.modbus import Framing, ModbusExchange, ModbusTiming, float_of, registers_of

_TEMPERATURE, _SETPOINT = 2820, 2782
_LOW_LIMIT, _HIGH_LIMIT = 2774, 2776
_MODE_REQUESTED, _MODE_ACTIVE = 2730, 2814
_AUTOMATIC, _OFF = 10, 62
_UNITS = {15: "degC", 30: "degF"}
_ALARM_STATE, _ALARM_STRIDE, _ALARMS = 1356, 100, 4
_NO_ALARM = (12, 61, 88)
_PROFILE_STATE, _PROFILE_RUNS = 16568, (149, 146, 1783)
_PROFILE_ACTION, _TERMINATE = 16566, 148


def _scpi(port: Transport, clock: Clock) -> LineExchange:
    timing = LineTiming(pause_after_query_s=0.05, late_s=3.0)
    return LineExchange(port, clock, device=f"chamber on {port.name}", terminator=b"\n", timing=timing)


class WatlowF4t(Controller):
    """A `Controller` of loop 1 of an F4T. `ramp_port` is its other port, where the ramp is wanted."""

    native_limits: NativeLimits = "setpoint"

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        *,
        address: int = 1,
        framing: Framing = "tcp",
        ramp_port: Transport | None = None,
        timing: ModbusTiming | None = None,
    ) -> None:
        super().__init__(transport)
        self._ramp_port = ramp_port
        self._registers = ModbusExchange(
            transport, clock, device=self.device, unit=address, framing=framing, timing=timing
        )
        self._scpi = None if ramp_port is None else _scpi(ramp_port, clock)

    def identify(self) -> ControllerIdentity:
        """Read hardware number and unit."""
        return ControllerIdentity(f"F4T hardware {self._registers.read(0, 1)[0]}", self._unit())

    def state(self) -> ControllerState:
        """Look at loop 1, its limits, alarms 1 to 4, the profile and the unit."""
        limits = self._registers.read(_LOW_LIMIT, 4)
        return ControllerState(
            temperature=float_of(self._registers.read(_TEMPERATURE, 2)),
            setpoint=float_of(self._registers.read(_SETPOINT, 2)),
            mode=self._mode(),
            alarms=self._alarms(),
            low=float_of(limits[:2]),
            high=float_of(limits[2:]),
            unit=self._unit(),
        )

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint or one of its limits."""
        address = {"low": _LOW_LIMIT, "setpoint": _SETPOINT, "high": _HIGH_LIMIT}[which]
        self._registers.write_several(address, registers_of(value))

    def start(self) -> None:
        """Control automatically."""
        self._registers.write(_MODE_REQUESTED, _AUTOMATIC)

    def stop(self, *, off: bool) -> None:
        """Switch the loop off; there is no other stop."""
        del off
        self._registers.write(_MODE_REQUESTED, _OFF)

    def end_program(self) -> None:
        """End the profile that runs."""
        self._registers.write(_PROFILE_ACTION, _TERMINATE)

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Bound how fast the setpoint moves, and read the rate back; False without the SCPI port.

        Raises `WrongDevice` where SCPI does not speak °C, and `ProtocolError` where another rate is read back.
        """
        if self._scpi is None:
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

    def _mode(self) -> Mode:
        if self._registers.read(_PROFILE_STATE, 1)[0] in _PROFILE_RUNS:
            return "RUN"
        active = self._registers.read(_MODE_ACTIVE, 1)[0]
        if active == _AUTOMATIC:
            return "CONSTANT"
        return "OFF" if active == _OFF else "RUN"  # manual power: something else drives it

    def _alarms(self) -> tuple[str, ...]:
        states = [self._registers.read(_ALARM_STATE + _ALARM_STRIDE * number, 1)[0] for number in range(_ALARMS)]
        return tuple(
            f"alarm {number} (state {state})" for number, state in enumerate(states, 1) if state not in _NO_ALARM
        )

    def _unit(self) -> Unit:
        return self._registers.query(1328, 1, self._known_unit)

    def _known_unit(self, registers: list[int]) -> Unit:
        if registers[0] not in _UNITS:
            raise ProtocolError(f"{self.device} says that its unit is {registers[0]}; 15 is °C and 30 is °F")
        return "degC" if _UNITS[registers[0]] == "degC" else "degF"
