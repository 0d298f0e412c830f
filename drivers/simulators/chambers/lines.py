"""Simulated controllers that speak lines of text."""

from abc import abstractmethod
from typing import Any

from drivers.simulators.chambers.controller import Refusal, SimulatedController
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.framing import Framing, Line


class SimulatedLines(SimulatedController):
    """A `SimulatedDevice` whose requests end with `terminator` and whose replies end with `reply_terminator`.

    `framing`, `told_framing` (of commands) and `reply_framing` are what stands around them where that is no terminator.
    A controller answers text with text (`_respond`): None is no reply. Faults know requests by their text.
    """

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        terminator: bytes = b"\r",
        reply_terminator: bytes | None = None,
        framing: Framing | None = None,
        told_framing: Framing | None = None,
        reply_framing: Framing | None = None,
        encoding: str = "ascii",
        **settings: Any,
    ) -> None:
        self._framing = framing or Line(terminator)
        self._told_framing = told_framing or self._framing
        self._reply_framing = reply_framing or Line(reply_terminator or terminator)
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
        try:
            # Of what is told and what is asked the first to end; its check may look like the end of a question.
            both = [each.cut(self._received) for each in (self._told_framing, self._framing)]
            found = max((each for each in both if each is not None), key=lambda each: len(each[1]), default=None)
        except ValueError:  # a damaged frame is not answered
            self._received = b""
            return None
        if found is None:
            return None
        text, self._received = found
        return text

    def _text(self, request: bytes) -> str:
        return request.decode(self._encoding, errors="replace")

    def _name(self, request: bytes) -> str:
        return self._text(request)

    def _carry_out(self, request: bytes, now_s: float) -> bytes:
        return self._line(self._respond(self._text(request), now_s))

    def _refused(self, request: bytes, refusal: Refusal) -> bytes:
        return self._line(self._refuse(self._text(request), refusal))

    def _line(self, reply: str | None) -> bytes:
        return b"" if reply is None else self._reply_framing.packed(reply.encode(self._encoding))

    def _noise(self) -> bytes:
        return self._reply_framing.packed(super()._noise())
