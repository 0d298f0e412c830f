"""Commands about what the coefficients mean: audit, thermal, allan."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from hil.cli.answer import Answer, Aside
from hil.cli.data import Source, read_source
from hil.cli.exit_status import Exit
from hil.cli.output import check_result_folder, listing
from hil.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_READINGS_SHOWN = 4
_ROUNDING = 1e-9


def quantity(option: str, text: str, convert: Callable[[str], float]) -> float:
    """Return what an option says, by `convert`; raise `InputError` where that raises `ValueError`."""
    try:
        return convert(text)
    except ValueError as error:
        raise InputError(f"{option}: {error}") from None


def sample_rate_hz(text: str | None) -> float | None:
    """Return what --rate says, where it is given; raise `InputError` where it is no rate."""
    from hil.files.columns import is_number
    from hil.files.units import FREQUENCY, to_number

    if text is None:
        return None
    rate_hz = quantity("--rate", f"{text} Hz" if is_number(text) else text, lambda given: to_number(given, FREQUENCY))
    if rate_hz == 0.0:
        raise InputError("--rate: the sample rate must be more than 0 Hz")
    return rate_hz


def allan(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A table (.parquet, .csv, .txt, .npz), a night or a campaign folder.",
        ),
    ],
    channel: Annotated[str | None, typer.Option(help="Which channel or column.")] = None,
    sensor: Annotated[int | None, typer.Option(help="Of a folder: which sensor.")] = None,
    collect: Annotated[int | None, typer.Option(help="Of a folder: one collect; default: all of them.")] = None,
    rate: Annotated[str | None, typer.Option(help="Sample rate where the file has no times, such as '100 Hz'.")] = None,
    unit: Annotated[
        str | None, typer.Option(help="The column's unit, with a factor for counts: rad/s, '0.05 deg/s'.")
    ] = None,
    reach: Annotated[str | None, typer.Option(help="How long to average to reach this, such as '0.5 deg/hr'.")] = None,
    collect_time: Annotated[
        str | None, typer.Option(help="How long a collect is; default: a folder's own, else 60 s.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the plot here, .svg or .png.")] = None,
) -> Answer:
    """Say what a recording's noise is made of (N, B, K), how long to average, and when longer stops helping."""
    import numpy as np

    from hil.analysis.allan.document import analyse
    from hil.analysis.allan.figure import draw
    from hil.analysis.allan.sources import read_recording
    from hil.files.figure import check_name, save_figure
    from hil.files.units import RATE, TIME, to_number

    if out is not None:
        check_name(out)
    wanted = None if reach is None else quantity("--reach", reach, lambda text: to_number(text, RATE))
    collect_s = 60.0
    if collect_time is not None:
        collect_s = quantity("--collect-time", collect_time, lambda text: to_number(text, TIME))
    elif source.is_dir():
        rows = read_source(source).sensors.values()
        collect_s = float(np.median(np.concatenate([each.conditions.duration_s for each in rows])))
    result = analyse(
        read_recording(source, channel=channel, sensor=sensor, collect=collect, rate_hz=sample_rate_hz(rate), unit=unit)
    )
    if out is not None:
        save_figure(draw(result), out)
    document = result.document(collect_s, wanted)
    return Answer(document, lambda: _allan(document, out), lambda _: draw(result))


def _allan(document: dict[str, Any], out: Path | None) -> Iterator[str | Table]:
    mark = "  SIMULATED" if document["simulated"] else ""
    yield (
        f"{document['source']}: {document['samples']} samples at {document['rate_hz']:.6g} Hz, "
        f"{document['stretches']} stretch{'es' if document['stretches'] > 1 else ''} without a gap{mark}"
    )
    table = listing("averaging, s", "deviation, deg/hr", "95 % interval", "slope", "fit", left=())
    columns = ("tau_s", "deviation", "low", "high", "slope", "fitted")
    for tau, deviation, low, high, slope, fitted in zip(*(document[name] for name in columns), strict=True):
        table.add_row(f"{tau:.4g}", f"{deviation:.4g}", f"{low:.4g} to {high:.4g}", f"{slope:+.2f}", f"{fitted:.4g}")
    yield table
    terms = listing("term", "value", "95 % interval", "unit", "slope", "what it is")
    for name, term in document["fit"].items():
        value = f"{term['value']:.4g}" if term["seen"] else "not seen"
        terms.add_row(
            name,
            value,
            f"{term['low']:.4g} to {term['high']:.4g}" if term["seen"] else f"below {term['high']:.4g}",
            term["unit"],
            f"{term['slope']:+g}",
            term["meaning"],
        )
    yield terms
    yield from document["summary"]
    yield from (Aside(f"note: {note}") for note in document["notes"])
    if out is not None:
        yield f"plot: {out}"


def audit(
    name: Annotated[
        Path,
        typer.Argument(
            metavar="TABLE",
            help="A CSV in the layout of Table 1 or Table A-1, or rd-gc-86-1-table-1, rd-gc-86-1-table-a1.",
        ),
    ],
) -> Answer:
    """Check every identity in a published table: what does not close, by how much, which reading would mend it."""
    from hil.analysis.published import audit_table

    document = audit_table(name).document()
    return Answer(document, lambda: _audited(document))


