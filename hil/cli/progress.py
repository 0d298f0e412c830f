"""A running sweep on the terminal, or as plain lines with times where nobody looks at a terminal.

Both go to standard error: standard output belongs to results.
"""

from __future__ import annotations

from datetime import timedelta

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from hil.step_words import hours_minutes, step_in_words
from procedures.journal import Outcome, StepResult
from procedures.plan import Plan, Step, StepKind
from procedures.progress import Progress, Silent, Snapshot


def onlooker(console: Console, *, quiet: bool, simulated: bool) -> TerminalProgress | LineProgress | Silent:
    """Return what suits the console: nothing, a live panel on a terminal, or lines."""
    if quiet:
        return Silent()
    return TerminalProgress(console, simulated=simulated) if console.is_terminal else LineProgress(console)


class LineProgress(Progress):
    """One line for every step that matters, with the campaign's time."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._elapsed_s = 0.0

    def sweep_began(self, plan: Plan, done: frozenset[str]) -> None:
        """Say how much there is to do."""
        rest = f", {len(done)} done before" if done else ""
        self._line(f"{plan.title}: {len(plan.steps)} steps{rest}, {hours_minutes(plan.total_s)} planned")

    def step_began(self, step: Step, attempt: int) -> None:
        """Say only what is done again."""
        if attempt > 1:
            self._line(f"again (attempt {attempt}): {step_in_words(step)}")

    def update(self, snapshot: Snapshot) -> None:
        """Keep the time."""
        self._elapsed_s = snapshot.elapsed_s

    def step_ended(self, step: Step, result: StepResult) -> None:
        """Say what a step came to; indexing is said only when it fails."""
        if step.kind is StepKind.INDEX and result.outcome is Outcome.DONE:
            return
        reason = f" ({result.reason})" if result.reason else ""
        self._line(f"{step_in_words(step)}: {result.outcome.value.lower()}{reason}")

    def event(self, kind: str, message: str) -> None:
        """Say what happened."""
        self._line(f"{kind}: {message}")

    def _line(self, text: str) -> None:
        clock = str(timedelta(seconds=int(self._elapsed_s)))
        self._console.print(f"{clock:>9}  {text}", highlight=False, markup=False, soft_wrap=True)


class TerminalProgress(Progress):
    """A few lines that stay in place: the step, the bar, temperatures, rates, and when it will be finished."""

    def __init__(self, console: Console, *, simulated: bool) -> None:
        self._simulated = simulated
        self._title = ""
        self._snapshot: Snapshot | None = None
        self._console = console
        self._live = Live(console=console, get_renderable=self._render, refresh_per_second=8, transient=True)

    def sweep_began(self, plan: Plan, done: frozenset[str]) -> None:
        """Begin to draw."""
        self._title = plan.title if not done else f"{plan.title} (resumed, {len(done)} steps were done)"
        self._live.start()

    def step_began(self, step: Step, attempt: int) -> None:
        """Nothing to do: the next update shows it."""

    def update(self, snapshot: Snapshot) -> None:
        """Keep the newest state; the panel draws itself."""
        self._snapshot = snapshot

    def step_ended(self, step: Step, result: StepResult) -> None:
        """Leave a line above the panel for what did not go as planned."""
        if result.outcome is not Outcome.DONE:
            self._console.print(f"{step_in_words(step)}: {result.outcome.value}, {result.reason}", markup=False)

    def event(self, kind: str, message: str) -> None:
        """Leave a line above the panel."""
        self._console.print(f"{kind}: {message}", markup=False)

    def close(self) -> None:
        """Stop drawing and give the terminal back."""
        self._live.stop()

    def _render(self) -> Group | Text:
        now = self._snapshot
        if now is None:
            return Text("beginning …")
        mark = "  SIMULATED" if self._simulated else ""
        table = Table.grid(padding=(0, 2))
        table.add_column(style="dim", no_wrap=True)
        table.add_column(overflow="fold")
        bar = ProgressBar(total=max(now.steps_total, 1), completed=now.steps_done, width=40)
        table.add_row("done", bar)
        table.add_row("now", f"{step_in_words(now.step)}{', ' + now.note if now.note else ''}")
        left = f"{hours_minutes(now.step_remaining_s)} to go" if now.step_remaining_s > 0.0 else "longer than planned"
        table.add_row("step", f"{hours_minutes(now.step_elapsed_s)} gone, {left}")
        table.add_row("temperatures", _temperatures(now))
        if now.rates_deg_per_hr:
            rates = now.rates_deg_per_hr.items()
            table.add_row("rates, deg/hr", "  ".join(f"{name} {rate:+.2f}" for name, rate in rates))
        table.add_row("finishing", f"{now.finishing_utc.astimezone():%a %d %b %H:%M}")
        head = Text(f"{self._title}{mark}   {now.steps_done} of {now.steps_total} steps", style="bold")
        return Group(head, table)


def _temperatures(now: Snapshot) -> str:
    parts = []
    if now.chamber_degC is not None:
        target = "" if now.setpoint_degC is None else f" (setpoint {now.setpoint_degC:.1f})"
        parts.append(f"chamber {now.chamber_degC:.1f} °C{target}")
    parts += [f"sensor {number} {value:.1f} °C" for number, value in now.unit_degC.items()]
    return ", ".join(parts) or "not read yet"
