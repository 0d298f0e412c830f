"""Frames from columns: the inverse of decoding, for simulated units and for tests."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from drivers.frames.description import StreamDescription
from drivers.frames.layout import FrameLayout
from drivers.frames.wire import Rows


def encode_rows(layout: FrameLayout, columns: Mapping[str, ArrayLike | str], n: int) -> Rows:
    """Return n frames, shape (n, length), with their checksums.

    `columns` holds numeric fields in their units, shape (n,) or one value for all frames, and text fields as text.
    Fields that are not given are 0. Raise `KeyError` for a field that the frame does not have, `ValueError` for a type
    of varying length, of items, parts or text, or in packets: what such a frame holds is not told by its description.
    """
    fixed = isinstance(layout.description.length, int) and layout.description.items is None
    if not fixed or layout.in_packets:
        raise ValueError(
            f"frames.{layout.name}: frames of varying length, items, parts or text, or in packets, can be read, "
            "not made; simulate a unit whose frames have a fixed length, such as mfs"
        )
    rows = layout.blank(n)
    layout.store_together(rows, {name: each for name, each in columns.items() if not isinstance(each, str)})
    for field, values in columns.items():
        if isinstance(values, str):
            layout.store_text(rows, field, values)
    layout.checksum.write(rows)
    return rows


def encode(description: StreamDescription, frame: str, columns: Mapping[str, ArrayLike | str]) -> bytes:
    """Return the bytes of the frames of type `frame` with the given columns (see `encode_rows`).

    There are as many frames as the longest column has values.
    """
    sizes = {np.size(values) for values in columns.values() if not isinstance(values, str)} | {1}
    n = 0 if 0 in sizes else max(sizes)
    return encode_rows(FrameLayout(description, frame), columns, n).tobytes()
