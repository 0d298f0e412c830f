"""Simulated controllers that speak lines of text."""

from abc import abstractmethod
from typing import Any

from drivers.simulators.chambers.controller import Refusal, SimulatedController
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.framing import Framings


class SimulatedLines(SimulatedController):
    """A `SimulatedDevice` that answers text with text (`_respond`). Faults know requests by their text."""

    def __init__(self, plant: ChamberPlant, framings: Framings, **settings: Any) -> None:
        self._framings = framings
        super().__init__(plant, **settings)

    @abstractmethod
    def _respond(self, request: str, now_s: float) -> str | None:
        """Return the reply to a request, None for silence; raise `Refusal`."""

    def _refuse(self, refusal: Refusal) -> str | None:
        """Return the reply to a request that was refused, None for silence."""
        del refusal
        return None

    def _next_request(self) -> bytes | None:
        try:
            # Of what is told and what is asked the first to end; its check may look like the end of a question.
            both = [each.cut(self._received) for each in (self._framings.told, self._framings.asked)]
            found = max((each for each in both if each is not None), key=lambda each: len(each[1]), default=None)
        except ValueError:  # a damaged frame is not answered
            self._received = b""
            return None
        if found is None:
            return None
        text, self._received = found
        return text

    def _text(self, request: bytes) -> str:
        return request.decode(self._framings.encoding, errors="replace")

    def _name(self, request: bytes) -> str:
        return self._text(request)

    def _carry_out(self, request: bytes, now_s: float) -> bytes:
        return self._line(self._respond(self._text(request), now_s))

    def _refused(self, request: bytes, refusal: Refusal) -> bytes:
        del request
        return self._line(self._refuse(refusal))

    def _line(self, reply: str | None) -> bytes:
        return b"" if reply is None else self._framings.replied.packed(reply.encode(self._framings.encoding))

    def _noise(self) -> bytes:
        return self._framings.replied.packed(super()._noise())
