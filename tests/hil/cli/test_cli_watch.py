"""`hil status --watch`: a night from another shell."""

from __future__ import annotations

import io
import re
from datetime import timedelta
from pathlib import Path

import pytest
from rich.console import Console

from drivers.clock import SystemClock, VirtualClock
from hil.cli.app import run
from hil.cli.watch import look_at, say, watch
from hil.records import SqliteJournal
from hil.records.live import LiveFiles
from hil.records.rows import Night
from hil.records.troubles import to_do
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, make_plan
from procedures.progress import Snapshot
from procedures.settings import SweepProcedure


class Shell(VirtualClock):
    """The watching shell's clock: while it sleeps, the night goes on by one entry of a script; then comes Ctrl-C."""

    def __init__(self, *script) -> None:
        super().__init__()
        self._script = list(script)

    def sleep(self, seconds: float) -> None:
        """Let the night go on."""
        if not self._script:
            raise KeyboardInterrupt
        self._script.pop(0)()


@pytest.fixture
def journal(tmp_path: Path):
    """A night that a controller in this process is at work on."""
    plan = make_plan(SweepProcedure(title="Small", temperatures_degC=(20.0,), self_calibrations=1))
    clock = VirtualClock()
    SqliteJournal.create(tmp_path, plan, Night(plan.title, "rk", clock.utc(), True, ""))
    with SqliteJournal.open(tmp_path, clock=clock, who="rk") as opened:
        yield opened


def _shown(journal: SqliteJournal, plan: Plan) -> None:
    files = LiveFiles(journal.folder, {}, every_s=0.0)
    end = journal.began_utc + timedelta(hours=2)
    files.update(Snapshot(plan.steps[1], 1, 20.0, 10.0, 50.0, end, 19.5, 20.0, note="ramping", steps_total=9))
    files.close()


def _console(*, terminal: bool) -> Console:
    return Console(
        file=io.StringIO(), force_terminal=terminal, width=40 if terminal else 200, _environ={"TERM": "xterm"}
    )


def test_a_pipe_gets_a_line_with_the_time_for_every_change_and_no_more(journal: SqliteJournal) -> None:
    """What a log or grep can use: no control characters, nothing twice."""
    first = journal.plan.steps[0]
    (attempt,) = journal.begin(first)
    clock = Shell(
        lambda: None,
        lambda: journal.event("pause", "paused by ann: tea", who="ann", why="tea"),
        lambda: journal.event("continue", "on", who="ann"),
        lambda: journal.end((first, attempt, StepResult(Outcome.DONE, "all there"))),
        lambda: journal.event("prompt", "Bring the unit to position 1", prompt=1, timeout_s=60.0),
    )
    console = _console(terminal=False)
    watch(journal.folder, console, clock)
    lines = console.file.getvalue().splitlines()
    assert "\x1b" not in "".join(lines)
    assert all(line.startswith("1985-10-01T17:00:00Z") for line in lines)
    told = [line.split("  ", 1)[1].strip() for line in lines]
    assert told[0] == "0/10  running SIMULATED: checking who is connected"
    assert told[1].startswith("0/10  paused SIMULATED: checking who is connected: paused by ann: tea")
    assert told[2] == told[0]
    assert told[3] == "1/10  running SIMULATED"
    assert told[4].endswith(
        f"ASKS: Bring the unit to position 1; to do: answer it: hil confirm {journal.folder}, or --no"
    )
    assert len(told) == 5


def test_a_terminal_gets_the_panel_and_its_own_screen_back(journal: SqliteJournal) -> None:
    """The same facts as on the controller's terminal; afterwards the shell is as it was."""
    _shown(journal, journal.plan)
    console = _console(terminal=True)
    watch(journal.folder, console, Shell())
    text = console.file.getvalue()
    assert "chamber 19.5 (setpoint 20.0)" in text
    assert "SIMULATED" in text
    assert "50 s to go" in text
    assert text.rstrip().endswith("\x1b[?25h") or "\x1b[?1049l" in text


