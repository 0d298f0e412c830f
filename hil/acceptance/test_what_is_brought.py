"""What other installed distributions bring to hil, held to what ours must do; nothing of a bench is touched.

    pytest --pyargs hil.acceptance -k brought

Chambers are tried against the simulator that comes with them, or the box of their description, on a virtual clock.
"""

import pytest

from drivers.chambers import CHAMBER_DRIVERS, ChamberLimits, ChamberOptions, SafeState
from drivers.clock import VirtualClock
from drivers.errors import DeviceTimeout, SetpointOutOfLimits
from drivers.frames.description import load_description
from drivers.outside import brought, loaded
from drivers.simulators.chambers.catalogue import CHAMBER_SIMULATORS, SimulatorOptions
from drivers.simulators.chambers.controller import ChamberFault, ChamberFaultKind
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from hil.model.effects.catalogue import entries

LIMITS = ChamberLimits(-35.0, 65.0)


def _every(group: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("name", sorted(brought(group)))


@_every("hil.chambers")
@pytest.mark.parametrize("safe", [SafeState("hold", 25.0), SafeState("off")], ids=lambda safe: safe.action)
def test_a_chamber_that_is_brought_does_what_every_chamber_must(name: str, safe: SafeState) -> None:
    """Limits before any byte, a setpoint read back and reached, alarms latched, a safe state, and an end to silence."""
    clock, plant = VirtualClock(), ChamberPlant()
    try:
        device = CHAMBER_SIMULATORS[name](plant, SimulatorOptions())
        port = MemoryTransport(device, clock, "sim://chamber")
        chamber = CHAMBER_DRIVERS[name].build(port, clock, ChamberOptions(LIMITS, safe, celsius_confirmed=True))
    except ValueError as error:
        pytest.skip(f"{name}: {error}")
    with pytest.raises(SetpointOutOfLimits):
        chamber.set_temperature(LIMITS.high_degC + 1.0)
    chamber.prepare()
    chamber.set_temperature(-29.7222)
    clock.sleep(3600.0)
    reading = chamber.read()
    assert reading.setpoint_degC == pytest.approx(-29.7, abs=0.06)
    assert reading.temperature_degC == pytest.approx(plant.advance(clock.now()), abs=0.1)
    assert (reading.mode, reading.alarms, device.ignored_requests) == ("CONSTANT", (), 0)
    assert chamber.safe_state() == safe
    device.inject(ChamberFault(ChamberFaultKind.SILENCE, begins_s=clock.now(), times=None))
    began_s = clock.now()
    with pytest.raises(DeviceTimeout, match="sim://chamber"):
        chamber.read()
    assert clock.now() - began_s < 60.0


@_every("hil.effects")
def test_an_effect_that_is_brought_says_what_it_is(name: str) -> None:
    """It stands in the catalogue under an id of its own, with everything that a report prints of it."""
    made = loaded(brought("hil.effects")[name])
    own = made() if isinstance(made, type) else made
    assert [each.id for each in entries()].count(own.id) == 1, f"{own.id} is the id of another effect"
    assert all((own.title, own.equation, own.parameters, own.signature, own.experiment))
    assert set(own.confusable_with) <= {each.id for each in entries()}


@pytest.mark.parametrize("group", ["hil.positioners", "hil.frames"])
def test_positioners_and_frame_descriptions_that_are_brought_can_be_loaded(group: str) -> None:
    """A positioner is made on a bench, by the tests marked hardware; frames are read as a bench would."""
    for name, point in brought(group).items():
        entry = loaded(point)
        assert callable(entry) or load_description(entry).frames, name
