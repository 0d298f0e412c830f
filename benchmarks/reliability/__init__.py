"""Nothing lost, proven by killing it: nights that are killed, cut off from power, and rehearsed with faults.

    python -m benchmarks.reliability.kill --help       # kill points, random instants, power failures
    python -m benchmarks.reliability.rehearse --help   # nights with random faults
    python -m benchmarks.reliability.flips --help      # every byte flipped, every row changed, of a complete night
    python -m benchmarks.reliability.ledger_cost       # what the chain of the journal's rows costs
    python -m benchmarks.reliability.long_night        # 72 hours at 1 kHz: memory, disk, speed of status

`make reliability` runs them all; docs/reliability.md has the figures.
"""

from __future__ import annotations

import os

os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # the other ones start a thread, and these programs fork
