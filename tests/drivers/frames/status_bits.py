"""Status bits of decoded frames by their names, as tests look at them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.frames.batch import FrameBatch


def bits(batch: FrameBatch, name: str) -> NDArray[np.bool_]:
    """Return whether status bit `name` is set, shape (n,); the frame must have such a bit."""
    field, bit = next((field, of[name].bit) for field, of in batch.layout.description.status.items() if name in of)
    return np.asarray(batch.wire(field).astype(np.uint64) >> np.uint64(bit) & np.uint64(1), dtype=np.bool_)
