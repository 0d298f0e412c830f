"""The bench file: which devices stand where, how the unit is oriented at each position, and what is safe.

    bench = load_bench("simulated")
    bench.orientations(2)["1"].components(bench.site.gravity_g())   # f at position 1, along A, B, S
    bench.chamber.limits.high                                       # °C

Numbers carry their unit in the file and are plain floats here: s, °C, °C/min, deg, g, Hz. Orientations may be written
as the report's figure shows them (`{A: -1, B: +2, S: +3}`: A along minus axis 1), as a rotation of the unit from
another position (`{from: "3", rotate: -90 deg, about: 2}`), or as a matrix with one row per sensor axis.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, NonNegativeInt, PositiveInt, PrivateAttr, model_validator

from drivers.chamber import SafeState
from drivers.chambers import CHAMBER_DRIVERS, SerialLine
from drivers.voetsch_ascii import AsciiLayout
from hil.campaign import Sensor
from hil.config.faults import Fault
from hil.config.files import Section, find_config, parse_yaml, read_text, validated, validated_inside
from hil.config.notify import NotifySection
from hil.config.orientation import build_orientations
from hil.config.settings import to_settings
from hil.config.simulation import SimulationSection
from hil.config.uncertainty import UncertaintySection
from hil.config.units import Celsius, CelsiusDifference, CelsiusPerMinute, Degrees, Gravities, Hertz, Seconds
from hil.earth import Site
from hil.equation import Orientation
from hil.errors import InputError
from procedures.settings import InterlockSettings, Polling

SIMULATED_SCHEME = "sim://"
_SCHEMES = ("sim", "socket", "rfc2217")


def _port(value: object, name: str) -> str:
    text = str(value)
    if not isinstance(value, str) or not text.strip():
        raise ValueError(
            f"{value!r} is not a port; write /dev/ttyUSB0, socket://host:port, rfc2217://host:port, sim://{name}"
        )
    scheme = text.split("://", 1)[0] if "://" in text else ""
    if scheme and scheme not in _SCHEMES:
        raise ValueError(f"{text!r}: ports begin with {', '.join(f'{known}://' for known in _SCHEMES)} or are a path")
    if scheme == "sim" and text != f"sim://{name}":
        raise ValueError(f"there is no simulated port {text!r}; the simulated {name} is sim://{name}")
    if scheme in {"socket", "rfc2217"}:
        parts = urlsplit(text)
        try:
            complete = bool(parts.hostname) and parts.port is not None
        except ValueError:
            complete = False
        if not complete:
            raise ValueError(f"{text!r} lacks its host or port number; write {scheme}://host:10001")
    return text


def _labels(value: object) -> object:
    # YAML reads an unquoted 1 as a number; a position's label is text.
    return {str(label): entry for label, entry in value.items()} if isinstance(value, dict) else value


def _off_is_a_word(value: object) -> object:
    return "off" if value is False else value  # YAML 1.1 reads an unquoted off as false


ImuPort = Annotated[str, BeforeValidator(lambda value: _port(value, "imu"))]
ChamberPort = Annotated[str, BeforeValidator(lambda value: _port(value, "chamber"))]
RampPort = Annotated[str, BeforeValidator(lambda value: _port(value, "ramp"))]


_PARITIES: Mapping[str, Literal["N", "E", "O"]] = {"none": "N", "even": "E", "odd": "O"}


def _chamber_driver(value: str) -> str:
    if value not in CHAMBER_DRIVERS:
        raise ValueError(f"{value!r} is not a chamber driver; there are {', '.join(sorted(CHAMBER_DRIVERS))}")
    return value


def _settings(kind: type) -> BeforeValidator:
    return BeforeValidator(lambda given: to_settings(given, kind))


def _plain_name(value: str) -> str:
    if not re.fullmatch(r"[\w.+-]+", value):
        raise ValueError(f"{value!r} is not a name; use letters, digits, '.', '_', '+' and '-'")
    return value


class UnitSection(Section):
    """The unit under test as its label says; the controller refuses another one."""

    model: str
    serial: str


class SiteSection(Section):
    """Where the bench stands and how level it is. G2 and G3 are what axes 2 and 3 measure of gravity at rest."""

    latitude: Degrees
    heading: Degrees
    G2: Gravities | None = None
    G3: Gravities | None = None
    axis_2_elevation: Degrees | None = None
    axis_3_elevation: Degrees | None = None

    @model_validator(mode="after")
    def _one_description_of_level(self) -> SiteSection:
        by_gravity = self.G2 is not None or self.G3 is not None
        by_angle = self.axis_2_elevation is not None or self.axis_3_elevation is not None
        if by_gravity and by_angle:
            raise ValueError("give G2 and G3, or axis_2_elevation and axis_3_elevation, not both")
        if max(abs(self.G2 or 0.0), abs(self.G3 or 0.0)) > 0.5:
            raise ValueError("G2 and G3 are components of a nearly level bench and must be within 0.5 g")
        self.site()  # the remaining limits are the site's own
        return self

    def site(self) -> Site:
        """Return the site, which knows gravity and earth rate in the bench frame."""
        if self.G2 is not None or self.G3 is not None:
            return Site.from_gravity(self.latitude, self.heading, self.G2 or 0.0, self.G3 or 0.0)
        return Site(self.latitude, self.heading, self.axis_2_elevation or 0.0, self.axis_3_elevation or 0.0)


def _site(given: object) -> Site:
    return validated_inside(SiteSection, given).site()


class SensorSection(Section):
    """A sensor's axes, the axis that each channel measures about, and its orientation at each position."""

    axes: tuple[str, str, str]
    channels: dict[str, str] = Field(min_length=1)
    orientations: Annotated[dict[str, Any], BeforeValidator(_labels)] = Field(min_length=1)
    assumed: bool = False

    @model_validator(mode="after")
    def _hangs_together(self) -> SensorSection:
        if len(set(self.axes)) != 3:
            raise ValueError(f"axes: three different names are needed, not {', '.join(self.axes)}")
        for channel, axis in self.channels.items():
            if axis not in self.axes:
                raise ValueError(f"channels.{channel}: there is no axis {axis!r}; allowed: {', '.join(self.axes)}")
        _ = self.built
        return self

    @cached_property
    def built(self) -> Mapping[str, Orientation]:
        """The orientation at each position."""
        return build_orientations(self.orientations, self.axes)


