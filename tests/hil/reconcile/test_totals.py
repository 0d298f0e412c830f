"""What is printed is what a parameter is: an increment of the model's own value stands beside the value."""

from __future__ import annotations

import pytest

from hil.cli.model import _values
from hil.model import Model
from hil.model.curve import Constant
from hil.model.model_file import SCHEMA
from hil.reconcile.outcome.findings import with_totals
from hil.reconcile.result import FoundEffect


def test_an_increment_says_what_the_parameter_then_is() -> None:
    """MUB is 206 in the model and -184 is added at one temperature: 22 stands first; the rest is as it was."""
    at = {"se": 2.0, "unit": "deg/hr/g", "sensor": 2}
    parameters = [
        {"name": "MUB", "value": -184.0, "at": "-29.6 degC", **at},
        {"name": "MUB", "value": 3.0, "at": "-29.6 to 60.0 degC", **at},
        {"name": "s_mu", "value": 4.0, "at": "", **at},
    ]
    found = FoundEffect("MU_T", "", "", parameters, 1.0, [], "named")
    curves = {2: {"MUB": Constant(unit="deg/hr/g", value=206.0)}}
    after = Model(schema=SCHEMA, title="t", form="matrix-6", source="s", sensors=curves)
    (told,) = with_totals([found], after)
    assert [each.get("total") for each in told.parameters] == [pytest.approx(22.0), None, None]
    lines = list(_values(told.parameters))
    assert "22 ± 2 (-184 by this effect) at -29.6 degC" in lines[0]
