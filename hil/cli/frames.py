"""Commands about what a unit sends: decode a file of raw bytes, and explain a frame description."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from hil.cli.answer import Answer, told
from hil.cli.exit_status import Exit
from hil.cli.output import results
from hil.errors import InputError

Description = Annotated[str, Option("--frames", help="A frame description, or the name of one that ships.")]
Settings = Annotated[
    list[str] | None, Option("--set", help="A parameter of the description, NAME=VALUE; may be repeated.")
]


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
    from hil.bench.guess import guess_file
    from hil.files.durable import write_result

    document = guess_file(capture)
    if out is not None and document["description"] is not None:
        write_result(out, document["description"])
    return Answer(document, told(document))


def frame_parameters(settings: list[str] | None) -> dict[str, Any]:
    """Read NAME=VALUE pairs, values as YAML has them; raise `InputError` for what is no such pair."""
    from drivers.strict_yaml import parse_value

    found: dict[str, Any] = {}
    for setting in settings or []:
        name, sign, value = setting.partition("=")
        if not sign or not name.strip():
            raise InputError(f"--set {setting}: write NAME=VALUE")
        found[name.strip()] = parse_value(value, f"--set {setting}")
    return found


COMMANDS = (decode,)

frames_app = typer.Typer(
    name="frames", help="Frame descriptions: what a unit's bytes mean.", no_args_is_help=True, rich_markup_mode=None
)