class ImuSection(Section):
    """The IMU's port and stream, and who turns the unit. Baud and rate are the description's where they are not given.

    `parameters` are what the description asks for and the stream does not tell (a range, a unit of the rates). `codes`
    are the unit's own numbers for the positions (position "3" is its number 3 where nothing is said), and
    `instructions` tell an operator how the unit lies at each.
    """

    description: str
    port: ImuPort
    baud: PositiveInt | None = None
    rate: Annotated[Hertz, Field(gt=0.0)] | None = None
    parameters: dict[str, bool | int | float | str] = Field(default_factory=dict)
    positioner: Literal["indexing", "operator"]
    codes: Annotated[dict[str, int], BeforeValidator(_labels)] = Field(default_factory=dict)
    instructions: Annotated[dict[str, str], BeforeValidator(_labels)] = Field(default_factory=dict)


class LimitsSection(Section):
    """The range in which the bench may set the chamber."""

    low: Celsius
    high: Celsius

    @model_validator(mode="after")
    def _ordered(self) -> LimitsSection:
        if self.low >= self.high:
            raise ValueError(f"low ({self.low:g} °C) must be below high ({self.high:g} °C)")
        return self


class SafeStateSection(Section):
    """How the chamber may be left alone: it holds a temperature, or stands by, or is switched off."""

    action: Annotated[Literal["hold", "standby", "off"], BeforeValidator(_off_is_a_word)]
    temperature: Celsius | None = None


def _safe_state(given: object) -> SafeState:
    section = validated_inside(SafeStateSection, given)
    return SafeState(section.action, section.temperature)


class AsciiLayoutSection(Section):
    """What the values and bits of an ASCII-2 chamber are, for one that is no VT 4002. Bits count from 0 on the left."""

    pairs: PositiveInt = 5
    nominal_first: bool = True
    written: PositiveInt = 5
    bits: PositiveInt = 16
    start_bit: NonNegativeInt = 1
    channel_bit: NonNegativeInt | None = 3
    error_bit: NonNegativeInt = 2


