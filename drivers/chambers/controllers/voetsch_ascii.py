r"""Vötsch and Weiss chambers over ASCII-2 (`$00I`, `$00E`): VT 4002, VT 4004, VT 7004 and their relatives.

    controller = VoetschAscii(transport, clock, limits=limits)
    chamber = SupervisedChamber(controller, clock, Supervision(limits=limits, safe=safe, celsius_confirmed=True))

One request reads everything: pairs of nominal and actual value, then the digital bits; one writes everything: all
nominal values and all digital bits. What is not ours is written back as it was read. A setpoint works while the start
bit and the bit of the temperature channel are both set. How many values there are, in which order, and what the bits
mean differs from chamber to chamber: `AsciiLayout`, by default that of a VT 4002 (temperature, 5 pairs, 16 bits).

Verified byte-exact (the manual's appendix, with CR): reading `$00I`, the error text `$00F`, starting a program
`$00P0007`. Computed from its tables: writing `$00E` with 16 bits (the printed example has lost the leading 0 of its bit
block), the gradient `$00U` with 10 numbers (its print has lost blanks). `$00Q` acknowledges errors and is never sent.
Inferred: that a gradient of 0 means none, that `$00P0000` with nothing running does no harm, and that a write that is
not carried out is not answered with `0`. The protocol tells neither model nor unit, nor whether a program runs; it has
no timer that stops a chamber left alone, and no limits of its own: the chamber's adjustable temperature limiter is the
second safety layer, set it by hand. Line: 9600 baud, 8N1, CR; TCP port 1080 or 2049 on newer ones. Values in tenths of
°C; reply awaited 1.5 s, pause 0.2 s. Late replies hold old bits: 3 s of listening follow a request without one.
"""

from dataclasses import dataclass

from pydantic import NonNegativeInt, PositiveInt

from drivers.chambers.chamber import ChamberLimits
from drivers.chambers.controller import Controller, ControllerIdentity, ControllerState, Which
from drivers.chambers.setpoints import clamped
from drivers.clock import Clock
from drivers.errors import ProtocolError
from drivers.transports import Transport
from drivers.transports.framing import Terminator, lines
from drivers.transports.lines import LineExchange
from drivers.transports.transport import Timing


@dataclass(frozen=True)
class AsciiLayout:
    """What numbers and bits mean; bits from 0 on the left, the first pair is the air. `ValueError` where impossible."""

    pairs: PositiveInt = 5
    nominal_first: bool = True
    written: PositiveInt = 5  # nominal values in a write
    bits: PositiveInt = 16
    start_bit: NonNegativeInt = 1
    channel_bit: NonNegativeInt | None = 3  # that of the temperature, None where the start bit is enough
    error_bit: NonNegativeInt = 2

    def __post_init__(self) -> None:
        if not 1 <= self.written <= self.pairs:
            raise ValueError(f"written ({self.written}) must be 1 to the number of pairs ({self.pairs})")
        named = [bit for bit in (self.start_bit, self.channel_bit, self.error_bit) if bit is not None]
        if len(set(named)) != len(named) or not all(0 <= bit < self.bits for bit in named):
            raise ValueError(f"start_bit, channel_bit and error_bit must be different bits from 0 to {self.bits - 1}")


