"""The chamber's section of a bench file: its port, its controller, its limits and its safe state."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, NonNegativeInt, PositiveInt

from drivers.chambers import CHAMBER_DRIVERS, ChamberLimits, SafeState
from drivers.chambers.catalogue import SerialLine, WarningLimits
from drivers.chambers.controllers.voetsch_ascii import AsciiLayout
from drivers.chambers.setpoints import COLDEST_POSSIBLE_DEGC, HOTTEST_POSSIBLE_DEGC
from drivers.transports.framing import Terminator
from hil.config.ports import SIMULATED_SCHEME, ChamberPort
from hil.config.sections import settings_of
from hil.files.strict import Section
from hil.files.units import CelsiusDifference, CelsiusPerMinute, Seconds
from procedures.words import listed

_USUAL_DEAD_MAN_S = 3 * 3600.0
_PARITIES: Mapping[str, Literal["N", "E", "O"]] = {"none": "N", "even": "E", "odd": "O"}
_OF_ONE_DRIVER = {
    "layout": ("voetsch-ascii2", "has layouts that differ"),
    "warning_limits": ("julabo", "has them under parameters that differ"),
}


def _chamber_driver(value: str) -> str:
    if value not in CHAMBER_DRIVERS:
        raise ValueError(f"{value!r} is not a chamber driver; there are {', '.join(sorted(CHAMBER_DRIVERS))}")
    return value


def _possible(limits: ChamberLimits) -> ChamberLimits:
    low, high = limits.low_degC, limits.high_degC
    if low >= high:
        raise ValueError(f"low ({low:g} °C) must be below high ({high:g} °C)")
    for name, value in (("low", low), ("high", high)):
        if not COLDEST_POSSIBLE_DEGC <= value <= HOTTEST_POSSIBLE_DEGC:
            raise ValueError(
                f"{name}: no chamber that these drivers know reaches {value:.4g} °C; a reading outside "
                f"{COLDEST_POSSIBLE_DEGC:g} … {HOTTEST_POSSIBLE_DEGC:g} °C would be taken for a broken sensor"
            )
    return limits


class ChamberSection(Section):
    """The chamber's port, its controller, its limits and its safe state.

    `model` is how the controller's answer to who it is must begin. The controller's own limits are set `native_margin`
    beyond the bench's. `celsius_confirmed` says that a person has seen °C on its panel, which the protocol cannot tell.
    Line settings, address, terminator and Modbus framing are those with which the maker ships it where they are not
    given. `ramp` bounds how fast the setpoint moves, by the controller where it can. `dead_man` arms the controller's
    own timer; at least 10 min, because it is renewed only now and then; null for not at all (`night_dead_man`).
    `description` is the file of a `box`: a chamber without a driver of its own. `layout` says what the values and
    bits of an ASCII-2 chamber are, `warning_limits` under which parameters a Julabo has its own limits.
    """

    driver: Annotated[str, AfterValidator(_chamber_driver)]
    port: ChamberPort
    baud: PositiveInt | None = None
    data_bits: Literal[7, 8] | None = None
    parity: Literal["none", "even", "odd"] | None = None
    address: NonNegativeInt | None = None
    terminator: Terminator | None = None
    framing: Literal["rtu", "tcp"] | None = None
    ramp: Annotated[CelsiusPerMinute, Field(gt=0.0, le=100.0)] | None = None
    dead_man: Annotated[Seconds, Field(ge=600.0, le=7 * 86400.0)] | None = None
    description: str | None = None
    layout: Annotated[AsciiLayout, settings_of(AsciiLayout)] | None = None
    warning_limits: WarningLimits | None = None
    model: str = ""
    celsius_confirmed: bool = False
    limits: Annotated[ChamberLimits, settings_of(ChamberLimits), AfterValidator(_possible)]
    native_margin: Annotated[CelsiusDifference, Field(le=100.0)] = 5.0
    safe_state: Annotated[SafeState, settings_of(SafeState)]

    @property
    def line(self) -> SerialLine:
        """The serial line: the maker's settings, and what the file says instead."""
        shipped = CHAMBER_DRIVERS[self.driver].line
        parity = shipped.parity if self.parity is None else _PARITIES[self.parity]
        return SerialLine(self.baud or shipped.baud, self.data_bits or shipped.data_bits, parity)

    @property
    def night_dead_man(self) -> float | None:
        """The timer of a night, s: the file's, or 3 h for a real chamber that may have one and need not hold."""
        may = CHAMBER_DRIVERS[self.driver].dead_man and not self.port.startswith(SIMULATED_SCHEME)
        usual = _USUAL_DEAD_MAN_S if may and self.safe_state.action != "hold" else None
        return self.dead_man if "dead_man" in self.model_fields_set else usual

    @property
    def spoken(self) -> dict[str, Any]:
        """How it is spoken to, as `drivers.chambers.catalogue.Spoken` has it, but for the file that describes a box."""
        return {name: getattr(self, name) for name in ("address", "framing", "layout", "terminator", "warning_limits")}

    def _check(self) -> None:
        if (self.driver == "box") != (self.description is not None):
            raise ValueError("description: a box needs the file that describes it, other drivers have none")
        if self.dead_man is not None and not CHAMBER_DRIVERS[self.driver].dead_man:
            having = listed(name for name, driver in CHAMBER_DRIVERS.items() if driver.dead_man)
            raise ValueError(f"dead_man: {self.driver} has no timer of its own; {having} can have one; leave it out")
        for key, (driver, why) in _OF_ONE_DRIVER.items():
            if getattr(self, key) is not None and self.driver != driver:
                raise ValueError(f"{key}: only {driver} {why}; leave it out")
        held, low, high = self.safe_state.temperature_degC, self.limits.low_degC, self.limits.high_degC
        if held is not None and not low <= held <= high:
            raise ValueError(
                f"safe_state.temperature: {held:.4g} °C lies outside the chamber's limits {low:.4g} … {high:.4g} °C"
            )
