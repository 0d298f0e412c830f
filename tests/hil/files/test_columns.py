"""Tables that people give: what stands between cells, and before decimals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.errors import InputError
from hil.files.columns import read_columns


@pytest.mark.parametrize(
    "text",
    [
        "a [mg],b,where\n1.5,-2000.25,x\n3.0,4e-1,y\n",
        "a [mg];b;where\n1.5;-2000.25;x\n3.0;4e-1;y\n",
        "a [mg];b;where\n1,5;-2000,25;x\n3,0;4e-1;y\n",
    ],
)
def test_a_spreadsheet_may_write_semicolons_and_decimal_commas(tmp_path: Path, text: str) -> None:
    """Read as if commas stood between the cells, the whole row was one column of words."""
    (path := tmp_path / "log.csv").write_text(text)
    read = read_columns(path)
    np.testing.assert_array_equal(np.column_stack([*read.values.values()]), [[1.5, -2000.25], [3.0, 0.4]])
    assert (list(read.values), read.texts["where"].tolist()) == (["a [mg]", "b"], ["x", "y"])


def test_a_row_of_semicolons_that_is_too_short_is_told_by_its_number(tmp_path: Path) -> None:
    """As with commas."""
    (path := tmp_path / "log.csv").write_text("a;b\n1,5;2,5\n3,5\n")
    with pytest.raises(InputError, match="row 3: 1 cell under 2 columns"):
        read_columns(path)
