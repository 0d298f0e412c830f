"""The command line: `hil`, its commands, and how they end.

Exit status: 0 done (whatever the finding), 1 the work failed or was aborted, 2 bad input or usage, 3 stopped by an
interlock or device fault with the bench in its safe state, 4 something is incomplete (status, verify),
5 the chamber is NOT SAFE, 6 whether it is safe is NOT KNOWN.
"""

import os
import sys

# Set before numpy is imported, which reads it. The matrices are small: threads would wait more than they compute.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main() -> None:
    """Run the command line; who stops it while it is being loaded is told no more than later."""
    try:
        from hil.cli.app import main as run
    except KeyboardInterrupt:
        sys.exit(1)
    run()


__all__ = ["main"]
