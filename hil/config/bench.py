"""The bench file: which devices stand where, how the unit is oriented at each position, and what is safe.

Numbers carry their unit in the file and are plain floats here: s, °C, °C/min, deg, g, Hz. Orientations may be written
as the report's figure shows them (`{A: -1, B: +2, S: +3}`: A along minus axis 1), as a rotation of the unit from
another position (`{from: "3", rotate: -90 deg, about: 2}`), or as a matrix with one row per sensor axis.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from drivers.frames.description import StreamDescription, load_description
from drivers.strict_yaml import first_mistake
from hil.campaign import FloatArray, Sensor
from hil.campaign.data import Technology
from hil.campaign.header import hangs_together
from hil.config.chamber import ChamberSection
from hil.config.people import InstrumentSection, LaboratorySection, NotifySection, each_once
from hil.config.ports import SIMULATED_SCHEME
from hil.config.sections import settings_of
from hil.config.simulation import Fault, SimulationSection
from hil.config.site import SiteSection, UncertaintySection
from hil.config.unit import ASK, ImuSection, UnitSection, build_orientations, labels, of_each, where_listed
from hil.errors import InputError, worded
from hil.files.strict import NAME, Section, WholeFile, find_config, near, validated_inside
from hil.files.units import DegreesPerHour, Seconds
from hil.model.earth import Site
from hil.model.equation import Orientation
from procedures.pose import PoseTable, PoseTolerance
from procedures.settings import InterlockSettings, Polling


def _plain_name(value: str) -> str:
    if not re.fullmatch(r"[\w.+-]+", value):
        raise ValueError(f"{value!r} is not a name; use letters, digits, '.', '_', '+' and '-'")
    return value


_LABEL = re.compile(rf"[^\W_][ -~]{{0,{NAME - 1}}}")
"""What may be a serial number: a line that fits on a label."""
_RIGID = 0.05  # of direction cosines: three degrees


def _absolute(path: Path) -> Path:
    if not path.is_absolute():
        raise ValueError(
            f"{path}: give a whole path, such as /srv/hil/{path.name}: a night is carried on from anywhere"
        )
    return path


class SensorSection(Section):
    """A sensor's axes, the axis that each channel measures about, and its orientation at each position."""

    axes: tuple[str, str, str]
    channels: dict[str, str] = Field(min_length=1)
    technology: Technology = ""
    orientations: Annotated[dict[str, Any], BeforeValidator(labels)] = Field(min_length=1)
    assumed: bool = False

    def _check(self) -> None:
        hangs_together(self.axes, self.channels)
        hands = {label: np.linalg.det(each.axes) > 0.0 for label, each in self.built.items()}
        first = next(iter(hands))
        for label, right in hands.items():
            if right != hands[first]:
                raise ValueError(
                    f"orientations.{label}: the mirror image of position {first}: no unit can be turned so; see signs"
                )

    @cached_property
    def built(self) -> Mapping[str, Orientation]:
        """The orientation at each position."""
        return build_orientations(self.orientations, self.axes)


class RecordSection(Section):
    """What is kept of a night besides the averages, and the file with the key that signs its journal's head."""

    raw: bool = True
    key: Annotated[Path, AfterValidator(_absolute)] | None = None
    series_block: Seconds = Field(default=1.0, gt=0.0, le=86400.0)


