"""The devices on the table: put together, locked, looked at before anything moves, their recordings decoded."""

from hil.bench.assemble import LiveBench, build_bench, open_chamber

__all__ = ["LiveBench", "build_bench", "open_chamber"]
