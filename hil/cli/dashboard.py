"""The command that serves the live page."""

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from drivers.given_file import check_folder
from hil.cli.output import messages, results

NightOrFolder = Annotated[
    Path,
    typer.Argument(
        metavar="DIR_OR_FOLDER",
        help="A night's folder, or a folder of such folders: all are shown.",
    ),
]


def dashboard(
    folder: NightOrFolder,
    host: Annotated[
        str, typer.Option(help="Where to listen. Beyond this machine, reading takes the token too.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one.")] = 8765,
    token_file: Annotated[Path | None, typer.Option(help="Keeps the token from one start to the next.")] = None,
    archive: Annotated[Path | None, typer.Option(envvar="HIL_ARCHIVE", help="Show its units, too.")] = None,
) -> None:
    """Show running and finished nights on a live page in the browser, until Ctrl-C. Nights go on without it."""
    from hil.dashboard.access import Access, is_loopback, new_token, token_from, url
    from hil.dashboard.server import create_app, listen, server
    from hil.dashboard.watcher import Watcher

    check_folder(folder)
    access = Access(token_from(token_file) if token_file else new_token(), host)
    if token_file and token_file.stat().st_mode & 0o077:
        messages().print(f"note: others of this machine may read {token_file}; chmod 600 {token_file}")
    watcher = Watcher(folder, archive=archive)
    if not watcher.journals():
        messages().print(f"note: there is no night in {folder} yet; one that begins appears on the page by itself")
    with listen(host, port) as listener:
        results().print(url(host, listener.getsockname()[1]))
        what = "pausing, continuing, aborting and answering"
        if not is_loopback(host):
            what = f"reading, {what}"
            messages().print("note: what goes over the network is not encrypted; see hil docs live-page")
        results().print(f"token for {what}: {f'in {token_file}' if token_file else access.token}")
        with suppress(KeyboardInterrupt):
            server(create_app(watcher, access)).run(sockets=[listener])
