"""Cincinnati Sub-Zero EZT-570i over Modbus RTU.

    controller = Ezt570i(transport, clock)
    chamber = SupervisedChamber(controller, clock, limits=limits, safe=safe, celsius_confirmed=True)

The map is that of loop 1, temperatures signed in tenths of the unit that the panel shows: no register tells the unit,
so a suspicious reading is refused until a person has seen °C. No register tells the model either: what is looked at is
that the controller's registers hang together. Register 0 is 0 while it is offline or under maintenance: its values are
frozen then, and nothing is believed. It answers nothing at all to a wrong register, frame or checksum. Setpoint limits
(64, 65) bound the panel and not the line, which the manual warns of: only the bench's limits hold here. Alarms are
never acknowledged (register 54).

Byte-exact from the vendor's manual, both directions: reading 61, reading 60 and 61, writing 60. Computed from the rule
and the register list: switching the chamber (bit 0 of 22), the alarm words (55 to 59), the limits, stopping a profile
(24). Inferred: that 24 is neither 0 nor 1 while a profile runs, and that bits without a name in 57 are alarms all the
same. Words 55, 56 and 58 have no published bits here and are reported as numbers; 59 is status, no alarm. There is no
ramp for a setpoint without a profile, and no timer that stops a chamber left alone. Line: 9600
baud, 8 data bits, even parity, address 1. At least 0.5 s between exchanges; reply awaited 1.5 s. Limits: 16 bits.
"""

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, NativeLimits, Which
from drivers.clock import Clock
from drivers.errors import ProtocolError
from drivers.transports import Transport
from drivers.transports.modbus import Framing, ModbusExchange, ModbusTiming, scaled, signed

_ONLINE = 0
_EVENTS, _PROFILE = 22, 24
_ALARMS = 55
_SETPOINT = 60
_HIGH_LIMIT, _LOW_LIMIT = 64, 65
_CHAMBER_ON = 0x0001
_CHAMBER_ALARMS = {
    0: "heater high limit",
    1: "external product safety",
    5: "motor overload",
    9: "door open",
    12: "emergency stop",
    13: "power failure",
}


class Ezt570i(Controller):
    """A `Controller` of loop 1 of an EZT-570i."""

    native_limits: NativeLimits = "setpoint"

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        *,
        address: int = 1,
        framing: Framing = "rtu",
    ) -> None:
        super().__init__(transport)
        self._registers = ModbusExchange(
            transport,
            clock,
            device=self.device,
            unit=address,
            framing=framing,
            timing=ModbusTiming(timeout_s=1.5, pause_s=0.5, late_s=3.0),
        )
        self._events = _CHAMBER_ON

    def identify(self) -> ControllerIdentity:
        """Look whether the registers are those of loop 1; the model itself cannot be asked."""
        self._registers.query(_SETPOINT, 6, self._ordered)
        return ControllerIdentity("EZT-570i")

    def state(self) -> ControllerState:
        """Look at loop 1, at the alarms and at what is switched on."""
        self._registers.query(_ONLINE, 1, self._online)
        loop = self._registers.query(_SETPOINT, 6, self._ordered)
        return ControllerState(
            temperature=loop[1] / 10.0,
            setpoint=loop[0] / 10.0,
            mode=self._mode(),
            alarms=_alarms(self._registers.read(_ALARMS, 5)),
            low=loop[5] / 10.0,
            high=loop[4] / 10.0,
        )

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint or one of its limits."""
        address = {"low": _LOW_LIMIT, "setpoint": _SETPOINT, "high": _HIGH_LIMIT}[which]
        self._registers.write(address, scaled(value, 1))

    def start(self) -> None:
        """Switch the chamber on, the other events as they were."""
        self._registers.write(_EVENTS, self._events | _CHAMBER_ON)

    def stop(self, *, off: bool) -> None:
        """Switch the chamber off; it knows no other stop."""
        del off
        self._registers.write(_EVENTS, self._events & ~_CHAMBER_ON)

    def end_program(self) -> None:
        """Stop the profile that runs."""
        self._registers.write(_PROFILE, 0)

    def _online(self, registers: list[int]) -> None:
        if registers[0] == 0:
            raise ProtocolError(
                f"{self.device} is offline or under maintenance, and its values are frozen; bring it online there"
            )

    def _ordered(self, registers: list[int]) -> list[int]:
        loop = [signed(register) for register in registers]
        if loop[5] > loop[4]:
            raise ProtocolError(
                f"{self.device} has a lower setpoint limit above its upper one, which no EZT-570i has; check that the "
                "bench file names the right controller"
            )
        return loop

    def _mode(self) -> Mode:
        events, _, profile = self._registers.read(_EVENTS, 3)
        self._events = events
        if profile not in (0, 1):
            return "RUN"
        return "CONSTANT" if events & _CHAMBER_ON else "OFF"


def _alarms(words: list[int]) -> tuple[str, ...]:
    """Return the names of what stands in registers 55 to 59; the last is status and no alarm."""
    loop, inputs, chamber, refrigeration, _ = words
    named = [_CHAMBER_ALARMS.get(bit, f"chamber alarm bit {bit}") for bit in range(16) if chamber & (1 << bit)]
    others = (("sensor break or loop communication", loop), ("input alarm", inputs), ("refrigeration", refrigeration))
    return (*(f"{name} ({word:#06x})" for name, word in others if word), *named)
