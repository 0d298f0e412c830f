"""A night as a campaign folder (hil.campaign/1): what `hil solve`, reconcile and any spreadsheet work from.

There is one row for each collect and sensor. `collect` is unique within the file, so that two sensors of one collect
have two numbers; both have the same start. Known acceleration and earth rate are the bench file's orientation table
applied to its site; nothing in them is measured. A night that is not complete is exported as far as it got.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drivers.given_file import check_folder
from hil.campaign import Campaign, Collects, Conditions, FloatArray, Sensor, Series
from hil.campaign.formats import Format, write_file
from hil.campaign.plausibility import judged_by_its_records
from hil.campaign.reader import HEADER_FILE, read_campaign
from hil.campaign.stand_ins import OWN, instead_of_temperature, not_recorded
from hil.campaign.writer import write_campaign
from hil.config import Bench
from hil.config.recorded import bench_of_record
from hil.errors import Damaged, InputError
from hil.files.durable import is_new, whole_or_nothing
from hil.files.strict import near
from hil.model.forms import parameter_names
from hil.records.blocks import SAMPLES, Block, read_samples
from hil.records.damage import refuse_damaged_samples
from hil.records.reader import JOURNAL_NAME, JournalReader, is_night, reading
from hil.records.rows import Attempt
from hil.records.status import in_brief, missing_in_words
from hil.records.units import place_of, unit_folder
from procedures.journal_protocol import Outcome, StepResult
from procedures.plan import Step, StepKind
from procedures.verdict import Judgement, Verdict, combine, self_calibration_verdict
from procedures.words import listed, numbered

_MEANINGS = {
    "supply_V": "supply voltage at the unit's terminals, volt",
    "spin_period_us": "period of one turn of the sensor's rotor, microsecond",
}
_STEP_COLUMNS: tuple[str, ...] = ("chamber_degC", "setpoint_degC", "time_since_power_on_s", "time_since_setpoint_s")
_STEP_COLUMNS += ("time_since_index_s", "n_samples")
_CHAMBERS_DIGIT_DEGC = 0.051  # half of the tenth to which chambers keep a setpoint
_SITE = ("latitude_deg", "heading_deg", "axis_2_elevation_deg", "axis_3_elevation_deg")
_SENSOR_COLUMNS = ("temperature_degC", "dTdt_degC_per_min")
_NAMED = 4  # folders inside one that is none of these


@dataclass(frozen=True)
class _Row:
    """One row of collects.csv: a collect of the night seen by one sensor, what was recorded of it, and its samples."""

    number: int
    sensor: int
    step: Step
    data: Mapping[str, Any]
    samples: Block | None

    @property
    def start_s(self) -> float:
        return float(self.data["start_s"])

    @property
    def record(self) -> Any:
        return self.data["sensors"][str(self.sensor)]


def export_campaign(folder: Path | str, out: Path | str, form: Format | None = None) -> tuple[int, Sequence[str]]:
    """Write the collects of a night as a new campaign folder `out`, or as one file of another format.

    Returns the number of rows, and in words what a reader of the campaign must know.
    Of several units each has its own within `out`, by its serial number, or the one named by its folder. A campaign
    folder is written as a file only, whole or not at all. Raises `InputError` where the folder is neither, no collect
    was completed, or `out` exists; `Damaged` where the journal or samples are not what was written.
    """
    folder, target = Path(folder), Path(out)
    if form is not None and not is_night(folder):
        write_file(campaign := open_source(folder), target, form)
        return sum(map(len, campaign.sensors.values())), ()
    night, named = place_of(folder)
    with reading(folder) as journal:
        units = journal.plan.units
    if units != [named] and not is_new(target):
        raise InputError(f"{target}: it exists and is not empty; name a new folder")
    rows, notes = 0, list[str]()
    with nullcontext(target) if units == [named] else whole_or_nothing(target) as into:
        for unit in units:
            mark = f"unit {unit}: " if unit != named else ""
            own = into if unit == named else into / (unit if form is None else f"{unit}{target.suffix}")
            try:
                campaign = campaign_of_night(unit_folder(night, unit))
                if form is None:
                    write_campaign(campaign, own)
                else:
                    write_file(campaign, own, form)
            except InputError as error:
                if isinstance(error, Damaged) or unit == named:
                    raise
                notes.append(f"{mark}{error}")
                continue
            rows += sum(map(len, campaign.sensors.values()))
            missing = f"The night is not complete; missing: {'; '.join(campaign.missing)}."
            said = [*campaign.notes.splitlines(), *([missing] if campaign.missing else ())]
            notes += [f"{mark}{note}" for note in said]
        if not rows:
            raise InputError(notes[0])
    return rows, notes


def campaign_of_night(folder: Path | str) -> Campaign:
    """Return the collects of a night as a campaign in memory; raises `InputError` as `export_campaign` does."""
    folder = Path(folder)
    with reading(folder) as journal:
        return _campaign(journal)


def _verdicts(
    journal: JournalReader, done: Mapping[str, StepResult], taken: Mapping[str, Attempt]
) -> dict[int, Judgement]:
    """Return how each self-calibration was measured; one in which somebody set the clock is MARGINAL at best."""
    jumps = [event for event in journal.events() if event.kind == "wall-clock-jump"]
    verdicts = {}
    for number, steps in journal.plan.self_calibrations.items():
        judged, times = self_calibration_verdict(steps, done), [taken[step.key] for step in steps if step.key in taken]
        during = [
            Judgement(Verdict.MARGINAL, f"{jump.message}: the times of its records do not belong together")
            for jump in jumps
            if times and min(each.began_s for each in times) <= jump.at_s <= max(each.ended_s or 0.0 for each in times)
        ]
        verdicts[number] = combine([judged, *during], passed=judged.reason)
    return verdicts


def open_source(folder: Path | str) -> Campaign:
    """Read a night or a campaign folder; raise `InputError` where it is neither, or as these do."""
    folder = Path(folder)
    if is_night(folder):
        return campaign_of_night(folder)
    if (folder / HEADER_FILE).is_file():
        campaign = read_campaign(folder)
        names = {name for each in campaign.sensors.values() for name in parameter_names(each.conditions.sensor)}
        for name in (each for each in campaign.taken_as_zero if each not in names):
            known = near(name, sorted(names))
            raise InputError(f"{folder / HEADER_FILE}, key taken_as_zero: {name!r} is no parameter{known}")
        return campaign
    neither = f"neither a campaign folder (no {HEADER_FILE}) nor a night (no {JOURNAL_NAME})"
    check_folder(folder)
    inside = sorted(each.name for each in folder.iterdir() if (each / HEADER_FILE).is_file() or is_night(each))
    holds = f"; name one that it holds: {listed(inside, _NAMED)}" if inside else ""
    raise InputError(f"{folder}: {neither}{holds}")


def _campaign(journal: JournalReader) -> Campaign:
    bench = bench_of_record(journal.night.configuration).each[journal.one_unit]
    refuse_damaged_samples(journal)
    done, attempts = journal.completed(), journal.attempts()
    taken = {each.step_key: each for each in attempts if each.outcome is Outcome.DONE}
    collects = [(step, taken[step.key]) for step in journal.plan.of_kind(StepKind.COLLECT) if step.key in taken]
    collects.sort(key=lambda each: float(each[1].data["start_s"]))
    verdicts = _verdicts(journal, done, taken)
    if not collects:
        raise InputError(
            f"{journal.folder}: no collect of this night was completed, so there is nothing to export or to analyse"
        )
    # A unit may stream sensors that the bench file does not orient: their rates mean nothing without f and w.
    seen = [(n, *each) for each in collects for n in sorted(bench.sensors) if str(n) in each[1].data["sensors"]]
    samples = {(row.step_key, row.attempt): row.block for row in journal.blocks() if row.block.kind == SAMPLES}
    rows = [
        _Row(number, sensor, step, of.data, samples.get((step.key, of.attempt)))
        for number, (sensor, step, of) in enumerate(seen, start=1)
    ]
    night = journal.night
    tables = {n: _of_sensor([row for row in rows if row.sensor == n], bench, n) for n in sorted({n for n, *_ in seen})}
    columns = {name for table in tables.values() for name in table.conditions.columns}
    axes = dict.fromkeys(axis for number in bench.sensors for axis in bench.sensor(number).axes)
    shown = {f"accelerometer_{axis}_g": f"mean of the unit's own accelerometer along {axis}, g" for axis in axes}
    identity = journal.identity()
    recorded = f"recorded by hil on bench {bench.name} from {night.began_utc:%Y-%m-%d %H:%M} UTC, by {night.who}"
    unit = f"unit {identity['serial']}" if "serial" in identity else ""
    seed = f"seed {bench.simulation.seed}" if bench.simulation else ""  # clocks of simulated nights all begin alike
    campaign = Campaign(
        title=night.title,
        source=", ".join(filter(None, (recorded, unit, seed))),
        sensors=tables,
        condition_units={name: meaning for name, meaning in (_MEANINGS | shown).items() if name in columns},
        simulated=night.simulated,
        site={name: getattr(bench.site, name) for name in _SITE},
        notes="\n".join(_notes(journal, bench, rows, done, verdicts)),
        recorded={
            row.number: partial(_samples, journal.folder, row.samples, bench.sensor(row.sensor), row.start_s)
            for row in rows
            if row.samples
        },
        series_block_s=bench.record.series_block,
        verdicts=verdicts,
        warnings=[
            not_recorded(rows.conditions, OWN, other[0])
            for rows in tables.values()
            if (other := instead_of_temperature(rows.conditions))
        ],
        missing=in_brief(missing_in_words(journal.plan, done, attempts)),
        identity=identity,
        pose=bench.pose,
        largest_se=bench.largest_standard_error,
    )
    return judged_by_its_records(campaign)


def _of_sensor(rows: Sequence[_Row], bench: Bench, number: int) -> Collects:
    sensor = bench.sensor(number)
    positions = [str(row.data["position"]) for row in rows]
    conditions = Conditions(
        sensor=sensor,
        collect=np.array([row.number for row in rows], dtype=np.int64),
        run=np.array([row.step.self_calibration or 0 for row in rows], dtype=np.int64),
        position=np.array(positions, dtype=np.str_),
        start_s=np.array([row.start_s for row in rows]),
        duration_s=np.array([float(row.data["duration_s"]) for row in rows]),
        **bench.along_axes(number, positions),
        columns=_columns(rows, sensor),
    )
    return Collects(conditions, _rates(rows, sensor, "mean_deg_per_hr"), _rates(rows, sensor, "se_deg_per_hr"))


def _rates(rows: Sequence[_Row], sensor: Sensor, what: str) -> FloatArray:
    """Return one number per row and channel, NaN where it was not measured."""
    table = [[_number(row.record["rates"].get(channel, {}).get(what)) for channel in sensor.channels] for row in rows]
    return np.array(table, dtype=np.float64)


def _columns(rows: Sequence[_Row], sensor: Sensor) -> dict[str, FloatArray]:
    """Return every condition that the bench knows; a column that is empty from top to bottom is left out."""
    known: list[dict[str, Any]] = []
    for row in rows:
        data, record = row.data, row.record
        cells = {name: data.get(name) for name in _STEP_COLUMNS}
        asked, held = row.step.temperature_degC, cells["setpoint_degC"]
        if asked is not None and held is not None and abs(asked - held) <= _CHAMBERS_DIGIT_DEGC:
            cells["setpoint_degC"] = asked  # 19.7 °F, which the chamber calls -6.8 °C
        cells |= {name: record.get(name) for name in _SENSOR_COLUMNS}
        cells |= data.get("conditions", {}) | record.get("conditions", {})
        measured = record.get("accelerations", {})
        cells |= {f"accelerometer_{axis}_g": measured.get(axis) for axis in sensor.axes}
        known.append(cells)
    names = dict.fromkeys(name for cells in known for name in cells)
    columns = {name: np.array([_number(cells.get(name)) for cells in known]) for name in names}
    return {name: values for name, values in columns.items() if not np.all(np.isnan(values))}


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else float("nan")


def _notes(
    journal: JournalReader, bench: Bench, rows: Sequence[_Row], done: Collection[str], verdicts: Mapping[int, Judgement]
) -> Iterator[str]:
    """Yield what a reader of the campaign must know, one sentence per line."""
    if journal.night.simulated:
        yield "SIMULATED: these are no measurements."
    runs = journal.plan.self_calibrations
    judged = [("Collect", r.number, r.data.get("verdict"), r.data.get("reason", "")) for r in rows]
    judged += [
        ("Self-calibration", number, str(each.verdict), each.reason)
        for number, each in verdicts.items()
        if any(step.key in done for step in runs[number])
    ]
    alike: dict[tuple[str, str], list[int]] = {}
    for noun, number, verdict, reason in judged:
        if (verdict or Verdict.PASS) != Verdict.PASS:
            alike.setdefault((noun, f"judged {verdict}: {reason}."), []).append(number)
    for (noun, words), numbers in alike.items():
        yield f"{numbered(noun, numbers)} {'was' if len(numbers) == 1 else 'were'} {words}"
    yield "Acceleration and earth rate are computed from site and orientation table; 1 g is the local gravity."
    for number, section in bench.sensors.items():
        if section.assumed:
            yield f"The orientations of sensor {number} are assumed, not known."


def _samples(folder: Path, block: Block, sensor: Sensor, start_s: float) -> Series | None:
    """Read what a sensor showed within a collect; None where not all of its channels were recorded."""
    samples = read_samples(folder, block)
    rates, temperatures = (samples.of(role, sensor.number) for role in ("rate", "temperature"))
    if not all(channel in rates for channel in sensor.channels):
        return None
    good = np.stack([np.where(samples.good, rates[channel], np.nan) for channel in sensor.channels], axis=1)
    return Series(samples.time_s - start_s, good, next(iter(temperatures.values()), None))
