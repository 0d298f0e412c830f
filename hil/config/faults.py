"""The `faults` of a bench file: what goes wrong on a simulated bench, and when, so that anyone can rehearse it.

    faults:
      - {at: 2 h, device: imu, kind: silence, duration: 10 min}
      - {at: T1/S1/restabilise, device: chamber, kind: alarm}     # as the step begins
      - {at: 95 min, device: imu, kind: corrupted_bytes, size: 0.2, duration: 5 min}

`CATALOGUE` says what there is. `hil.twin.faults` makes it happen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

from pydantic import BeforeValidator, model_validator

from hil.files.strict import Section, near
from hil.files.units import DIFFERENCE, TEMPERATURE, TIME, Kind, to_number

Device = Literal["imu", "chamber", "disk", "clock", "operator", "controller"]

_JUMP = Kind("a time", "second", "-90 s")


def _text(value: object) -> object:
    """A number without its unit is said to be one by `to_number`."""
    return str(value) if isinstance(value, int | float) else value


@dataclass(frozen=True)
class FaultKind:
    """One thing that can go wrong: what it is in words, and what its size is.

    `size` is a kind of quantity, or "share" for a fraction of the frames; None where it has none, and then `usual` is
    meaningless. `lasts` is True for a state, which has a duration, and False for something that happens in a moment.
    """

    means: str
    size: Kind | Literal["share"] | None = None
    usual: float = 0.0
    lasts: bool = True


CATALOGUE: Mapping[Device, Mapping[str, FaultKind]] = {
    "imu": {
        "silence": FaultKind("the stream stops"),
        "corrupted_bytes": FaultKind("a bit is wrong in this share of the frames", "share", 0.5),
        "dropped_bytes": FaultKind("a byte is missing in this share of the frames", "share", 0.5),
        "dropped_frames": FaultKind("this share of the frames never arrives", "share", 0.2),
        "repeated_frames": FaultKind("this share of the frames arrives twice", "share", 0.2),
        "garbage": FaultKind("noise stands before this share of the frames", "share", 0.2),
        "frozen_values": FaultKind("every value stays as it is, counter and checksum go on"),
        "wrong_counter": FaultKind("the frames' counter is five ahead"),
        "exchanged": FaultKind("another unit is put behind its port, which takes 8 s"),
        "spin_fault": FaultKind("a rotor is not at speed, and the status says so"),
        "silent_identity": FaultKind("the unit does not say who it is"),
        "index_refused": FaultKind("an index command only sets the fault bit"),
        "index_never_finishes": FaultKind("a move begins and does not end"),
        "index_wrong_position": FaultKind("a move ends elsewhere"),
        "index_slips": FaultKind("a move is confirmed, but the unit has not turned"),
        "unplugged": FaultKind("the unit's cable is pulled, and put back"),
    },
    "chamber": {
        "silence": FaultKind("requests are lost: nothing is done, nothing answered"),
        "no_reply": FaultKind("requests are carried out, replies are lost"),
        "garbage": FaultKind("replies are noise"),
        "truncated": FaultKind("replies break off"),
        "corrupted_bytes": FaultKind("a bit of every reply is wrong"),
        "late": FaultKind("replies come this late", TIME, 3.0),
        "refused": FaultKind("every command is refused"),
        "alarm": FaultKind("the chamber raises an alarm and stops; at the end somebody acknowledges it"),
        "panel_lock": FaultKind("its panel is locked: what is written is refused"),
        "power_cycle": FaultKind("its power goes, and comes back: stopped, its setpoint forgotten"),
        "fahrenheit": FaultKind("somebody switches its panel to °F"),
        "program": FaultKind("somebody starts a program at its panel", lasts=False),
        "sensor_frozen": FaultKind("its sensor shows the same temperature for ever"),
        "sensor_break": FaultKind("its sensor shows this temperature", TEMPERATURE, -199.9),
        "setpoint_not_followed": FaultKind("compressor and heater are dead"),
        "not_carried_out": FaultKind("acknowledges and shows what it is told, and goes on as it was"),
        "runaway": FaultKind("it conditions, but this far beyond its setpoint", DIFFERENCE, 60.0),
        "unplugged": FaultKind("its cable is pulled, and put back"),
    },
    "disk": {"full": FaultKind("samples and raw bytes cannot be written: no space is left")},
    "clock": {"jump": FaultKind("somebody sets the wall clock by this much", _JUMP, 3600.0, lasts=False)},
    "operator": {
        "no_answer": FaultKind("nobody answers a question"),
        "wrong_position": FaultKind("the unit is laid as in the table's next position, and confirmed"),
    },
    "controller": {"killed": FaultKind("the controller is killed with SIGKILL", lasts=False)},
}


class Fault(Section):
    """One fault. `at` is a time since the night began, or the key of a step as `hil plan --json` shows it.

    `unit` is the serial number of the unit that it happens to; of several it happens to all where none is said.
    """

    at: Annotated[str, BeforeValidator(_text)]
    device: Device
    kind: str
    size: float | str | None = None
    duration: Annotated[str | None, BeforeValidator(_text)] = None
    unit: Annotated[str, BeforeValidator(str)] = ""

    @model_validator(mode="after")
    def _makes_sense(self) -> Fault:
        kinds = CATALOGUE[self.device]
        if self.kind not in kinds:
            raise ValueError(f"kind: {self.kind!r} is nothing that happens to {self.device}{near(self.kind, [*kinds])}")
        if not self.at.strip():
            raise ValueError("at: a time such as 2 h, or a step's key such as T1/S1/restabilise, is needed")
        _ = self.at_s, self.amount
        if self.unit and self.device != "imu":
            raise ValueError(f"unit: what happens to {self.device} happens to no unit; leave it out")
        if self.duration is not None and not self.meaning.lasts:
            raise ValueError(f"duration: {self.kind} happens in a moment; leave the duration out")
        _ = self.duration_s
        return self

    @cached_property
    def amount(self) -> float:
        """The size in s, °C or as a share: the file's, or the usual one; `ValueError` where it cannot be."""
        kind = self.meaning
        if self.size is None:
            return kind.usual
        if kind.size is None:
            raise ValueError(f"size: {self.kind} has no size; leave it out")
        if not isinstance(kind.size, str):
            return to_number(self.size, kind.size)
        if isinstance(self.size, str) or not 0.0 < self.size <= 1.0:
            raise ValueError(f"size: {self.size!r} is not a share of the frames; write a number above 0 and up to 1")
        return float(self.size)

    @cached_property
    def at_s(self) -> float | None:
        """Seconds since the night began; None where it waits for the step `at`."""
        return to_number(self.at, TIME) if self.at[0] in "0123456789+-." else None

    @cached_property
    def duration_s(self) -> float | None:
        """How long it lasts, s; None for the rest of the night."""
        return None if self.duration is None else to_number(self.duration, TIME)

    @property
    def meaning(self) -> FaultKind:
        """What the catalogue says about it."""
        return CATALOGUE[self.device][self.kind]

    def __str__(self) -> str:
        size = "" if self.size is None else f" {self.size}"
        lasts = "" if self.duration is None else f" for {self.duration}"
        return f"{self.device}{f' {self.unit}' if self.unit else ''} {self.kind}{size} at {self.at}{lasts}"
