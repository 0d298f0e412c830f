"""Commands about what the coefficients mean, and the published ones: thermal, allan, audit, reproduce."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from hil.cli.answer import Answer, told
from hil.cli.data import Source, read_source
from hil.cli.exit_status import Exit
from hil.cli.output import check_result_folder
from hil.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.files.units import Kind


def quantity(option: str, text: str, kind: Kind) -> float:
    """Return what an option says, in the unit of its kind; raise `InputError` where it is none."""
    from hil.files.units import to_number

    try:
        return to_number(text, kind)
    except ValueError as error:
        raise InputError(f"{option}: {error}") from None


def sample_rate_hz(text: str | None) -> float | None:
    """Return what --rate says, where it is given; raise `InputError` where it is no rate."""
    from hil.files.columns import is_number
    from hil.files.units import FREQUENCY

    if text is None:
        return None
    rate_hz = quantity("--rate", f"{text} Hz" if is_number(text) else text, FREQUENCY)
    if rate_hz == 0.0:
        raise InputError("--rate: the sample rate must be more than 0 Hz")
    return rate_hz


def allan(
    source: Annotated[
        Path, Argument(metavar="FILE", help="A table (.parquet, .csv, .txt, .npz), a night or a campaign folder.")
    ],
    channel: Annotated[str | None, Option(help="Which channel or column.")] = None,
    sensor: Annotated[int | None, Option(help="Of a folder: which sensor.")] = None,
    collect: Annotated[int | None, Option(help="Of a folder: one collect; default: all of them.")] = None,
    rate: Annotated[str | None, Option(help="Sample rate where the file has no times, such as '100 Hz'.")] = None,
    unit: Annotated[
        str | None, Option(help="The column's unit, with a factor for counts: rad/s, '0.05 deg/s'.")
    ] = None,
    reach: Annotated[str | None, Option(help="How long to average to reach this, such as '0.5 deg/hr'.")] = None,
    collect_time: Annotated[
        str | None, Option(help="How long a collect is; default: a folder's own, else 60 s.")
    ] = None,
    out: Annotated[Path | None, Option(help="Write the plot here, .svg or .png.")] = None,
) -> Answer:
    """Say what a recording's noise is made of (N, B, K), how long to average, and when longer stops helping."""
    import numpy as np

    from hil.analysis.allan.document import AllanResult, draw
    from hil.analysis.allan.sources import read_recording
    from hil.files.durable import check_file
    from hil.files.figure import PLOT, save_figure
    from hil.files.units import RATE, TIME

    if out is not None:
        check_file(out, *PLOT)
    wanted = None if reach is None else quantity("--reach", reach, RATE)
    collect_s = 60.0
    if collect_time is not None:
        collect_s = quantity("--collect-time", collect_time, TIME)
    elif source.is_dir():
        rows = read_source(source).sensors.values()
        collect_s = float(np.median(np.concatenate([each.conditions.duration_s for each in rows])))
    result = AllanResult(
        read_recording(source, channel=channel, sensor=sensor, collect=collect, rate_hz=sample_rate_hz(rate), unit=unit)
    )
    if out is not None:
        save_figure(draw(result), out)
    document = result.document(collect_s, wanted)
    return Answer(document, told(document, out=out), lambda _: draw(result))


def audit(
    name: Annotated[
        Path,
        Argument(
            metavar="TABLE",
            help="A CSV in the layout of Table 1 or Table A-1, or rd-gc-86-1-table-1, rd-gc-86-1-table-a1.",
        ),
    ],
) -> Answer:
    """Check every identity in a published table: what does not close, by how much, which reading would mend it."""
    from hil.analysis.published.audit import Audit

    document = Audit(name).document()
    return Answer(document, told(document))


def thermal(
    source: Source,
    model: Annotated[str | None, Option(help="matrix-6, collins-4, constant or triad-12; default: what fits.")] = None,
    highest_order: Annotated[int, Option(min=0, max=8, help="The highest polynomial that is tried.")] = 5,
    apart: Annotated[
        str | None, Option(help="How far apart two temperatures are, to count as two; default: the data tell.")
    ] = None,
    out: Annotated[
        Path | None, Option(help="Write model.yaml, thermal.json and, for triads, PX4 and ArduPilot files here.")
    ] = None,
) -> Answer:
    """Fit every parameter against temperature, and say whether modelling it improves the unit."""
    from hil.analysis.thermal.document import thermal_document
    from hil.analysis.thermal.files import write_thermal
    from hil.analysis.thermal.fit import fit_thermal
    from hil.files.units import DIFFERENCE

    apart_degC = None if apart is None else quantity("--apart", apart, DIFFERENCE)
    if apart_degC == 0.0:
        raise InputError("--apart: two temperatures must be more than 0 °C apart")
    campaign = read_source(source)
    if out is not None:
        check_result_folder(out, "thermal.json", of=campaign)
    result = fit_thermal(campaign, model, highest_order=highest_order, apart_degC=apart_degC)
    written = [] if out is None else write_thermal(result, out)
    document = thermal_document(result)

    def drawn(sensor: int | None) -> Figure:
        from hil.analysis.thermal.files import draw_fit
        from hil.report.plots import which_sensor

        return draw_fit(result.of(which_sensor(source, campaign, sensor)), campaign)

    status = Exit.INCOMPLETE if result.not_fitted else Exit.DONE
    return Answer(document, told(document, out=out, written_to=written), drawn, status)


def reproduce(
    source: Source, sensor: Annotated[int, Option(help="Which sensor; the report's tables are sensor 2's.")] = 2
) -> Answer:
    """Give RD-GC-86-1's Table 1, Figures 2-5 and Table A-1 again from a night, beside the printed values."""
    from hil.analysis.published.reproduction import reproduce as give_again

    campaign = read_source(source)
    document = give_again(campaign, sensor)
    return Answer(document, told(document, campaign=campaign))


COMMANDS = (allan, audit, reproduce, thermal)