class Bench(WholeFile):
    """A bench, as its file describes it."""

    folder = "benches"
    name: Annotated[str, AfterValidator(_plain_name)]
    title: str = ""
    unit: UnitSection
    clock: Literal["system", "virtual"]
    site: Annotated[Site, BeforeValidator(lambda given: validated_inside(SiteSection, given).site())]
    sensors: dict[int, SensorSection] = Field(min_length=1)
    imu: ImuSection
    chamber: ChamberSection
    interlocks: Annotated[InterlockSettings, settings_of(InterlockSettings)] = InterlockSettings()
    polling: Annotated[Polling, settings_of(Polling)] = Polling()
    pose: Annotated[PoseTolerance, settings_of(PoseTolerance)] = PoseTolerance()
    largest_standard_error: Annotated[DegreesPerHour, Field(gt=0.0)] | None = None
    limits: str | None = None  # of the unit's parameters: a file, where the sweep names none
    archive: Annotated[Path, AfterValidator(_absolute)] | None = None  # where its nights are taken up at their end
    record: RecordSection = RecordSection()
    uncertainties: UncertaintySection = UncertaintySection()
    laboratory: LaboratorySection | None = None
    equipment: Annotated[tuple[InstrumentSection, ...], AfterValidator(each_once)] = ()
    notify: NotifySection | None = None
    simulation: SimulationSection | None = None
    faults: tuple[Fault, ...] = ()
    units: dict[str, Bench] = Field(default_factory=dict)  # by serial number, where several are listed

    @model_validator(mode="before")
    @classmethod
    def _units_are_benches(cls, given: object) -> object:
        if not isinstance(given, dict) or "units" not in given:
            return given
        own = of_each(given)
        units = {}
        for place, (serial, bench) in enumerate(own.items()):
            try:
                units[serial] = cls.model_validate(bench)
            except ValidationError as error:
                raise ValueError(where_listed(first_mistake(error, bench), given["units"][place], place)) from None
        return {**next(iter(own.values())), "faults": given.get("faults", ()), "units": units}

    @property
    def each(self) -> Mapping[str, Bench]:
        """The bench as each unit has it, by the unit's name: its serial number, or nothing where none is listed."""
        return self.units or {"": self}

    @classmethod
    def parse(cls, text: str, source: str) -> Self:
        """Read from YAML text; `source` names it in messages. Raises `InputError` in one sentence, no `ValueError`."""
        found = super().parse(text, source)
        for each in found.each.values():
            each._source = source
            _ = each.imu_description, each.simulation_model, each.chamber_description
        return found

    def _check(self) -> None:
        """Raise `ValueError` where real ports are simulated, or simulated ones are not; or sensors are no one body."""
        if self.faults and self.simulation is None:
            raise ValueError("faults: only what is simulated can be told to fail; there is no simulation section")
        for number, fault in enumerate(self.faults):
            if fault.unit not in ("", *self.units):
                raise ValueError(
                    f"faults.{number}.unit: there is no unit {fault.unit!r}{near(fault.unit, [*self.units])}"
                )
        for key, port in (("imu.port", self.imu.port), ("chamber.port", self.chamber.port)):
            if port.startswith(SIMULATED_SCHEME) and self.simulation is None:
                raise ValueError(f"{key}: {port} needs a simulation section, which says what is simulated")
            if self.clock == "virtual" and not port.startswith(SIMULATED_SCHEME):
                raise ValueError(
                    f"clock: a virtual clock cannot drive the real port {port} ({key}); write clock: system"
                )
        (first, of), *others = self.sensors.items()
        for number, each in others:
            stands = {at: of.built[at].axes @ each.built[at].axes.T for at in of.built if at in each.built}
            for label, so in stands.items():
                if np.abs(so - next(iter(stands.values()))).max() > _RIGID:
                    raise ValueError(
                        f"sensors.{number}.orientations.{label}: sensor {number} stands otherwise to sensor {first} "
                        f"than at position {next(iter(stands))}, and they are one body: one of the four is wrong"
                    )

    @property
    def simulated(self) -> bool:
        """True where the devices are simulated, in process or behind a port: the data must say so."""
        return self.simulation is not None

    def of_unit(self, serial: str) -> Bench:
        """Return the bench with the serial number that somebody read; `InputError` where the bench names another."""
        if not _LABEL.fullmatch(serial):
            raise InputError(f"{serial[:80]!r} is no serial number: one line of at most {NAME} plain characters")
        if self.unit.serial not in ("", ASK, serial):
            raise InputError(f"{self._source}: unit.serial: it says {self.unit.serial}, and {serial} was typed; which?")
        return self.model_copy(update={"unit": self.unit.model_copy(update={"serial": serial})})

    def sensor(self, number: int) -> Sensor:
        """Return a sensor's layout, as the equation and campaigns use it."""
        section = self.sensors[number]
        return Sensor(number, section.axes, dict(section.channels), section.technology)

    def along_axes(self, number: int, positions: Iterable[str]) -> dict[str, FloatArray]:
        """Return gravity, g, and earth rate, deg/hr, along a sensor's axes at n positions, (n, 3), as `Conditions`."""
        lies = [self.sensors[number].built[label] for label in positions]
        known = {"f_g": self.site.gravity_g(), "w_deg_per_hr": self.site.earth_rate_deg_per_hr()}
        return {name: np.array([each.components(of) for each in lies]) for name, of in known.items()}

    @property
    def poses(self) -> PoseTable:
        """What the accelerometers of every sensor should show at each position."""
        gravity_g = self.site.gravity_g()
        shown = {
            label: np.array([section.built[label].components(gravity_g) for section in self.sensors.values()])
            for label in self.positions
        }
        return PoseTable({number: section.axes for number, section in self.sensors.items()}, shown, self.pose)

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
    def frames(self) -> StreamDescription:
        """What the IMU sends; raises `InputError` where the description cannot be used."""
        return load_description(self.imu_description, parameters=self.imu.parameters, sample_rate_hz=self.imu.rate)

    @property
    def asks_serial(self) -> bool:
        """Whether the unit's serial number has to be asked for."""
        return self.unit.serial == ASK and not self.frames.tells_serial

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

    def outside(self, degC: float) -> str:
        """Say that the chamber may not be set to a temperature; empty where it may."""
        low, high = self.chamber.limits.low_degC, self.chamber.limits.high_degC
        said = f"{degC:.4g} °C lies outside the limits of bench {self.name}'s chamber, {low:.4g} … {high:.4g} °C"
        return "" if low <= degC <= high else said

    def _named_file(self, kind: str, key: str, name: str) -> Path:
        beside = Path(self._source).parent if self._source else None
        with worded(InputError, f"{self._source or self.name}: {key}: ", InputError):
            return find_config(kind, name, beside)


parse_bench = Bench.parse


def load_bench(name: str | Path) -> Bench:
    """Read a bench file, by path or by the name of one that ships with hil; raise `InputError` in one sentence."""
    return Bench.load(name)
