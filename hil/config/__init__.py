"""Bench and sweep files: read strictly, with units, and refused in one sentence where they are wrong."""

from hil.config.bench import Bench, load_bench, parse_bench
from hil.config.sweep import Sweep, cautions, check_sweep_against_bench, limits_of, load_sweep, parse_sweep, planned
from hil.files.strict import find_config

__all__ = [
    "Bench",
    "Sweep",
    "cautions",
    "check_sweep_against_bench",
    "find_config",
    "limits_of",
    "load_bench",
    "load_sweep",
    "parse_bench",
    "parse_sweep",
    "planned",
]