class VoetschAscii(Controller):
    """A `Controller` behind ASCII-2. `limits` bound the setpoint too that is written back with a stop."""

    sees_programs = False

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        *,
        limits: ChamberLimits,
        address: int = 0,
        layout: AsciiLayout | None = None,
        terminator: Terminator = "CR",
    ) -> None:
        super().__init__(transport)
        self._limits = limits
        self._layout = layout or AsciiLayout()
        self._address = f"${address:02d}"
        timing = Timing(1.5, pause_after_query_s=0.2, pause_after_command_s=0.2, late_s=3.0)
        self._exchange = LineExchange(transport, clock, device=self.device, framings=lines(terminator), timing=timing)
        self._nominal = [0.0] * self._layout.written
        self._bits = "0" * self._layout.bits

    def identify(self) -> ControllerIdentity:
        """Look whether the reply has the layout of the bench file; neither model nor unit can be asked."""
        self._look()
        return ControllerIdentity(f"ASCII-2, {self._layout.pairs} values, {self._layout.bits} bits")

    def state(self) -> ControllerState:
        """Look at values and bits, and at the error where the error bit is set."""
        temperature, setpoint = self._look()
        runs = all(self._bits[bit] == "1" for bit in self._run_bits())
        failed = self._bits[self._layout.error_bit] == "1"
        alarms = (self._exchange.query(f"{self._address}F", self._error),) if failed else ()
        return ControllerState(temperature, setpoint, "CONSTANT" if runs else "OFF", alarms)

    def write(self, which: Which, value: float) -> None:
        """Send the setpoint, everything else as it was."""
        self._nominal[0] = value
        self._send(self._bits)

    def start(self) -> None:
        self._send(self._with(self._run_bits(), "1"))

    def stop(self, *, off: bool) -> None:
        self._send(self._with([self._layout.start_bit], "0"))

    def end_program(self) -> None:
        self._exchange.command(f"{self._address}P0000", _acknowledged)

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Bound the first channel's gradient, °C/min; False below a tenth, `ProtocolError` unacknowledged."""
        if degC_per_min < 0.1:
            return False
        rate = round(degC_per_min, 1)
        numbers = [rate, rate] + [0.0] * (2 * (self._layout.written - 1))
        text = " ".join(f"{number:06.1f}" for number in numbers)
        if not self._exchange.command(f"{self._address}U {text}", _acknowledged):
            raise ProtocolError(f"{self.device} did not confirm a gradient of {rate:g} °C/min; step it from the host")
        return True

    def _run_bits(self) -> list[int]:
        channel = self._layout.channel_bit
        return [self._layout.start_bit] + ([] if channel is None else [channel])

    def _with(self, bits: list[int], value: str) -> str:
        return "".join(value if place in bits else bit for place, bit in enumerate(self._bits))

    def _send(self, bits: str) -> None:
        values = [clamped(self._nominal[0], self._limits), *self._nominal[1:]]
        text = " ".join(f"{value:06.1f}" for value in values)
        # The error bit is an input: it is written as 0.
        bits = "".join("0" if place == self._layout.error_bit else bit for place, bit in enumerate(bits))
        self._exchange.command(f"{self._address}E {text} {bits}", _acknowledged)
        self._bits = bits

    def _look(self) -> tuple[float, float]:
        """Return the air's actual and nominal value, and keep what the next write must write back."""
        numbers, self._bits = self._exchange.query(f"{self._address}I", self._values)
        nominal, actual = numbers[0::2], numbers[1::2]
        if not self._layout.nominal_first:
            nominal, actual = actual, nominal
        self._nominal = nominal[: self._layout.written]
        return actual[0], nominal[0]

    def _values(self, line: str) -> tuple[list[float], str]:
        *numbers, bits = line.split() or [""]
        layout = self._layout
        try:
            values = [float(number) for number in numbers]
        except ValueError:
            values = []
        if len(values) != 2 * layout.pairs or len(bits) != layout.bits or set(bits) - {"0", "1"}:
            raise ProtocolError(
                f"{self.device} answered {self._address}I with {line!r}: {2 * layout.pairs} numbers and "
                f"{layout.bits} bits were expected; check the layout of this chamber and the line settings"
            )
        return values, bits

    def _error(self, line: str) -> str:
        number, _, text = line.partition(" ")
        if not (len(number) == 2 and number.isdigit()):
            raise ProtocolError(f"{self.device} answered {self._address}F with {line!r}, which is no error")
        return f"error {number}: {text.strip()}" if text.strip() else f"error {number}"


def _acknowledged(line: str) -> bool:
    return line == "0"
