"""A running sweep on the terminal, or as plain lines with times where nobody looks at a terminal.

Both go to standard error: standard output belongs to results.
"""

from __future__ import annotations

from datetime import timedelta

from rich.console import Console
from rich.live import Live

from hil.cli.panel import Panel
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, Step, StepKind
from procedures.progress import Progress, Silent, Snapshot
from procedures.words import hours_minutes, step_in_words


def onlooker(console: Console, *, quiet: bool, simulated: bool) -> TerminalProgress | LineProgress | Silent:
    """Return what suits the console: nothing, a live panel on a terminal, or lines."""
    if quiet:
        return Silent()
    drawn = console.is_terminal and not console.is_dumb_terminal
    return TerminalProgress(console, simulated=simulated) if drawn else LineProgress(console)


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
    """A few lines that stay in place: see `hil.cli.panel`."""

    def __init__(self, console: Console, *, simulated: bool) -> None:
        self._simulated = simulated
        self._title = ""
        self._snapshot: Snapshot | None = None
        self._console = console
        self._live = Live(console=console, get_renderable=self._render, refresh_per_second=4, transient=True)

    def sweep_began(self, plan: Plan, done: frozenset[str]) -> None:
        """Begin to draw."""
        self._title = plan.title if not done else f"{plan.title} (resumed, {len(done)} steps were done)"
        self._live.start()

    def update(self, snapshot: Snapshot) -> None:
        """Keep the newest state; the panel draws itself."""
        self._snapshot = snapshot

    def step_ended(self, step: Step, result: StepResult) -> None:
        """Leave a line above the panel for what did not go as planned."""
        if result.outcome is not Outcome.DONE:
            self._say(f"{step_in_words(step)}: {result.outcome.value}, {result.reason}")

    def event(self, kind: str, message: str) -> None:
        """Leave a line above the panel."""
        self._say(f"{kind}: {message}")

    def close(self) -> None:
        """Stop drawing and give the terminal back."""
        self._live.stop()

    def _say(self, text: str) -> None:
        elapsed_s = self._snapshot.elapsed_s if self._snapshot else 0.0
        self._console.print(f"{timedelta(seconds=int(elapsed_s))}  {text}", markup=False, highlight=False)

    def _render(self) -> Panel:
        return Panel(self._title or "beginning …", self._snapshot, simulated=self._simulated)