def _layout(given: object) -> AsciiLayout | None:
    return None if given is None else AsciiLayout(**validated_inside(AsciiLayoutSection, given).model_dump())


class ChamberSection(Section):
    """The chamber's port, its controller, its limits and its safe state.

    `model` is how the controller's answer to who it is must begin. The controller's own limits are set `native_margin`
    beyond the bench's. `celsius_confirmed` says that a person has seen °C on its panel, which the protocol cannot tell.
    Line settings, address, terminator and Modbus framing are those with which the maker ships it where they are not
    given. `ramp_port` is a second port of the controller, for one that sets its ramp there.
    `ramp` bounds how fast the setpoint moves, by the controller where it can. `dead_man` arms the controller's own
    timer; at least 10 min, because it is renewed only now and then. `description` is the file of a `box`: a chamber
    without a driver of its own. `layout` says what the values and bits of an ASCII-2 chamber are.
    """

    driver: Annotated[str, AfterValidator(_chamber_driver)]
    port: ChamberPort
    baud: PositiveInt | None = None
    data_bits: Literal[7, 8] | None = None
    parity: Literal["none", "even", "odd"] | None = None
    address: NonNegativeInt | None = None
    terminator: Literal["CR", "LF", "CR LF"] | None = None
    framing: Literal["rtu", "tcp"] | None = None
    ramp_port: RampPort | None = None
    ramp: Annotated[CelsiusPerMinute, Field(gt=0.0)] | None = None
    dead_man: Annotated[Seconds, Field(ge=600.0)] | None = None
    description: str | None = None
    layout: Annotated[AsciiLayout | None, BeforeValidator(_layout)] = None
    model: str = ""
    celsius_confirmed: bool = False
    limits: LimitsSection
    native_margin: CelsiusDifference = 5.0
    safe_state: Annotated[SafeState, BeforeValidator(_safe_state)]

    @property
    def line(self) -> SerialLine:
        """The serial line: the maker's settings, and what the file says instead."""
        shipped = CHAMBER_DRIVERS[self.driver].line
        parity = shipped.parity if self.parity is None else _PARITIES[self.parity]
        return SerialLine(self.baud or shipped.baud, self.data_bits or shipped.data_bits, parity)

    @property
    def terminator_bytes(self) -> bytes | None:
        """What ends a line, None for the driver's own."""
        return None if self.terminator is None else {"CR": b"\r", "LF": b"\n", "CR LF": b"\r\n"}[self.terminator]

    @model_validator(mode="after")
    def _only_a_box_is_described(self) -> ChamberSection:
        if (self.driver == "box") != (self.description is not None):
            raise ValueError("description: a box needs the file that describes it, other drivers have none")
        if self.dead_man is not None and not CHAMBER_DRIVERS[self.driver].dead_man:
            having = " and ".join(name for name, driver in CHAMBER_DRIVERS.items() if driver.dead_man)
            raise ValueError(f"dead_man: {self.driver} has no timer of its own; {having} can have one; leave it out")
        if self.layout is not None and self.driver != "voetsch-ascii2":
            raise ValueError("layout: only voetsch-ascii2 has layouts that differ")
        return self

    @model_validator(mode="after")
    def _a_ramp_port_goes_with_its_chamber(self) -> ChamberSection:
        if self.ramp_port is None:
            return self
        if self.driver != "watlow-f4t":
            raise ValueError("ramp_port: only watlow-f4t sets its ramp on a port of its own; leave it out")
        if self.ramp_port.startswith(SIMULATED_SCHEME) != self.port.startswith(SIMULATED_SCHEME):
            raise ValueError("ramp_port: simulated with the chamber, or neither; the simulated one is sim://ramp")
        return self

    @model_validator(mode="after")
    def _safe_is_within_limits(self) -> ChamberSection:
        held = self.safe_state.temperature_degC
        if held is not None and not self.limits.low <= held <= self.limits.high:
            raise ValueError(
                f"safe_state.temperature: {held:.4g} °C lies outside the chamber's limits "
                f"{self.limits.low:.4g} … {self.limits.high:.4g} °C"
            )
        return self


class RecordSection(Section):
    """What is kept of a night besides the averages."""

    raw: bool = True
    series_block: Seconds = Field(default=1.0, gt=0.0)


