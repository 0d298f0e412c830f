"""Watlow F4 (F4S, F4D; TestEquity 105 to 115 and 140, Tenney, older ESPEC and CSZ) over Modbus RTU.

    controller = WatlowF4(transport, clock)
    chamber = SupervisedChamber(controller, clock, limits=limits, safe=safe)

The map is that of channel 1. Temperatures are signed registers with as many decimals as register 606 says (0 to 3), in
°C where register 901 is 1 and °F where it is 0: both are read before anything is written, and the unit at every look.
Setpoint limits (602, 603) are the second safety layer; they bound setpoints and raise no alarm. The chamber is
switched by an event output, 1 on TestEquity's; which one is the chamber maker's choice. A static setpoint is ignored
while a profile runs (register 200), so a running profile is a refusal, and is ended (1217) only for the safe state.

Byte-exact from published frames: reading registers (request of 100 and of 0, exception replies 1, 2 and 3). Computed
from the rule and checked against independent Modbus clients and servers: everything else that is sent, replies
included. Inferred from the family's register lists: 101 (input error), 102 (alarm 1 status; 106 is documented). There
is no ramp rate for a static setpoint: the host steps it. No timer stops a chamber left alone: a profile can end by
itself, but a static setpoint is ignored while one runs. Line: 8N1, 9600 (TestEquity) or 19200 baud, address 1. Pause
30 ms, reply awaited 1 s; a frame with a wrong checksum is answered with silence. Limits of values: a 16-bit register.
"""

from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Mode, NativeLimits, Unit, Which
from drivers.clock import Clock
from drivers.errors import ProtocolError, WrongDevice
from drivers.transports import Transport
from drivers.transports.modbus import Framing, ModbusExchange, ModbusTiming, scaled, signed

_MODEL = 5270
_INPUTS = 100  # 100 value, 101 error, 102 alarm 1 … 106 alarm 2
_MODE = 200
_SETPOINT = 300
_LOW_LIMIT, _HIGH_LIMIT = 602, 603
_DECIMALS, _UNITS_TYPE = 606, 608
_UNITS = 901
_EVENT_1, _EVENT_STRIDE = 2000, 10
_TERMINATE = 1217


class WatlowF4(Controller):
    """A `Controller` of channel 1 of an F4.

    `enable_event` is the event output that switches the chamber, None where the line cannot switch it: it is then taken
    to be on. Raises `ValueError` where there is no such output (they are 1 to 8).
    """

    native_limits: NativeLimits = "setpoint"

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        *,
        address: int = 1,
        enable_event: int | None = 1,
        framing: Framing = "rtu",
        timing: ModbusTiming | None = None,
    ) -> None:
        if enable_event is not None and not 1 <= enable_event <= 8:
            raise ValueError(f"an F4 has event outputs 1 to 8, not {enable_event}")
        super().__init__(transport)
        self.can_stop = enable_event is not None
        self._enable = None if enable_event is None else _EVENT_1 + _EVENT_STRIDE * (enable_event - 1)
        self._registers = ModbusExchange(
            transport, clock, device=self.device, unit=address, framing=framing, timing=timing
        )
        self._decimals: int | None = None

    def identify(self) -> ControllerIdentity:
        """Read model number, decimals and unit; raise `WrongDevice` where it is no F4 or measures no temperature."""
        model = self._registers.read(0, 1)[0]
        if model != _MODEL:
            raise WrongDevice(
                f"{self.device} has model number {model}, an F4 has {_MODEL}; check the cable and the bench file"
            )
        if self._registers.read(_UNITS_TYPE, 1)[0] != 0:
            raise WrongDevice(f"{self.device} measures no temperature on channel 1; set its input up at its panel")
        self._decimals = None
        self._places()
        return ControllerIdentity("F4", self._unit())

    def state(self) -> ControllerState:
        """Look at inputs, alarms, mode, setpoint, limits and unit."""
        places = self._places()
        inputs = self._registers.read(_INPUTS, 7)
        setpoint = self._registers.read(_SETPOINT, 1)[0]
        low, high = self._registers.read(_LOW_LIMIT, 2)
        step: float = 10.0**-places
        return ControllerState(
            temperature=round(signed(inputs[0]) * step, places),
            setpoint=round(signed(setpoint) * step, places),
            mode=self._mode(),
            alarms=_alarms(inputs),
            low=round(signed(low) * step, places),
            high=round(signed(high) * step, places),
            unit=self._unit(),
        )

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint or one of its limits."""
        address = {"low": _LOW_LIMIT, "setpoint": _SETPOINT, "high": _HIGH_LIMIT}[which]
        self._registers.write(address, scaled(value, self._places()))

    def start(self) -> None:
        """Switch the chamber on."""
        if self._enable is not None:
            self._registers.write(self._enable, 1)

    def stop(self, *, off: bool) -> None:
        """Switch the chamber off; an F4 knows no other stop."""
        del off
        if self._enable is not None:
            self._registers.write(self._enable, 0)

    def end_program(self) -> None:
        """End the profile that runs."""
        self._registers.write(_TERMINATE, 1)

    def _places(self) -> int:
        """Return the decimals of channel 1; asked once, because a wrong guess is a setpoint ten times off."""
        if self._decimals is None:
            decimals = self._registers.query(_DECIMALS, 1, self._known_decimals)
            self._decimals = decimals
            # What reaches the wire is in the panel's step; a finer one than 0.1 °C means nothing to a chamber.
            self.resolution_degC = max(10.0**-decimals, 0.1)
        return self._decimals

    def _known_decimals(self, registers: list[int]) -> int:
        if not 0 <= registers[0] <= 3:
            raise ProtocolError(f"{self.device} says that it shows {registers[0]} decimals; it can show 0 to 3")
        return registers[0]

    def _unit(self) -> Unit:
        return self._registers.query(_UNITS, 1, self._known_unit)

    def _known_unit(self, registers: list[int]) -> Unit:
        if registers[0] not in (0, 1):
            raise ProtocolError(f"{self.device} says that its unit is {registers[0]}; 0 is °F and 1 is °C")
        return "degC" if registers[0] == 1 else "degF"

    def _mode(self) -> Mode:
        if self._registers.read(_MODE, 1)[0] in (2, 3):
            return "RUN"
        if self._enable is not None and self._registers.read(self._enable, 1)[0] == 0:
            return "OFF"
        return "CONSTANT"


def _alarms(inputs: list[int]) -> tuple[str, ...]:
    words = {1: "input 1 error", 2: "alarm 1", 6: "alarm 2"}
    return tuple(f"{word} ({inputs[place]})" for place, word in words.items() if inputs[place] != 0)
