"""The command that computes a recorded night again."""

from hil.cli.answer import Answer
from hil.cli.exit_status import Exit
from hil.cli.output import Folder


def replay(folder: Folder) -> Answer:
    """Compute a recorded night again from its raw bytes: every average, to the digit."""
    from hil.night.replay import replay_night

    document = replay_night(folder)
    found = "identical to the digit" if document["identical"] else "NOT shown to be identical"
    mark = "  SIMULATED" if document["simulated"] else ""
    lines = [
        *(f"different: {difference}" for difference in document["differences"]),
        *(f"missing: the raw bytes of {key}" for key in document["raw_missing"]),
        f"{folder}: {found}, {document['collects_checked']} collects computed again{mark}",
    ]
    return Answer(document, lambda: lines, status=Exit.DONE if document["identical"] else Exit.INCOMPLETE)


COMMANDS = (replay,)
