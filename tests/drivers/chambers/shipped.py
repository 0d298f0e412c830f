"""Drivers and simulators of the descriptions that ship with the drivers, made as a driver of code would be."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

from drivers.chambers import CHAMBER_DRIVERS
from drivers.chambers.controllers.described import SetpointBox
from drivers.chambers.controllers.description import BoxDescription, load_box
from drivers.clock import Clock
from drivers.simulators.chambers.described import SimulatedRegisterBox, SimulatedSetpointBox
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports import Transport


def shipped(name: str, framing: str | None = None, **otherwise: float) -> BoxDescription:
    """Return the description of a driver, by the name that a bench file gives it; some of it may be `otherwise`."""
    path = CHAMBER_DRIVERS[name].description
    assert path is not None
    return load_box(path, framing=framing).model_copy(update=otherwise)


def espec(transport: Transport, clock: Clock, **settings: Any) -> SetpointBox:
    """Return the driver of an ESPEC, as a bench file says it is spoken to."""
    path = CHAMBER_DRIVERS["espec"].description
    assert path is not None
    return SetpointBox(transport, clock, load_box(path, **settings))


def simulated_espec(
    plant: ChamberPlant,
    says: Mapping[str, Any] = MappingProxyType({}),
    spoken: Mapping[str, Any] = MappingProxyType({}),
    gl: bool = False,
    **settings: Any,
) -> SimulatedSetpointBox:
    """Return a simulated ESPEC, `spoken` to as a bench file says it.

    `says` is what it answers otherwise than its description says. A `gl` acknowledges with its address, in small
    letters.
    """
    path = CHAMBER_DRIVERS["espec"].description
    assert path is not None
    box = load_box(path, **spoken)
    if gl:
        setpoint = box.setpoint.model_copy(update={"confirm": ("OK:1,temp,s{value:.1f}",)})
        start = (box.start[0], box.start[1].model_copy(update={"confirm": ("OK:1,mode,constant",)}))
        box = box.model_copy(update={"setpoint": setpoint, "start": start})
    simulated = box.simulated.model_copy(update={"answers": box.simulated.answers | dict(says)})
    return SimulatedSetpointBox(plant, box.model_copy(update={"simulated": simulated}), **settings)


def watlow_f4(transport: Transport, clock: Clock, **settings: Any) -> SetpointBox:
    """Return the driver of an F4."""
    return SetpointBox(transport, clock, shipped("watlow-f4", **settings))


def watlow_f4t(transport: Transport, clock: Clock, **settings: Any) -> SetpointBox:
    """Return the driver of an F4T."""
    return SetpointBox(transport, clock, shipped("watlow-f4t", **settings))


def ezt570i(transport: Transport, clock: Clock) -> SetpointBox:
    """Return the driver of an EZT-570i."""
    return SetpointBox(transport, clock, shipped("ezt-570i"))


def simulated_f4(plant: ChamberPlant, framing: str | None = None, **settings: Any) -> SimulatedRegisterBox:
    """Return a simulated F4."""
    return SimulatedRegisterBox(plant, shipped("watlow-f4", framing), **settings)


def simulated_f4t(plant: ChamberPlant, framing: str | None = None, **settings: Any) -> SimulatedRegisterBox:
    """Return a simulated F4T."""
    return SimulatedRegisterBox(plant, shipped("watlow-f4t", framing), **settings)


def simulated_ezt570i(plant: ChamberPlant, **settings: Any) -> SimulatedRegisterBox:
    """Return a simulated EZT-570i."""
    return SimulatedRegisterBox(plant, shipped("ezt-570i"), **settings)


def thermotron(transport: Transport, clock: Clock) -> SetpointBox:
    """Return the driver of a Thermotron."""
    return SetpointBox(transport, clock, shipped("thermotron"))


def simulated_thermotron(
    plant: ChamberPlant, *, replies: Literal["echo", "code"] = "code", **settings: Any
) -> SimulatedSetpointBox:
    """Return a simulated 8800, or an 8200 that echoes a setpoint and answers RUNM and STOP with nothing."""
    box = shipped("thermotron")
    if replies == "echo":
        silent = tuple(each.model_copy(update={"confirm": ()}) for each in (*box.start, *box.stop))
        setpoint = box.setpoint.model_copy(update={"confirm": box.setpoint.confirm[::-1]})
        box = box.model_copy(update={"setpoint": setpoint, "start": silent[:1], "stop": silent[1:]})
    return SimulatedSetpointBox(plant, box, **settings)


def julabo(transport: Transport, clock: Clock) -> SetpointBox:
    """Return the driver of a Julabo."""
    return SetpointBox(transport, clock, shipped("julabo"))


def simulated_julabo(plant: ChamberPlant, **settings: Any) -> SimulatedSetpointBox:
    """Return a simulated Julabo."""
    return SimulatedSetpointBox(plant, shipped("julabo"), **settings)


def simserv(transport: Transport, clock: Clock) -> SetpointBox:
    """Return the driver of SimServ."""
    return SetpointBox(transport, clock, shipped("simserv"))


def simulated_simserv(
    plant: ChamberPlant, says: Mapping[str, str | int] = MappingProxyType({}), **settings: Any
) -> SimulatedSetpointBox:
    """Return a simulated SimServ; `says` is what its `simulated` section says otherwise: its name, its decimals."""
    box = shipped("simserv")
    box = box.model_copy(update={"simulated": box.simulated.model_copy(update=says)})
    return SimulatedSetpointBox(plant, box, **settings)
