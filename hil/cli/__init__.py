"""The command line: `hil`, its commands, and how they end."""

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
