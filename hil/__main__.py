"""`python -m hil` is `hil`."""

from __future__ import annotations

from hil.cli import main

if __name__ == "__main__":
    main()
