"""Contrast where an audit of the page cannot judge it: text in pictures, and curves that are drawn on a canvas.

By the formula of WCAG 2.2: 4.5 to 1 for text, 3 to 1 for lines.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hil.campaign import Series
from hil.files.figure import LOOKS
from hil.files.page import inline_svg
from hil.report.night import NightContent
from hil.report.plots import CollectSeries, Line, draw_against_temperature, draw_night, draw_series

CSS = (Path(__file__).parents[3] / "hil/dashboard/static/page.css").read_text()
TEXT, LINE = 4.5, 3.0
WHITE = "#ffffff"


def luminance(colour: str) -> float:
    """Return the relative luminance of #rrggbb."""
    channels = np.array([int(colour[place : place + 2], 16) for place in (1, 3, 5)]) / 255.0
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours, from 1 to 21."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def schemes() -> dict[str, dict[str, str]]:
    """Return the page's colours by name, in light and in dark."""
    light, dark = (dict(re.findall(r"--([\w-]+): (#\w{6})", part)) for part in CSS.split("prefers-color-scheme: dark"))
    return {"light": light, "dark": light | dark}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_what_the_live_page_draws_on_a_canvas_is_seen(scheme: str) -> None:
    """Curves, the plan and where the night has got to, on their card; and the numbers at the axes."""
    colours = schemes()[scheme]
    for name in ("curve-1", "curve-2", "curve-3", "curve-4", "plan"):
        assert contrast(colours[name], colours["card"]) >= LINE, name
    assert contrast(colours["quiet"], colours["card"]) >= TEXT


def pictures() -> dict[str, str]:
    """Return every kind of picture of a report as SVG."""
    at = np.array([10.0, 20.0, 30.0])
    lines = [Line(style, at, at, at / 10.0, style) for style in LOOKS]
    names = ("setpoint", "chamber", "unit, sensor 1", "unit, sensor 2")
    night = NightContent("complete", hours=at, temperatures=dict.fromkeys(names, at), event_hours=at)
    series = CollectSeries(
        "a collect", True, Series(at, np.stack([at, at], 1), at), {"RA": (20.0, 1.0), "RB": (20.0, 1.0)}
    )
    return {
        "parameter": inline_svg(draw_against_temperature("bias A", "deg/hr", lines), "a parameter"),
        "night": inline_svg(draw_night(night), "a night"),
        "series": inline_svg(draw_series(series), "a series"),
    }


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["parameter", "night", "series"])
def test_text_in_a_picture_is_read_on_white_paper(kind: str) -> None:
    """Every piece of text of an SVG, whose colour is black where it states none."""
    texts = re.findall(r"<text([^>]*)>", pictures()[kind])
    assert len(texts) > 8
    for attributes in texts:
        stated = re.search(r"fill: ?(#\w{6})", attributes)
        assert contrast(stated[1] if stated else "#000000", WHITE) >= TEXT, attributes


def test_lines_are_told_apart_without_their_colours() -> None:
    """On a black and white print each has a dash or a marker that no other has, and is dark enough."""
    styles = [(look["marker"], str(look["linestyle"])) for look in LOOKS.values()]
    assert len({marker for marker, _ in styles}) == len({dash for _, dash in styles}) == len(LOOKS)
    assert all(contrast(look["color"], WHITE) >= LINE for look in LOOKS.values())
    at = np.array([0.0, 1.0])
    names = ("setpoint", "chamber", "unit, sensor 1", "unit, sensor 2", "unit, sensor 3")
    night = draw_night(NightContent("complete", hours=at, temperatures=dict.fromkeys(names, at)))
    drawn = [line for line in night.axes[0].get_lines() if line.get_label() in names]
    assert len({str(line._unscaled_dash_pattern) for line in drawn}) == len(names)  # type: ignore[attr-defined]
