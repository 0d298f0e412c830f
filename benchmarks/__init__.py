"""Benchmarks: each beside the obvious alternative, in one run."""