def test_a_controller_that_shows_nothing_new_is_told_before_anything_else(
    journal: SqliteJournal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What stands below would otherwise be taken for the present, as on the live page after the same time."""
    for later_s, old in ((3.0, False), (7.0, True)):
        monkeypatch.undo()
        _shown(journal, journal.plan)
        shown_utc = SystemClock().utc()
        monkeypatch.setattr(SystemClock, "utc", lambda _, to=shown_utc + timedelta(seconds=later_s): to)
        console = _console(terminal=True)
        watch(journal.folder, console, Shell())
        text = " ".join(re.sub(r"\x1b\[[0-9;]*m", "", console.file.getvalue()).split())
        assert ("The controller has shown nothing for 7 s." in text) is old


def test_it_ends_when_the_night_does(journal: SqliteJournal) -> None:
    """So that a script can wait for a night; how it ended is in the exit status."""
    folder = journal.folder
    console = _console(terminal=False)
    watch(folder, console, Shell(lambda: None, journal.close))
    assert "incomplete" in console.file.getvalue()


def test_the_command_says_afterwards_what_became_of_the_night(
    journal: SqliteJournal, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit status is that of hil status; a watch for programs is refused."""
    folder = str(journal.folder)
    journal.close()
    assert run(["status", folder, "--watch"]) == 4
    assert "incomplete" in capsys.readouterr().out
    assert run(["status", folder, "--watch", "--json"]) == 2
    assert "one of them" in capsys.readouterr().err
    assert run(["status", f"{folder}/none", "--watch"]) == 2


def test_what_is_wrong_is_said_first_and_in_red_then_what_it_does(journal: SqliteJournal) -> None:
    """The step, temperatures and rates as in the JSON; of what is too long phrases are left out, each whole."""
    _shown(journal, journal.plan)
    journal.begin(journal.plan.steps[1])
    journal.event("interlock-suspected", f"chamber-lost: the chamber does not answer: {'x' * 500} (in 120 s)")
    console = _console(terminal=True)
    console.width, console._highlight = 300, False
    status, now = look_at(journal.folder)
    say(journal.folder, status, now, console)
    first, do, second, *rest = console.file.getvalue().splitlines()
    assert ": running  SIMULATED" in first
    assert "to do: see to it; the controller tries on" in do
    assert second.startswith("\x1b[1;31mPROBLEM: the chamber does not answer: … (in 120 s)")
    assert "since 17:00:00 UTC" in second
    assert "now: chamber to 20.0 °C, ramping" in rest
    assert "°C: chamber 19.5 (setpoint 20.0)" in rest
    assert "operator: rk" in rest
    assert status["readings"]["chamber_degC"] == 19.5


def test_a_chamber_that_is_not_safe_is_the_first_line_and_nothing_is_said_twice(journal: SqliteJournal) -> None:
    """Before the state; what a later line repeats of an earlier one is left out of it."""
    danger, why = "THE CHAMBER IS NOT SAFE: the air stays at 60.0 °C", "standby was acknowledged and is not carried out"
    status = look_at(journal.folder)[0] | {"state": "failed", "reason": f"{why}; {danger}", "missing": [f"end ({why})"]}
    status |= {"problems": [danger], "verdict": {"verdict": "ERROR", "reason": "records"}, "to_do": "go there"}
    console = _console(terminal=False)
    say(journal.folder, status, None, console)
    said = console.file.getvalue().splitlines()
    assert said[:3] == [f"{journal.folder}: {danger}", "to do: go there", f"{journal.folder}: failed, ERROR  SIMULATED"]
    assert [line for line in said if "…" in line] == [f"failed: {why}; …", "missing: end (…)"]
    assert "ERROR: records" in said
    assert said[-1].startswith(f"hil verify {journal.folder} shows it all")


@pytest.mark.parametrize(("state", "told"), [("aborted", False), ("complete", True)])
def test_why_a_night_is_not_judged_is_said_of_one_that_is_whole(journal: SqliteJournal, state: str, told: bool) -> None:
    """Of another one its state says so in fewer words."""
    console, status = _console(terminal=False), look_at(journal.folder)[0]
    status |= {"state": state, "reason": "stopped", "verdict": {"verdict": "INCONCLUSIVE", "reason": "collect missing"}}
    say(journal.folder, status | {"to_do": "read"}, None, console)
    assert f"{state}, INCONCLUSIVE" in console.file.getvalue()
    assert ("INCONCLUSIVE: collect missing" in console.file.getvalue()) is told


@pytest.mark.parametrize(("reason", "told"), [("ERROR: row 3, so nothing can be told", False), ("killed", True)])
def test_a_damaged_journal_counts_no_steps_and_is_not_carried_on(
    journal: SqliteJournal, reason: str, told: bool
) -> None:
    """`hil resume` refuses it: what is said to do is what works."""
    console, status = _console(terminal=False), look_at(journal.folder)[0]
    status |= {"state": "incomplete", "reason": reason, "working": False}
    say(journal.folder, status | {"to_do": to_do(journal.folder, status)}, None, console)
    said = console.file.getvalue()
    assert ("hil resume" in said) is told
    assert (" steps, " in said) is told


@pytest.mark.slow
def test_damaged_samples_leave_no_night_complete(tmp_path: Path) -> None:
    """In words and in the document."""
    assert run(["run", "quick", "--bench", "simulated", "--out", str(tmp_path / "n"), "--quiet"]) == 0
    block = min((tmp_path / "n" / "blocks").glob("*.parquet"))
    block.write_bytes(block.read_bytes()[:-1] + b"x")
    status = look_at(tmp_path / "n")[0]
    assert (status["state"], status["verdict"]["verdict"]) == ("incomplete", "ERROR")


def test_a_cause_of_the_verdict_is_said_whole_or_counted(journal: SqliteJournal) -> None:
    """Nobody can act on a sentence without its middle; those that are not said are counted."""
    cause = f"the residuals are 5.6 times what the standard errors allow ({'p, ' * 80})"
    judged = {"verdict": "FAIL", "reason": f"2 of 8 solutions; the first is {cause}; moved; late"}
    status = look_at(journal.folder)[0] | {"state": "complete", "verdict": judged, "to_do": "look"}
    console = _console(terminal=False)
    console.width = 1000
    say(journal.folder, status, None, console)
    (said,) = [line for line in console.file.getvalue().splitlines() if line.startswith("FAIL: ")]
    assert said == f"FAIL: 2 of 8 solutions; the first is {cause}; and 2 more (hil report says all)"
    judged["reason"] = judged["reason"].removesuffix("; late")
    say(journal.folder, status, None, console)
    assert f"FAIL: {judged['reason']}" in console.file.getvalue()  # to count one takes as long
