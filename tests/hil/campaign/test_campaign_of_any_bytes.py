"""Folders that nobody here made: damaged bytes, and real campaigns of other units."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.campaign.reader import read_campaign
from hil.errors import InputError
from tests.hil.campaign.test_campaign_reader import ROWS, YAML, table


@pytest.mark.slow
@given(st.data())
def test_whatever_happens_to_the_bytes_the_answer_is_a_campaign_or_one_sentence(data: st.DataObject) -> None:
    """Bytes changed, cut out or put in, in either file: never another exception, never half a campaign."""
    texts = {"campaign.yaml": YAML.encode(), "collects.csv": table(*ROWS).encode()}
    name = data.draw(st.sampled_from(sorted(texts)))
    for _ in range(data.draw(st.integers(1, 4))):
        old = texts[name]
        start = data.draw(st.integers(0, len(old)))
        stop = data.draw(st.integers(start, min(len(old), start + 40)))
        texts[name] = old[:start] + data.draw(st.binary(max_size=6) | st.just(b",") | st.just(b"\n")) + old[stop:]
    with tempfile.TemporaryDirectory() as place:
        for file, text in texts.items():
            (Path(place) / file).write_bytes(text)
        refusal = ""
        sensors = {}
        try:
            sensors = read_campaign(place).sensors
        except InputError as error:
            refusal = str(error)
        assert "\n" not in refusal
        assert bool(refusal) != bool(sensors)
        assert all(np.all(np.isfinite(rows.conditions.f_g)) for rows in sensors.values())


def test_real_campaigns_are_read_without_error(reference_data: Path) -> None:
    """Four measured by others: triads, hand-placed poses, earth rate unknown."""
    folders = sorted((reference_data / "campaigns").iterdir())
    assert len(folders) == 4
    for folder in folders:
        campaign = read_campaign(folder)
        assert campaign.sensors[1].conditions.sensor.is_triad
        assert len(campaign.sensors[1]) >= 18