class Bench(Section):
    """A bench, as its file describes it."""

    name: Annotated[str, AfterValidator(_plain_name)]
    title: str = ""
    unit: UnitSection
    clock: Literal["system", "virtual"]
    site: Annotated[Site, BeforeValidator(_site)]
    sensors: dict[int, SensorSection] = Field(min_length=1)
    imu: ImuSection
    chamber: ChamberSection
    interlocks: Annotated[InterlockSettings, _settings(InterlockSettings)] = InterlockSettings()
    polling: Annotated[Polling, _settings(Polling)] = Polling()
    record: RecordSection = RecordSection()
    uncertainties: UncertaintySection = UncertaintySection()
    notify: NotifySection | None = None
    simulation: SimulationSection | None = None
    faults: tuple[Fault, ...] = ()

    _text: str = PrivateAttr(default="")
    _source: str = PrivateAttr(default="")

    @model_validator(mode="after")
    def _simulation_belongs_to_simulated_ports(self) -> Bench:
        if self.faults and self.simulation is None:
            raise ValueError("faults: only what is simulated can be told to fail; there is no simulation section")
        for key, port in (("imu.port", self.imu.port), ("chamber.port", self.chamber.port)):
            if port.startswith(SIMULATED_SCHEME) and self.simulation is None:
                raise ValueError(f"{key}: {port} needs a simulation section, which says what is simulated")
            if self.clock == "virtual" and not port.startswith(SIMULATED_SCHEME):
                raise ValueError(
                    f"clock: a virtual clock cannot drive the real port {port} ({key}); write clock: system"
                )
        return self

    @property
    def text(self) -> str:
        """The YAML text that this bench was read from: what a record keeps."""
        return self._text

    @property
    def source(self) -> str:
        """The file that this bench was read from."""
        return self._source

    @property
    def simulated(self) -> bool:
        """True where the devices are simulated, in process or behind a port: the data must say so."""
        return self.simulation is not None

    def sensor(self, number: int) -> Sensor:
        """Return a sensor's layout, as the equation and campaigns use it."""
        section = self.sensors[number]
        return Sensor(number, section.axes, dict(section.channels))

    def orientations(self, number: int) -> Mapping[str, Orientation]:
        """Return the orientation of a sensor at each position."""
        return self.sensors[number].built

    @property
    def positions(self) -> tuple[str, ...]:
        """The positions in which the orientation of every sensor is known."""
        tables = [section.built for section in self.sensors.values()]
        return tuple(label for label in tables[0] if all(label in table for table in tables))

    @property
    def position_codes(self) -> Mapping[str, int]:
        """The unit's own number of each position."""
        codes = self.imu.codes
        return {
            label: codes.get(label, int(label) if label.isdigit() else place)
            for place, label in enumerate(self.positions, 1)
        }

    @cached_property
    def imu_description(self) -> Path:
        """The frame description of the IMU; raises `InputError` where there is none of this name."""
        return self._named_file("imus", "imu.description", self.imu.description)

    @cached_property
    def simulation_model(self) -> Path | None:
        """The model file of the simulated unit, None for a real one; raises `InputError` where there is none."""
        if self.simulation is None:
            return None
        return self._named_file("models", "simulation.model", self.simulation.model)

    @cached_property
    def chamber_description(self) -> Path | None:
        """The description of a box, None for other chambers; raises `InputError` where there is none of this name."""
        if self.chamber.description is None:
            return None
        return self._named_file("chambers", "chamber.description", self.chamber.description)

    def _named_file(self, kind: str, key: str, name: str) -> Path:
        beside = Path(self._source).parent if self._source else None
        try:
            return find_config(kind, name, beside)
        except InputError as error:
            raise InputError(f"{self._source or self.name}: {key}: {error}") from error


def load_bench(name: str | Path) -> Bench:
    """Read a bench file, by path or by the name of one that ships with hil; raise `InputError` in one sentence."""
    path = find_config("benches", name)
    return parse_bench(read_text(path), str(path))


def parse_bench(text: str, source: str) -> Bench:
    """Read a bench from YAML text, such as the copy that a record kept; `source` names it in messages."""
    document = parse_yaml(text, source)
    bench = validated(Bench, document, source)
    bench._text, bench._source = text, source
    _ = bench.imu_description, bench.simulation_model, bench.chamber_description
    return bench