def _audited(document: dict[str, Any]) -> Iterator[str | Table]:
    table = listing("row", "identity", "residual", "tolerance", "verdict", left={"row", "identity", "verdict"})
    doubtful = [each for each in document["identities"] if each["verdict"] != "ok"]
    for each in doubtful:
        numbers = (f"{each['residual']:+.4f}", f"{each['tolerance']:.4f}")
        table.add_row(str(each["row"]), each["identity"], *numbers, each["verdict"])
    if doubtful:
        yield table
    for each in doubtful:
        yield from _mending(each)
    yield f"\n{document['summary']}"
    yield from (Aside(f"note: {note}") for note in document["notes"])


def _mending(identity: dict[str, Any]) -> Iterator[str]:
    """What would mend one identity, in a few lines."""
    readings = identity["candidates"][:_READINGS_SHOWN]
    alone = [each for each in identity["would_close"] if each["others_hold"]]
    if identity["note"]:
        yield f"\n{identity['row']}, {identity['identity']}: {identity['note']}"
    elif readings or alone:
        yield f"\n{identity['row']}, {identity['identity']} would be mended by"
    for each in readings:
        rest = "" if each["mends_row"] else "; something else in this row still fails"
        left = f"leaves {each['residual']:+.4f}"
        yield f"  {each['cell']} {each['printed']} read as {each['read']} ({each['change']}), {left}{rest}"
    if any(each["mends_row"] for each in readings) or not alone:
        return
    values = " or ".join(f"{each['cell']} = {each['value']}" for each in alone)
    only = "only " if len(alone) == 1 else ""
    first = "or" if readings else "no single digit;"
    yield f"  {first} {only}{values} closes it beside what holds"


def thermal(
    source: Source,
    model: Annotated[
        str | None, typer.Option(help="matrix-6, collins-4, constant or triad-12; default: what fits.")
    ] = None,
    highest_order: Annotated[int, typer.Option(min=0, max=8, help="The highest polynomial that is tried.")] = 5,
    apart: Annotated[
        str | None, typer.Option(help="How far apart two temperatures are, to count as two; default: the data tell.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write model.yaml, thermal.json and, for triads, PX4 and ArduPilot files here.")
    ] = None,
) -> Answer:
    """Fit every parameter against temperature, and say whether modelling it improves the unit."""
    from hil.analysis.thermal import fit_thermal
    from hil.analysis.thermal.document import thermal_document
    from hil.analysis.thermal.files import write_thermal
    from hil.files.units import DIFFERENCE, to_number

    apart_degC = None if apart is None else quantity("--apart", apart, lambda text: to_number(text, DIFFERENCE))
    if apart_degC == 0.0:
        raise InputError("--apart: two temperatures must be more than 0 °C apart")
    if out is not None:
        check_result_folder(out, "reconciliation.json", "reconcile")
    campaign = read_source(source)
    result = fit_thermal(campaign, model, highest_order=highest_order, apart_degC=apart_degC)
    written = [] if out is None else write_thermal(result, out)
    document = thermal_document(result)

    def drawn(sensor: int | None) -> Figure:
        from hil.analysis.thermal.files import draw_fit
        from hil.report.plots import which_sensor

        return draw_fit(result.of(which_sensor(source, campaign, sensor)), campaign)

    status = Exit.INCOMPLETE if result.not_fitted else Exit.DONE
    return Answer(document, lambda: _thermal(document, out, written), drawn, status)


def _thermal(document: dict[str, Any], out: Path | None, written: list[str]) -> Iterator[str | Table]:
    from hil.solve.wrong_rows import in_words

    yield from (Aside(f"warning: {line}") for line in document["warnings"])
    yield f"{document['campaign']}{'  SIMULATED' * document['simulated']}"
    yield from in_words(document)
    for sensor in document["sensors"]:
        yield from _of_sensor(sensor)
    yield from (f"not fitted: {each['why']}" for each in document["not_fitted"])
    if written:
        yield f"\nwritten to {out}: {', '.join(written)}"


def _of_sensor(sensor: dict[str, Any]) -> Iterator[str | Table]:
    low, high = (round(each, 1) + 0.0 for each in sensor["range_degC"])  # no minus before a zero
    yield (
        f"\nsensor {sensor['sensor']}, {sensor['model']}, {len(sensor['temperatures_degC'])} temperatures from "
        f"{low:.1f} to {high:.1f} °C, the unit's own; errors are those at a temperature that was left out"
    )
    headings = ("", "unit", "form", "its error", "form chosen anew", "a constant's", "± of one run")
    table = listing(*headings, *(["from below - from above"] if sensor["both_directions_degC"] else []))
    for name, each in sensor["parameters"].items():
        scatter = "–" if each["repeatability"] is None else f"{each['repeatability']:.3g}"
        found = each["improvement"]
        anew = _error(found["held_out_modelled"]) if found["form_chosen_anew"] else "–"
        errors = (_error(each["leave_one_out_error"]), anew, _error(each["leave_one_out_error_constant"]))
        form = "none found" if each["finding"] == "undescribed" else each["form"]
        change = each["hysteresis"]
        last = [] if change is None else [f"{change['from_below_less_from_above']:+.2f} ±{change['se']:.2f}"]
        table.add_row(name, each["unit"], form, *errors, scatter, *last)
    yield table
    yield from (f"{name}: {each['verdict']}" for name, each in sensor["parameters"].items())
    yield sensor["verdict"]["words"]
    yield from (Aside(f"note: {note}") for note in sensor["notes"])


def _error(value: float) -> str:
    """An error of the sixteenth digit is none."""
    return f"{value:.3g}" if value > _ROUNDING else "0"


COMMANDS = (allan, audit, thermal)
