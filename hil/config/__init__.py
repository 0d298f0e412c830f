"""Bench and sweep files: read strictly, with units, and refused in one sentence where they are wrong."""

from hil.config.bench import Bench, load_bench, parse_bench
from hil.config.sweep import Sweep, check_sweep_against_bench, load_sweep, parse_sweep

__all__ = ["Bench", "Sweep", "check_sweep_against_bench", "load_bench", "load_sweep", "parse_bench", "parse_sweep"]
