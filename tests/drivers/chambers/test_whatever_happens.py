"""Any faults, in any order, in any operation: no setpoint outside the limits, bounded time, a named error."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import (
    DeviceError,
    SetpointOutOfLimits,
)
from drivers.simulators.chambers.controller import ChamberFaultKind
from tests.drivers.chambers.chamber_benches import LIMITS, ChamberBench
from tests.drivers.chambers.test_every_chamber import every_chamber

_PUNCTUAL_S = 1.9  # of a reply: less than any line controller is waited for


@pytest.mark.slow
@every_chamber
@settings(max_examples=20)
@given(data=st.data())
def test_whatever_happens_no_setpoint_outside_the_limits_is_on_the_wire(name: str, data: st.DataObject) -> None:
    """Every operation ends in what was asked or in a named error, in bounded time; then the safe state is asked for."""
    bench = ChamberBench(name, mode=data.draw(st.sampled_from(["OFF", "CONSTANT", "RUN"])))
    bench.device.setpoint_degC = round(data.draw(st.floats(-60.0, 90.0)), 1)
    latest_s = 0.0
    for _ in range(data.draw(st.integers(0, 4))):
        kind, delay_s = data.draw(st.sampled_from(list(ChamberFaultKind))), data.draw(st.floats(0.0, 8.0))
        latest_s = max(latest_s, delay_s if kind is ChamberFaultKind.LATE else 0.0)
        bench.fault(
            kind,
            begins_s=data.draw(st.floats(0.0, 40.0)),
            command=data.draw(st.sampled_from(["", bench.kind.read, bench.kind.write])),
            times=data.draw(st.one_of(st.none(), st.integers(1, 5))),
            delay_s=delay_s,
        )
    wanted = data.draw(st.lists(st.floats(-60.0, 90.0), min_size=1, max_size=4))
    errors: list[DeviceError] = []
    operations = [bench.chamber.prepare, *(lambda at=at: bench.chamber.set_temperature(at) for at in wanted)]
    for operation in [*operations, bench.chamber.read, bench.chamber.safe_state]:
        began_s = bench.clock.now()
        try:
            operation()
        except DeviceError as error:
            errors.append(error)
        assert bench.clock.now() - began_s < 180.0
    assert all("sim://chamber" in str(error) or isinstance(error, SetpointOutOfLimits) for error in errors)
    assert all(LIMITS.low_degC <= setpoint <= LIMITS.high_degC for setpoint in bench.setpoints)
    if latest_s <= _PUNCTUAL_S:  # a later one may pass for the answer to what was sent again, and what follows is early
        assert bench.device.ignored_requests == 0
