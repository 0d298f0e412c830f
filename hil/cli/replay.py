"""The command that computes a recorded night again."""

from hil.cli.exit_status import Exit
from hil.cli.output import Folder, JsonFlag, printed, results


def replay(folder: Folder, as_json: JsonFlag = False) -> int:
    """Compute a recorded night again from its raw bytes: every average, to the digit."""
    from hil.night.replay import replay_night

    document = replay_night(folder)
    if not printed(document, as_json):
        console = results()
        for difference in document["differences"]:
            console.print(f"different: {difference}")
        for key in document["raw_missing"]:
            console.print(f"missing: the raw bytes of {key}")
        found = "identical to the digit" if document["identical"] else "NOT shown to be identical"
        mark = "  SIMULATED" if document["simulated"] else ""
        console.print(f"{folder}: {found}, {document['collects_checked']} collects computed again{mark}")
    return Exit.DONE if document["identical"] else Exit.INCOMPLETE


COMMANDS = (replay,)
