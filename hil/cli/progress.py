"""A running sweep on the terminal, or as plain lines with times where nobody looks at a terminal.

Both go to standard error: standard output belongs to results. The panel shows the same facts as the live page, down to
40 columns.
"""

from collections.abc import Iterator

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Plan, Step, StepKind
from procedures.progress import Progress, Snapshot
from procedures.words import harmless, hours_minutes, step_in_words

_WIDEST_BAR = 40
_OLD_S = 45.0  # a chamber is asked more often


def onlooker(console: Console, *, quiet: bool, simulated: bool) -> Progress:
    """Return what suits the console: nothing, a live panel on a terminal, or lines."""
    if quiet:
        return Progress()
    drawn = console.is_terminal and not console.is_dumb_terminal
    return TerminalProgress(console, simulated=simulated) if drawn else LineProgress(console)


class LineProgress(Progress):
    """One line for every step that matters, with the campaign's time."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._elapsed_s = 0.0

    def sweep_began(self, plan: Plan, done: frozenset[str]) -> None:
        rest = f", {len(done)} done before" if done else ""
        self._line(f"{plan.title}: {len(plan.steps)} steps{rest}, {hours_minutes(plan.total_s)} planned")

    def step_began(self, step: Step, attempt: int) -> None:
        if attempt > 1:
            self._line(f"again (attempt {attempt}): {step_in_words(step)}")

    def update(self, snapshot: Snapshot) -> None:
        self._elapsed_s = snapshot.elapsed_s

    def step_ended(self, step: Step, result: StepResult) -> None:
        """Say what a step came to; indexing is said only when it fails."""
        if step.kind is StepKind.INDEX and result.outcome is Outcome.DONE:
            return
        reason = f" ({result.reason})" if result.reason else ""
        self._line(f"{step_in_words(step)}: {result.outcome.value.lower()}{reason}")

    def event(self, kind: str, message: str, at_s: float) -> None:
        self._elapsed_s = at_s
        self._line(f"{kind}: {message}")

    def _line(self, text: str) -> None:
        self._console.print(f"{_clock(self._elapsed_s):>9}  {text}", highlight=False, markup=False, soft_wrap=True)


class TerminalProgress(Progress):
    """A few lines that stay in place: a `panel`."""

    def __init__(self, console: Console, *, simulated: bool) -> None:
        self._title = "beginning …"
        self._snapshot: Snapshot | None = None
        self._console = console
        self.drawn = lambda: panel(self._title, self._snapshot, simulated=simulated)
        self._live = Live(console=console, get_renderable=self.drawn, refresh_per_second=4, transient=True)

    def sweep_began(self, plan: Plan, done: frozenset[str]) -> None:
        self._title = plan.title if not done else f"{plan.title} (resumed, {len(done)} steps were done)"
        self._live.start()

    def update(self, snapshot: Snapshot) -> None:
        self._snapshot = snapshot

    def step_ended(self, step: Step, result: StepResult) -> None:
        if result.outcome is not Outcome.DONE:
            at_s = self._snapshot.elapsed_s if self._snapshot else 0.0
            self._say(f"{step_in_words(step)}: {result.outcome.value}, {result.reason}", at_s)

    def event(self, kind: str, message: str, at_s: float) -> None:
        self._say(f"{kind}: {message}", at_s)

    def close(self) -> None:
        """Stop drawing and give the terminal back."""
        self._live.stop()

    def _say(self, text: str, at_s: float) -> None:
        self._console.print(f"{_clock(at_s)}  {text}", markup=False, highlight=False)


def panel(headline: str, now: Snapshot | None, trouble: str = "", *, simulated: bool) -> Group:
    """Return what there is to see at one moment: `headline` (title, state), `trouble` in words, what goes on `now`."""
    head = Text(harmless(headline), style="bold")
    if simulated:
        head.append("  SIMULATED", style="bold magenta")
    parts: list[Text | Table] = [head]
    if trouble:
        parts.append(Text(harmless(trouble), style="bold red"))
    if now is not None:
        table = Table.grid(padding=(0, 2), pad_edge=False)
        table.add_column(style="dim", no_wrap=True)
        table.add_column(overflow="fold")
        table.add_row("done", ProgressBar(total=max(now.steps_total, 1), completed=now.steps_done, width=_WIDEST_BAR))
        table.add_row("", f"{now.steps_done} of {now.steps_total} steps")
        for label, text in rows(now):
            table.add_row(label, Text(harmless(text)))
        parts.append(table)
    return Group(*parts)


def _clock(seconds: float) -> str:
    """Return h:mm:ss, however many hours."""
    minutes, s = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{s:02}"


def rows(now: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the name and the words of everything that a night shows at one moment."""
    again = f" (attempt {now.attempt})" if now.attempt > 1 else ""
    yield "now", f"{step_in_words(now.step)}{again}{', ' + now.note if now.note else ''}"
    left = f"{hours_minutes(now.step_remaining_s)} to go" if now.step_remaining_s > 0.0 else "longer than planned"
    yield "step", f"{hours_minutes(now.step_elapsed_s)} gone, {left}"
    yield "end", f"{now.finishing_utc.astimezone():%a %d %b %H:%M}"
    yield "°C", _temperatures(now)
    rates = now.rates_deg_per_hr or now.rates_now_deg_per_hr
    if rates:
        yield "deg/hr", ", ".join(_rate(label, mean, now) for label, mean in rates.items())
    yield "stream", _stream(now)


def _temperatures(now: Snapshot) -> str:
    parts = []
    if now.chamber_degC is not None:
        target = "" if now.setpoint_degC is None else f" (setpoint {now.setpoint_degC:.1f})"
        old = now.chamber_age_s or 0.0
        late = f", {hours_minutes(old)} old" if old > _OLD_S else ""
        parts.append(f"chamber {now.chamber_degC:.1f}{target}{late}")
    parts += [f"sensor {number} {value:.1f}" for number, value in now.unit_degC.items()]
    return ", ".join(parts) or "not read yet"


def _rate(label: str, mean: float, now: Snapshot) -> str:
    error = now.rates_se_deg_per_hr.get(label) if now.rates_deg_per_hr else None
    # The space within one rate must not break, or the error stands alone on the next line.
    return f"{label}\u00a0{mean:+.2f}" + ("" if error is None else f"\u00a0±\u00a0{error:.2f}")


def _stream(now: Snapshot) -> str:
    counts = now.stream
    damaged = counts.bad_checksum + counts.bad_delimiter + counts.unknown_id
    if counts.lost + damaged + counts.overflow_bytes == 0:
        return f"every frame arrived ({counts.ok})"
    unread = f", {counts.overflow_bytes} bytes unread" if counts.overflow_bytes else ""
    return f"{counts.ok} good, {counts.lost} lost, {damaged} damaged{unread}"
