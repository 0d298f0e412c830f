r"""A Watlow F4T with a chamber behind it: its registers as described, and the SCPI port beside them.

    device = SimulatedWatlowF4t(ChamberPlant(), load_box(path))
    scpi = SimulatedF4tScpi(device)
    scpi.receive(b":SOURCE:CLOOP1:RRATE 2.0\n", 0.0)

SCPI settings are not answered, questions are (formats inferred).
"""

from typing import Any

from drivers.simulators.chambers.described import SimulatedRegisterBox


class SimulatedWatlowF4t(SimulatedRegisterBox):
    """A `SimulatedDevice`: an F4T."""

    def __init__(self, *described: Any, **settings: Any) -> None:
        self.ramp = {"RSCALE": "HOURS", "RRATE": "0.0", "RACTION": "OFF"}
        super().__init__(*described, **settings)

    def set_ramp(self, name: str, value: str) -> None:
        """Set one of the three things that make a ramp; together they bound the air from the next setpoint on."""
        self.ramp[name] = value
        rate = float(self.ramp["RRATE"]) / (1.0 if self.ramp["RSCALE"] == "MINUTES" else 60.0)
        works = self.ramp["RACTION"] in ("SETPOINT", "BOTH")
        self._bound_ramp(rate if works else 0.0, rate if works else 0.0)


class SimulatedF4tScpi:
    """A `SimulatedDevice`: the SCPI port of an F4T, as far as its ramp goes. `unit` is that of communication."""

    def __init__(self, device: SimulatedWatlowF4t, *, unit: str = "C", latency_s: float = 0.05) -> None:
        self._device = device
        self._unit = unit
        self._latency_s = latency_s
        self._line = b""
        self._pending: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, now_s: float) -> None:
        """Take lines; questions are answered."""
        self._line += data
        while b"\n" in self._line:
            line, self._line = self._line.split(b"\n", 1)
            reply = self._respond(line.decode("ascii", errors="replace").strip().upper())
            if reply is not None:
                self._pending.append((now_s + self._latency_s, reply.encode("ascii") + b"\n"))

    def transmit(self, now_s: float) -> bytes:
        """Return the replies that are due."""
        due = b"".join(reply for at_s, reply in self._pending if at_s <= now_s + 1e-9)
        self._pending = [(at_s, reply) for at_s, reply in self._pending if at_s > now_s + 1e-9]
        return due

    def next_transmission(self, now_s: float) -> float | None:
        """Return when the next reply is due, None where none is."""
        return max(now_s, self._pending[0][0]) if self._pending else None

    def _respond(self, request: str) -> str | None:
        if request == "*IDN?":
            return "Watlow Electric,F4T,SIMULATED,04:07:0012"
        if request == ":UNIT:TEMPERATURE?":
            return self._unit
        name, _, value = request.removeprefix(":SOURCE:CLOOP1:").partition(" ")
        ramp = self._device.ramp
        if name.endswith("?") and name[:-1] in ramp:
            return ramp[name[:-1]]
        if name in ramp and value:
            self._device.set_ramp(name, value)
        return None
