"""What people say of a night for its records: a note, a reason to go on, the serial number of a unit that is silent."""

from collections.abc import Sequence
from dataclasses import dataclass

from hil.bench import LiveBench
from hil.errors import InputError
from hil.files.strict import one_line
from hil.records import SqliteJournal
from procedures.attended import Attendant
from procedures.interlocks import InterlockTripped

_SERIAL_S = 3600.0  # for which the question for a serial number stands


@dataclass(frozen=True)
class Remarks:
    """What whoever begins or carries on a night says for the record: a note, and why they went on despite a NOT.

    `despite` are the findings of `hil check` that were passed over, `why` the reason that was given; `serial` is that
    of a unit of which the night has none yet. Raises `InputError` for what is no line of bearable length.
    """

    note: str = ""
    despite: Sequence[str] = ()
    why: str = ""
    serial: str = ""

    def __post_init__(self) -> None:
        one_line("--note", self.note)
        one_line("--despite", self.why)

    def record(self, journal: SqliteJournal, who: str) -> None:
        """Write down the serial number, and what was passed over; the note stands with the beginning."""
        if self.serial and "serial" not in journal.identity():
            told = f"the serial number of the unit is {self.serial}, as {who} typed it"
            journal.event("unit-serial", told, serial=self.serial, who=who)
        if self.despite:
            told = f"{who} went on despite what hil check called NOT ({'; '.join(self.despite)}): {self.why}"
            journal.event("despite", told, who=who, why=self.why, findings=list(self.despite))


def ask_serial(journal: SqliteJournal, live: LiveBench, attendant: Attendant) -> None:
    """Have somebody type the serial number, unless it is known, before anything moves; else `InterlockTripped`."""
    if not live.bench.asks_serial or "serial" in journal.identity():
        return
    question = f"Type or scan the serial number of the unit ({live.bench.unit.model}): it does not tell its own."
    while True:
        serial, who = attendant.words(question, _SERIAL_S)
        if not serial:
            raise InterlockTripped("serial-number", "nobody typed the unit's serial number; hil run takes --serial")
        try:
            live.bench.of_unit(serial)
        except InputError as error:
            question = f"{error}. Once more: the serial number of the unit?"
        else:
            Remarks(serial=serial).record(journal, who)
            return
