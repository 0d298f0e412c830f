"""Simulated controllers that speak lines of text."""

from abc import abstractmethod
from typing import Any

from drivers.simulators.chambers.controller import Refusal, SimulatedController
from drivers.simulators.chambers.plant import ChamberPlant


class SimulatedLines(SimulatedController):
    """A `SimulatedDevice` whose requests end with `terminator` and whose replies end with `reply_terminator`.

    A controller answers text with text (`_respond`): None is no reply. Faults know requests by their text.
    """

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        terminator: bytes = b"\r",
        reply_terminator: bytes | None = None,
        encoding: str = "ascii",
        **settings: Any,
    ) -> None:
        self._terminator = terminator
        self._reply_terminator = terminator if reply_terminator is None else reply_terminator
        self._encoding = encoding
        super().__init__(plant, **settings)

    @abstractmethod
    def _respond(self, request: str, now_s: float) -> str | None:
        """Return the reply to a request, None for silence; raise `Refusal`."""

    def _refuse(self, request: str, refusal: Refusal) -> str | None:
        """Return the reply to a request that was refused, None for silence."""
        del request, refusal
        return None

    def _next_request(self) -> bytes | None:
        if self._terminator not in self._received:
            return None
        line, self._received = self._received.split(self._terminator, 1)
        return line

    def _text(self, request: bytes) -> str:
        return request.decode(self._encoding, errors="replace").strip()

    def _name(self, request: bytes) -> str:
        return self._text(request)

    def _carry_out(self, request: bytes, now_s: float) -> bytes:
        return self._line(self._respond(self._text(request), now_s))

    def _refused(self, request: bytes, refusal: Refusal) -> bytes:
        return self._line(self._refuse(self._text(request), refusal))

    def _line(self, reply: str | None) -> bytes:
        return b"" if reply is None else reply.encode(self._encoding) + self._reply_terminator

    def _noise(self) -> bytes:
        return super()._noise() + self._reply_terminator
