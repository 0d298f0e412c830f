"""Commands about what units send and others recorded: decode, frames, import."""

from pathlib import Path
from typing import Any

from typer.core import TyperGroup

from drivers.strict_yaml import parse_value
from hil.cli.answer import Answer
from hil.cli.coefficients import quantity, sample_rate_hz
from hil.cli.exit_status import Exit
from hil.cli.output import messages, results, warn
from hil.errors import InputError
from hil.files.durable import write_result
from hil.files.units import ACCELERATION, ANGLE, RATE, TIME


def decode(
    file: Path, frames: str, settings: list[str] | None = None, rate: float | None = None, out: Path | None = None
) -> Answer:
    """Decode a file of raw bytes and account for every one of them; status 4 where no frame is found."""
    from hil.bench.decode import decode_file, load_frames_named

    description = load_frames_named(frames, parameters=frame_parameters(settings), sample_rate_hz=rate)
    document = decode_file(file, description, out=out)
    return Answer(document, status=Exit.DONE if document["frames"] else Exit.INCOMPLETE)


def check(description: str, settings: list[str] | None = None) -> None:
    """Check a frame description and say in words what it means."""
    from hil.bench.decode import explain_frames, load_frames_named

    results().print(explain_frames(load_frames_named(description, parameters=frame_parameters(settings))))


def guess(capture: Path, out: Path | None = None) -> Answer:
    """Look at the bytes of an unknown unit: which descriptions read them, where frames begin, what they carry."""
    from hil.bench.guess import checksum_in_words, guess_file

    document = guess_file(capture)
    if out is not None and document["description"] is not None:
        write_result(out, document["description"])
    return Answer(document, {"checksum": checksum_in_words(document.get("checksum"))})


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


def table(table: Path, out: Path) -> None:
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
    log: Path,
    out: Path,
    frames: str | None = None,
    settings: list[str] | None = None,
    gyro: str | None = None,
    gyro_scale: str | None = None,
    accelerometer: str | None = None,
    accelerometer_scale: str | None = None,
    time: str | None = None,
    time_scale: str | None = None,
    rate: str | None = None,
    labels: str | None = None,
    latitude: str | None = None,
    window: str = "0.5 s",
    times: float = 4.0,
    shortest: str = "1 s",
    moved: str = "0.5 deg",
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
    return Answer({**made.document, "campaign": str(out)})
