"""Commands about what units send and others recorded: decode, frames, import."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup

from drivers.strict_yaml import parse_value
from hil.cli.answer import Answer, told
from hil.cli.coefficients import quantity, sample_rate_hz
from hil.cli.exit_status import Exit
from hil.cli.output import messages, results, warn
from hil.errors import InputError
from hil.files.durable import write_result
from hil.files.units import ACCELERATION, ANGLE, RATE, TIME

Description = Annotated[str, Option("--frames", help="A frame description, or the name of one that ships.")]
Settings = Annotated[
    list[str] | None, Option("--set", help="A parameter of the description, NAME=VALUE; may be repeated.")
]
Out = Annotated[Path, Argument(help="The campaign folder to make.")]


def decode(
    file: Annotated[Path, Argument(help="Raw bytes as they came down the wire.")],
    frames: Description,
    settings: Settings = None,
    rate: Annotated[float | None, Option(help="Samples per second, where it is not the description's.")] = None,
    out: Annotated[Path | None, Option(help="Write the frames as a table: X.parquet or X.csv.")] = None,
) -> Answer:
    """Decode a file of raw bytes and account for every one of them; status 4 where no frame is found."""
    from hil.bench.decode import decode_file, load_frames_named

    description = load_frames_named(frames, parameters=frame_parameters(settings), sample_rate_hz=rate)
    document = decode_file(file, description, out=out)
    return Answer(document, told(document), status=Exit.DONE if document["frames"] else Exit.INCOMPLETE)


def check(
    description: Annotated[str, Argument(help="A frame description, or the name of one that ships.")],
    settings: Settings = None,
) -> None:
    """Check a frame description and say in words what it means."""
    from hil.bench.decode import explain_frames, load_frames_named

    results().print(explain_frames(load_frames_named(description, parameters=frame_parameters(settings))))


def guess(
    capture: Annotated[Path, Argument(help="Raw bytes as they came down the wire.")],
    out: Annotated[Path | None, Option(help="Write the first description here, to be edited.")] = None,
) -> Answer:
    """Look at the bytes of an unknown unit: which descriptions read them, where frames begin, what they carry."""
    from hil.bench.guess import checksum_in_words, guess_file

    document = guess_file(capture)
    if out is not None and document["description"] is not None:
        write_result(out, document["description"])
    return Answer(document, told(document, checksum=checksum_in_words(document.get("checksum"))))


def frame_parameters(settings: list[str] | None) -> dict[str, Any]:
    """Read NAME=VALUE pairs, values as YAML has them; raise `InputError` for what is no such pair."""
    found: dict[str, Any] = {}
    for setting in settings or []:
        name, sign, value = setting.partition("=")
        if not sign or not name.strip():
            raise InputError(f"--set {setting}: write NAME=VALUE")
        found[name.strip()] = parse_value(value, f"--set {setting}")
    return found


class TableUnlessSaid(TyperGroup):
    """`hil import TABLE OUT` is `hil import table TABLE OUT`: what is no command is a table."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that `args` begin with, or `table`."""
        return super().resolve_command(ctx, args if args[0] in self.commands else ["table", *args])


def table(table: Annotated[Path, Argument(help="A published table, CSV in the layout of Table 1.")], out: Out) -> None:
    """Make a campaign folder from a published table of parameters, as printed, flags kept."""
    from hil.analysis.published.table import read_published_table
    from hil.campaign.writer import write_campaign

    campaign = read_published_table(table)
    write_campaign(campaign, out)
    for note in campaign.notes.splitlines():
        messages().print(f"note: {note}")
    warn(tuple(campaign.warnings))
    results().print(f"campaign: {out}")


def log(
    log: Annotated[Path, Argument(help="A log: CSV, Parquet, columns of text, .npz; with --frames bytes.")],
    out: Out,
    frames: Annotated[str | None, Option(help="What the bytes mean: a frame description.")] = None,
    settings: Settings = None,
    gyro: Annotated[str | None, Option(help="Columns of the rates: X,Y,Z.")] = None,
    gyro_scale: Annotated[str | None, Option(help="Their unit: rad/s, or of counts '0.0076 deg/s'.")] = None,
    accelerometer: Annotated[str | None, Option(help="Columns of the accelerations: X,Y,Z.")] = None,
    accelerometer_scale: Annotated[str | None, Option(help="Their unit: m/s^2, or of counts '0.122 mg'.")] = None,
    time: Annotated[str | None, Option(help="The column of the times.")] = None,
    time_scale: Annotated[str | None, Option(help="Its unit: s, ms, '25 us'.")] = None,
    rate: Annotated[str | None, Option(help="Samples per second, where no times are to be used.")] = None,
    labels: Annotated[str | None, Option(help="The column that labels positions.")] = None,
    latitude: Annotated[str | None, Option(help="Where it was recorded: '48.1 deg'.")] = None,
    window: Annotated[str, Option(help="Of the test of rest: over how long variances are taken.")] = "0.5 s",
    times: Annotated[float, Option(help="Variances up to so many times the quietest tenth's are rest.")] = 4.0,
    shortest: Annotated[str, Option(help="How long a unit must be at rest.")] = "1 s",
    moved: Annotated[str, Option(help="How far it may turn within a stretch.")] = "0.5 deg",
) -> Answer:
    """Make a campaign folder from a log of a unit that was put down in many poses by hand."""
    from hil.analysis.log.poses import campaign_of_log, write_log_campaign
    from hil.analysis.log.reading import columns_of_bytes, read_log
    from hil.analysis.log.static import StaticTest
    from hil.bench.decode import load_frames_named
    from hil.files.columns import read_columns

    rate_hz = sample_rate_hz(rate)
    latitude_deg = None if latitude is None else quantity("--latitude", latitude, ANGLE)
    if latitude_deg is not None and abs(latitude_deg) > 90.0:
        raise InputError(f"--latitude {latitude}: it must be from -90 to +90 deg")
    test = StaticTest(
        quantity("--window", window, TIME),
        times,
        quantity("--shortest", shortest, TIME),
        quantity("--moved", moved, ANGLE),
    )
    if frames is not None:
        description = load_frames_named(frames, parameters=frame_parameters(settings))
        recorded, rate_hz = columns_of_bytes(log, description, rate_hz), None
    else:
        recorded = read_columns(log)
    columns, scales = (
        {kind: text for kind, text in zip((RATE, ACCELERATION, TIME), texts, strict=True) if text is not None}
        for texts in ((gyro, accelerometer, time), (gyro_scale, accelerometer_scale, time_scale))
    )
    read = read_log(recorded, columns, scales, labels=labels, rate_hz=rate_hz)
    made = campaign_of_log(read, test, latitude_deg=latitude_deg)
    write_log_campaign(made, out)
    document = {**made.document, "campaign": str(out)}
    return Answer(document, told(document))


frames_app = typer.Typer(
    name="frames", help="Frame descriptions: what a unit's bytes mean.", no_args_is_help=True, rich_markup_mode=None
)
import_app = typer.Typer(
    name="import",
    cls=TableUnlessSaid,
    help="Data from elsewhere as a campaign folder: a table, a log.",
    rich_markup_mode=None,
    no_args_is_help=True,
)
