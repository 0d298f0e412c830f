"""The look before anything moves: `hil check`, and the same look, in the same words, before `hil run` and `resume`."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import DeviceError
from hil.cli.answer import Answer
from hil.cli.exit_status import Exit
from hil.cli.output import messages, warn
from hil.errors import InputError

if TYPE_CHECKING:
    from hil.bench.advice import Finding
    from hil.config import Bench, Sweep


def check(target: str, bench: str | None = None, sweep: str | None = None) -> Answer:
    """Look before anything moves: ports, identity, frames, chamber, limits, disk, clock, end; and what to do.

    `hil check BENCH`, `hil check BENCH --sweep SWEEP` and `hil check SWEEP --bench BENCH` are the three forms.
    """
    from hil.bench.assemble import is_missing, ports_of

    asked, on = _bench_and_sweep(target, bench, sweep)
    found = _look(asked, on, Path.cwd())
    good, findings = all(each.good for each in found), [asdict(each) for each in found]
    document = {"schema": "hil.check/1", "good": good, "simulated": on.simulated, "findings": findings}
    status = Exit.DONE if good else Exit.STOPPED_SAFE
    if any(is_missing(port) for _, port in ports_of(on)):
        status = Exit.BAD_INPUT
    return Answer(document, {"bench": on.name, "lines": list(_in_words(found))}, status=status)


def look_first(sweep: Sweep, bench: Bench, folder: Path, despite: str, done: Collection[str] = ()) -> list[str]:
    """Look as `hil check` does, and raise `DeviceError` where it says NOT, unless there is a reason to go on `despite`.

    Return what is gone on despite of, in the words of `hil check`. Raises `InputError` as that does.
    """
    from hil.bench.assemble import check_ports

    check_ports(bench)
    wrong = [each for each in _look(sweep, bench, folder, done) if not each.good]
    for line in _in_words(wrong):
        messages().print(line)
    if wrong and not despite:
        subjects = ", ".join(finding.subject for finding in wrong)
        raise DeviceError(
            f"not begun, and nothing was moved or set, because hil check says NOT: {subjects}; put that right, or give "
            'a reason for the record: --despite "…"'
        )
    return [f"{finding.subject}: {finding.message}" for finding in wrong]


def _look(sweep: Sweep | None, bench: Bench, folder: Path, done: Collection[str] = ()) -> list[Finding]:
    from hil.archive.places import check_usable
    from hil.bench.advice import Finding
    from hil.bench.lock import bench_lock
    from hil.bench.preflight import preflight
    from hil.config.sweep import cautions, check_sweep_against_bench, limits_of

    limits_of(sweep, bench)
    if sweep is not None:
        check_sweep_against_bench(sweep, bench)
        warn(cautions(sweep, bench))
    there = next(above for above in (folder.absolute(), *folder.absolute().parents) if above.is_dir())
    with bench_lock(bench, folder):
        found = list(preflight(sweep, bench, there, done))
    if bench.archive is not None:
        try:
            check_usable(bench.archive)
            found.append(Finding("archive", True, f"{bench.archive}: takes the night up at its end"))
        except InputError as error:
            advice = (
                f"hil archive {bench.archive} --found makes one; a disk that should be there is to be connected first"
            )
            found.append(Finding("archive", False, str(error), "" if bench.archive.exists() else advice))
    return found


def _in_words(findings: Sequence[Finding]) -> Iterator[str]:
    for finding in findings:
        yield f"{'ok  ' if finding.good else 'NOT '} {finding.subject}: {finding.message}"
        if finding.advice:
            yield f"     {'note' if finding.good else 'TO DO'}: {finding.advice}"


def _bench_and_sweep(target: str, bench: str | None, sweep: str | None) -> tuple[Sweep | None, Bench]:
    from hil.config import load_bench, load_sweep

    if bench is not None:
        if sweep is not None:
            raise InputError(
                f"{target} cannot be a third: write hil check BENCH --sweep SWEEP, or hil check SWEEP --bench BENCH"
            )
        return load_sweep(target), load_bench(bench)
    try:
        on = load_bench(target)
    except InputError as error:
        wrong = error
        with suppress(InputError):
            load_sweep(target)
            wrong = InputError(
                f"{target} is a sweep, not a bench; write hil check BENCH --sweep {target}, or hil check {target} "
                "--bench BENCH"
            )
        raise wrong from None
    return (None if sweep is None else load_sweep(sweep)), on
