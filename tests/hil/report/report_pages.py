"""A short night and its report, and the report's tables as lists: what the tests of the report stand on."""

from __future__ import annotations

import json
from html.parser import HTMLParser

import pytest

from hil.cli.app import run as hil
from hil.config import parse_sweep

SWEEP = """
title: Two temperatures
temperatures: [20 degC, 30 degC]
self_calibrations_per_temperature: 2
positions: [1, 2, 3]
restabilisation: {at_least: 10 min, window: 5 min, ceiling: 60 min, unit_band: 5 degC, unit_slope: 2 degC/min}
collect: {settle: 5 s, duration: 20 s}
vocabulary: rd-gc-86-1
"""
TWO = parse_sweep(SWEEP, "two.yaml")


class Tables(HTMLParser):
    """The tables of a page by their id: a list of rows, each a list of cells, each a list of its lines of text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: dict[str, list[list[list[str]]]] = {}
        self._name = ""
        self._in_cell = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Open a table, a row or a cell."""
        if tag == "table":
            self._name = dict(attrs)["id"] or ""
            self.found[self._name] = []
        elif tag == "tr":
            self.found[self._name].append([])
        elif tag in {"td", "th"}:
            self.found[self._name][-1].append([])
            self._in_cell = True

    def handle_endtag(self, tag: str) -> None:
        """Close a cell."""
        if tag in {"td", "th"}:
            self._in_cell = False

    def handle_data(self, data: str) -> None:
        """Take a line of a cell."""
        if self._in_cell and data.strip():
            self.found[self._name][-1][-1].append(data.strip().replace("−", "-"))


def solved(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, object]]:
    """Return the solutions of `hil solve --json`."""
    capsys.readouterr()
    assert hil(["solve", *arguments, "--json"]) == 0
    found: list[dict[str, object]] = json.loads(capsys.readouterr().out)["solutions"]
    return found
