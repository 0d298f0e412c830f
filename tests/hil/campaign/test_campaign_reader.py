"""Campaign folders as people write them: what is read, what is warned about, what is refused and in which words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.campaign.reader import read_campaign
from hil.errors import InputError

YAML = """\
schema: hil.campaign/1
title: Two nights
source: by hand
sensors:
  2:
    axes: [A, B, S]
    channels: {RA: A, RB: B}
conditions:
  supply_V: supply voltage at the unit's terminals, volt
"""
HEADER = (
    "collect,run,sensor,position,start_s,duration_s,f_A_g,f_B_g,f_S_g,w_A_deg_per_hr,w_B_deg_per_hr,w_S_deg_per_hr,"
    "RA_deg_per_hr,RB_deg_per_hr,RA_se_deg_per_hr,RB_se_deg_per_hr,temperature_degC,supply_V"
)
NO_ERROR = "there is nothing in RB_se_deg_per_hr: no standard error of sensor 2 is used"
ROWS = [
    "1,1,2,1,0,60,-1,0,0,-8.54,10.72,6.19,-30.1,-46.2,0.9,0.9,23.4,28.0",
    "2,1,2,2,120,60,1,0,0,8.54,10.72,-6.19,80.3,-10.5,0.9,0.9,23.5,28.1",
    "3,1,2,3,240,60,0,0,1,6.19,10.72,8.54,20.9,21.7,0.9,0.9,23.5,28.0",
    "4,2,2,1,360,60,-1,0,0,-8.54,10.72,6.19,-30.4,-46.8,0.9,0.9,23.6,28.2",
    "5,2,2,2,480,60,1,0,0,8.54,10.72,-6.19,80.1,-10.9,0.9,0.9,23.4,28.0",
    "6,2,2,3,600,60,0,0,1,6.19,10.72,8.54,20.2,21.1,0.9,0.9,23.5,27.9",
]


def table(*rows: str, header: str = HEADER) -> str:
    """Return collects.csv as text."""
    return "\n".join([header, *rows]) + "\n"


def cell(row: int, column: str, value: str) -> str:
    """Return the good collects.csv with one cell changed; `row` as a spreadsheet counts."""
    lines = [line.split(",") for line in ROWS]
    lines[row - 2][HEADER.split(",").index(column)] = value
    return table(*(",".join(line) for line in lines))


def without(column: str) -> str:
    """Return the good collects.csv without one column."""
    j = HEADER.split(",").index(column)
    lines = [line.split(",") for line in [HEADER, *ROWS]]
    return "\n".join(",".join(line[:j] + line[j + 1 :]) for line in lines)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a good campaign folder."""
    (tmp_path / "campaign.yaml").write_text(YAML)
    (tmp_path / "collects.csv").write_text(table(*ROWS))
    return tmp_path


def test_a_hand_written_folder_is_read_whole(folder: Path) -> None:
    """Conditions, rates, errors, further columns and their units; without warnings."""
    campaign = read_campaign(folder)
    assert campaign.warnings == ()
    assert (campaign.title, campaign.source, campaign.simulated) == ("Two nights", "by hand", False)
    collects = campaign.sensors[2]
    conditions = collects.conditions
    assert conditions.sensor.is_rotor
    assert conditions.collect.tolist() == [1, 2, 3, 4, 5, 6]
    assert conditions.run.tolist() == [1, 1, 1, 2, 2, 2]
    assert conditions.position.tolist() == ["1", "2", "3"] * 2
    np.testing.assert_array_equal(conditions.f_g[1], [1, 0, 0])
    np.testing.assert_array_equal(conditions.w_channels_deg_per_hr[2], [6.19, 10.72])
    np.testing.assert_array_equal(collects.rates_deg_per_hr[0], [-30.1, -46.2])
    np.testing.assert_array_equal(collects.rates_se_deg_per_hr, 0.9)
    assert conditions.columns["supply_V"][3] == 28.2
    assert "volt" in campaign.condition_units["supply_V"]
    assert conditions.rows(conditions.run == 2).start_s.tolist() == [360, 480, 600]


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text + "\n\n,,,,,,,,,,,,,,,,,\n",
        lambda text: text.rstrip("\n"),
        lambda text: text.replace("\n", ",,\n"),
        lambda text: text.replace("collect,run", ' collect ,"run"').replace("1,1,2,1,0", " 1 ,1,2,1,0"),
    ],
    ids=[
        "byte order mark",
        "CR LF",
        "blank lines at the end",
        "no last newline",
        "empty columns at the right",
        "spaces",
    ],
)
def test_what_spreadsheets_do_to_a_file_is_tolerated(folder: Path, change: Callable[[str], str]) -> None:
    """The same campaign comes out."""
    path = folder / "collects.csv"
    path.write_bytes(change(path.read_text()).encode())
    campaign = read_campaign(folder)
    assert campaign.sensors[2].conditions.collect.tolist() == [1, 2, 3, 4, 5, 6]
    assert campaign.warnings == ()


def test_empty_cells_are_missing_and_missing_errors_are_not_stated(folder: Path) -> None:
    """A rate without a number is NaN, the row stays; a column that is not there is absent, not zero."""
    (folder / "collects.csv").write_text(cell(4, "RA_deg_per_hr", ""))
    collects = read_campaign(folder).sensors[2]
    assert np.isnan(collects.rates_deg_per_hr[2, 0])
    assert collects.rates_deg_per_hr[2, 1] == 21.7
    (folder / "collects.csv").write_text(without("RA_se_deg_per_hr"))
    collects = read_campaign(folder).sensors[2]
    assert np.all(np.isnan(collects.rates_se_deg_per_hr[:, 0]))
    (folder / "collects.csv").write_text(cell(5, "RB_se_deg_per_hr", "0"))
    assert np.isnan(read_campaign(folder).sensors[2].rates_se_deg_per_hr[3, 1])
    (folder / "collects.csv").write_text(without("temperature_degC"))
    assert "temperature_degC" not in read_campaign(folder).sensors[2].conditions.columns


def test_a_column_of_remarks_is_set_aside_and_said(folder: Path) -> None:
    """Words where no condition is declared; a number among them, or a declared column, is refused as before."""
    cells = ["", "door open for 2 min", "", "Jo", "", ""]
    lines = [f"{row},{cell}" for row, cell in zip(ROWS, cells, strict=True)]
    (folder / "collects.csv").write_text(table(*lines, header=f"{HEADER},remark"))
    campaign = read_campaign(folder)
    assert "remark" not in campaign.sensors[2].conditions.columns
    assert [each.split(", ", 1)[1] for each in campaign.warnings] == [
        "column remark: holds no number; taken as a remark, and not used"
    ]
    (folder / "collects.csv").write_text(table(*[*lines[:-1], f"{ROWS[-1]},2 degC"], header=f"{HEADER},remark"))
    with pytest.raises(InputError, match="row 3, column remark: 'door open for 2 min' is not a number"):
        read_campaign(folder)
    (folder / "collects.csv").write_text(cell(4, "supply_V", "fine"))
    with pytest.raises(InputError, match="column supply_V"):
        read_campaign(folder)


def test_two_sensors_of_different_kind_share_a_file(folder: Path) -> None:
    """A rotor sensor and a triad: each needs its own columns only, the other's cells stay empty."""
    (folder / "campaign.yaml").write_text(
        YAML.replace("conditions:", "  1:\n    axes: [X, Y, Z]\n    channels: {GZ: Z, GX: X, GY: Y}\nconditions:")
    )
    extra = ["f_X_g", "f_Y_g", "f_Z_g", "w_X_deg_per_hr", "w_Y_deg_per_hr", "w_Z_deg_per_hr"]
    extra += ["GX_deg_per_hr", "GY_deg_per_hr", "GZ_deg_per_hr"]
    rows = [row + "," * len(extra) for row in ROWS]
    rows.append("7,3,1,pose-01,700,60" + "," * 12 + ",0.6,0,-0.8,1,2,3,11,12,13")
    (folder / "collects.csv").write_text(table(*rows, header=",".join([HEADER, *extra])))
    campaign = read_campaign(folder)
    assert len(campaign.sensors[2]) == 6
    triad = campaign.sensors[1]
    assert list(triad.conditions.sensor.channels) == ["GX", "GY", "GZ"]
    assert triad.rates_deg_per_hr.tolist() == [[11, 12, 13]]
    assert triad.conditions.columns == {}


def test_channels_may_be_listed_in_any_order(folder: Path) -> None:
    """The parameters belong to axes, so the order of channels in the file changes nothing."""
    before = read_campaign(folder).sensors[2].rates_deg_per_hr
    (folder / "campaign.yaml").write_text(YAML.replace("{RA: A, RB: B}", "{RB: B, RA: A}"))
    np.testing.assert_array_equal(read_campaign(folder).sensors[2].rates_deg_per_hr, before)


def test_a_title_turns_no_line(folder: Path) -> None:
    """What would reverse the writing, or steer a terminal, is replaced before it reaches a terminal or a page."""
    (folder / "campaign.yaml").write_text(YAML.replace("Two nights", '"night \\u202Egnp.exe \\x1B[2J"'))
    assert read_campaign(folder).title == "night \ufffdgnp.exe \ufffd[2J"


@pytest.mark.parametrize("mark", ["simulated: true", "notes: 'SIMULATED: these are no measurements.'"])
def test_simulated_data_stays_marked(folder: Path, mark: str) -> None:
    """`simulated: true` is kept; where somebody took it away, the notes still say so."""
    (folder / "campaign.yaml").write_text(f"{YAML}{mark}\n")
    assert read_campaign(folder).simulated


REFUSED_TABLES = {
    "missing required column": (without("f_B_g"), r"collects\.csv, row 1: column f_B_g is missing"),
    "missing rate column": (without("RB_deg_per_hr"), r"row 1: column RB_deg_per_hr is missing"),
    "missing earth rate": (without("w_S_deg_per_hr"), r"row 1: column w_S_deg_per_hr is missing"),
    "missing sensor": (without("sensor"), r"row 1: column sensor is missing"),
    "semicolons": (table(*ROWS).replace(",", ";"), "semicolons"),
    "decimal commas": (table(*ROWS).replace(",", ";").replace(".", ","), "semicolons"),
    "tabs": (table(*ROWS).replace(",", "\t"), "row 1: the columns are separated by tabs; commas are needed"),
    "a line above the names": (
        "sep=,\n" + table(*ROWS),
        "row 1: 'sep=' names no columns, as the first row must; take out",
    ),
    "a comment above the names": ("# mine\n" + table(*ROWS), "row 1: '# mine' names no columns"),
    "capitals": (
        table(*ROWS, header=HEADER.replace("RA_deg", "ra_deg")),
        r"column RA_deg_per_hr is missing; ra_deg_per_hr is not RA_deg_per_hr",
    ),
    "typographer's minus": (cell(3, "RA_deg_per_hr", "−80.3"), r"'−80.3' is not a number \(its minus sign is no -\)"),
    "thousands": (cell(3, "RA_deg_per_hr", '"1,080.3"'), r"not a number \(use a point as .*, and none between"),
    "quotation mark": (cell(3, "RA_deg_per_hr", '"80.3'), r'no CSV \(.*\); is a " there that is not closed'),
    "text for a number": (cell(3, "RA_deg_per_hr", "n/a"), r"row 3, column RA_deg_per_hr: 'n/a' is not a number"),
    "decimal comma": (cell(3, "RA_deg_per_hr", '"80,3"'), r"row 3, .*'80,3' is not a number \(use a point"),
    "underscore": (cell(3, "RA_deg_per_hr", "8_0"), "row 3, column RA_deg_per_hr: '8_0' is not a number"),
    "text in a condition": (cell(5, "supply_V", "low"), r"row 5, column supply_V: 'low' is not a number"),
    "infinite": (cell(3, "RB_deg_per_hr", "inf"), r"row 3, column RB_deg_per_hr: 'inf' is not finite"),
    "nan": (cell(3, "RB_deg_per_hr", "NaN"), r"row 3, column RB_deg_per_hr: 'NaN' is not finite"),
    "far too large": (
        cell(3, "RB_deg_per_hr", "1e308"),
        r"row 3, column RB_deg_per_hr: '1e308' is larger than anything",
    ),
    "infinite condition": (cell(6, "supply_V", "1e999"), r"row 6, column supply_V: '1e999' is not finite"),
    "duplicate collect": (cell(6, "collect", "2"), r"row 6, column collect: collect 2 already stands in row 3"),
    "collect not whole": (cell(6, "collect", "2.5"), r"row 6, column collect: '2\.5' is not a whole number"),
    "collect negative": (cell(6, "collect", "-2"), r"row 6, column collect: -2 is negative"),
    "empty run": (cell(2, "run", ""), r"row 2, column run: the cell is empty"),
    "empty position": (cell(2, "position", ""), r"row 2, column position: the cell is empty"),
    "empty f": (cell(2, "f_S_g", ""), r"row 2, column f_S_g: the cell is empty"),
    "empty w": (cell(2, "w_S_deg_per_hr", ""), r"row 2, column w_S_deg_per_hr: the cell is empty.*0 where"),
    "unknown sensor": (cell(4, "sensor", "7"), r"row 4, column sensor: sensor 7 is not described"),
    "f too small": (cell(4, "f_S_g", "0.4"), r"row 4, column f_A_g, f_B_g, f_S_g: \|f\| is 0\.400 g"),
    "f too large": (cell(2, "f_A_g", "-1.6"), r"row 2, .*\|f\| is 1\.600 g, outside 0\.5 to 1\.5 g; is it in g"),
    "below absolute zero": (cell(2, "temperature_degC", "-300"), r"row 2, column temperature_degC: -300 °C is below"),
    "no duration": (cell(2, "duration_s", "0"), r"row 2, column duration_s: .* more than 0 s"),
    "negative error": (cell(2, "RA_se_deg_per_hr", "-1"), r"row 2, column RA_se_deg_per_hr: .* negative"),
    "no error is as small": (cell(2, "RA_se_deg_per_hr", "1e-320"), r"row 2, column RA_se_deg_per_hr: .* as small"),
    "cut off": (table(*ROWS)[:-30], r"row 7, column \w+: the row ends before this column"),
    "too many cells": (table(*ROWS[:2], ROWS[2] + ",99"), r"row 4: 19 cells under 18 columns; '99'"),
    "column twice": (table(*ROWS, header=HEADER.replace("supply_V", "run")), r"row 1: column run stands there twice"),
    "column without name": (table(*ROWS, header=HEADER.replace("run", "")), r"row 1: column number 2 has no name"),
    "no rows": (table(), r"row 2: there is no collect"),
    "empty": ("", r"collects\.csv: the file is empty"),
}


@pytest.mark.parametrize("case", REFUSED_TABLES)
def test_bad_tables_are_refused_by_file_row_and_column(folder: Path, case: str) -> None:
    """One sentence, in which the place can be found."""
    text, message = REFUSED_TABLES[case]
    (folder / "collects.csv").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_campaign(folder)
    assert "collects.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_all_empty_channel_is_refused_with_its_rows(folder: Path) -> None:
    """A channel that was never measured does not belong in the header."""
    rows = []
    for row in ROWS:
        cells = row.split(",")
        cells[HEADER.split(",").index("RB_deg_per_hr")] = ""
        rows.append(",".join(cells))
    (folder / "collects.csv").write_text(table(*rows))
    with pytest.raises(InputError, match=r"rows 2-7, column RB_deg_per_hr: no cell is filled for sensor 2"):
        read_campaign(folder)


def test_rows_are_counted_as_a_spreadsheet_does(folder: Path) -> None:
    """A blank line counts as a row, and a line break inside a quoted cell does not."""
    text = table(*ROWS[:2], "", *ROWS[2:]).replace(",1,0,60", ',"pose\n1",0,60')
    (folder / "collects.csv").write_text(text.replace("21.7", "x"))
    with pytest.raises(InputError, match="row 5, column RB_deg_per_hr: 'x'"):
        read_campaign(folder)


REFUSED_HEADERS = {
    "unknown schema": (YAML.replace("campaign/1", "campaign/2"), "key schema: it is 'hil.campaign/2'"),
    "no schema": (YAML.replace("schema: hil.campaign/1\n", ""), "key schema: it is missing"),
    "no sensors": ("schema: hil.campaign/1\n", "key sensors"),
    "misspelt": (YAML.replace("sensors:", "sensrs:"), "sensors: this key is missing; nothing is known of sensrs"),
    "not YAML": ("schema: [", "not valid YAML"),
    "a list": ("- 1\n", "must be a mapping"),
    "two axes": (YAML.replace("[A, B, S]", "[A, B]"), r"sensors\.2\.axes: must have at least 3 entries"),
    "axes alike": (YAML.replace("[A, B, S]", "[A, B, B]"), r"sensors\.2\.axes: three different names"),
    "unknown axis": (YAML.replace("RB: B", "RB: Q"), r"sensors\.2\.channels\.RB: there is no axis 'Q'"),
    "no channels": (YAML.replace("{RA: A, RB: B}", "{}"), r"sensors\.2\.channels"),
    "sensor's name": (YAML.replace("  2:", "  two:"), r"sensors\.two: must be a whole number, not 'two'"),
    "unknown technology": (
        YAML.replace("channels:", "technology: laser\n    channels:"),
        r"sensors\.2\.technology: 'laser' is not allowed; allowed: '', 'rotor', 'DTG', 'RLG', 'FOG', 'MEMS' or 'gas'",
    ),
    "unknown key of a sensor": (
        YAML.replace("channels:", "chanels: {}\n    channels:"),
        "sensors.2: unknown key 'chanels'; did you mean 'channels'",
    ),
    "two columns of one name": (YAML.replace("RB: B", "w_A: B"), "would share the column w_A_deg_per_hr"),
    "site": (YAML + "site: {latitude_deg: north}\n", r"key site\.latitude_deg: must be a number, not 'north'"),
    "no place on earth": (YAML + "site: {latitude_deg: 134.6}\n", r"site: latitude_deg 134\.6: it must be from -90 to"),
    "simulated": (YAML + "simulated: perhaps\n", "key simulated"),
}


@pytest.mark.parametrize("case", REFUSED_HEADERS)
def test_bad_headers_are_refused_by_file_and_key(folder: Path, case: str) -> None:
    """Schema, sensors, axes and channels are checked before any row."""
    text, message = REFUSED_HEADERS[case]
    (folder / "campaign.yaml").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_campaign(folder)
    assert "campaign.yaml" in str(caught.value)


def test_files_that_are_not_there_or_not_text_are_refused(folder: Path) -> None:
    """No folder, no header, no table, UTF-16 and Latin-1."""
    with pytest.raises(InputError, match="there is no such folder"):
        read_campaign(folder / "nowhere")
    (folder / "collects.csv").write_bytes(table(*ROWS).encode("utf-16"))
    with pytest.raises(InputError, match="UTF-8"):
        read_campaign(folder)
    (folder / "collects.csv").write_bytes(table(*ROWS).replace("23.4", "23.4°").encode("latin-1"))
    with pytest.raises(InputError, match="not UTF-8"):
        read_campaign(folder)
    (folder / "collects.csv").unlink()
    with pytest.raises(InputError, match=r"collects\.csv: there is no such file"):
        read_campaign(folder)
    (folder / "campaign.yaml").unlink()
    with pytest.raises(InputError, match=r"campaign\.yaml: there is no such file"):
        read_campaign(folder)


def test_a_centrifuge_may_exceed_the_limits(folder: Path) -> None:
    """|f| of 4 g is no mistake there, and no warning."""
    (folder / "campaign.yaml").write_text(YAML + "centrifuge: true\n")
    text = table(*ROWS).replace(",-1,0,0,", ",-4,0,0,")
    (folder / "collects.csv").write_text(text)
    assert read_campaign(folder).warnings == ()


WARNED_TABLES = {
    "row of zeros": (
        table(*ROWS[:3], ROWS[3].replace("-30.4,-46.8", "0,0"), *ROWS[4:]),
        "collect 4: sensor 2: every rate is exactly 0: nothing was measured; a missing collect is an empty cell",
    ),
    "f off by more than 2 %": (cell(4, "f_S_g", "1.03"), r"row 4: \|f\| is off 1 g by more than 2 %"),
    "label and f disagree": (
        table(*ROWS, "7,3,2,3,720,60,0,0,-1,-6.19,10.72,-8.54,10,20,0.9,0.9,23.5,28"),
        "collect 7: sensor 2: the distance of f, g, from the usual, is 2, where at most 0.1 belongs by the others",
    ),
    "channel never changes": (
        table(*(",".join([*row.split(",")[:12], "5", *row.split(",")[13:]]) for row in ROWS)),
        "collects 1–6: sensor 2: RA: every rate is exactly 5: nothing was measured",
    ),
    "not chronological": (cell(6, "start_s", "305"), "row 6, column start_s: earlier"),
    "one error column gone": (without("RB_se_deg_per_hr") + "\n", NO_ERROR),
    "one error column empty": (table(*(row.replace(",0.9,0.9,", ",0.9,,") for row in ROWS)), NO_ERROR),
    "no temperature": (without("temperature_degC") + "\n", "has a temperature: all 2 runs count as made at one"),
    "error of zero": (cell(5, "RA_se_deg_per_hr", "0"), "row 5, column RA_se_deg_per_hr: a standard error of 0"),
    "faster than the Earth": (
        cell(5, "w_B_deg_per_hr", "100"),
        "collect 4: sensor 2: the size of w is 100.55, where at most 15.141 belongs by the earth rate",
    ),
    "temperature in K": (
        table(*(",".join([*row.split(",")[:16], "296.4", *row.split(",")[17:]]) for row in ROWS)),
        "column temperature_degC: 296.4 °C; is that column in °C?",
    ),
    "temperature of one run missing": (
        table(
            *(",".join([*row.split(",")[:16], "" if row[2] == "2" else "23", *row.split(",")[17:]]) for row in ROWS),
            header=HEADER.replace("supply_V", "setpoint_degC"),
        ),
        "sensor 2: temperature_degC is not recorded in run 2; setpoint_degC stands in for it",
    ),
    "temperature of one row missing": (
        cell(2, "temperature_degC", ""),
        "sensor 2, row 2: no temperature_degC, and nothing that stands in for it: nothing there is asked to follow it",
    ),
    "undeclared column": (
        table(*ROWS, header=HEADER.replace("supply_V", "fan_rpm")),
        "column fan_rpm: campaign.yaml does not say",
    ),
}


@pytest.mark.parametrize("case", WARNED_TABLES)
def test_suspicious_but_legal_input_is_imported_with_a_warning_that_names_its_rows(folder: Path, case: str) -> None:
    """Exactly one warning, and all rows are there."""
    text, message = WARNED_TABLES[case]
    (folder / "collects.csv").write_text(text)
    campaign = read_campaign(folder)
    assert len(campaign.warnings) == 1, campaign.warnings
    (warning,) = campaign.warnings
    assert message.replace("\\", "") in warning
    assert len(campaign.sensors[2]) == text.count("\n") - 1


def test_unknown_keys_and_unused_sensors_are_said(folder: Path) -> None:
    """They may be a misspelling."""
    (folder / "campaign.yaml").write_text(
        YAML.replace("conditions:", "  1:\n    axes: [X, Y, Z]\n    channels: {GX: X}\nconditions:") + "opperator: Al\n"
    )
    campaign = read_campaign(folder)
    assert len(campaign.warnings) == 2
    assert "opperator" in campaign.warnings[0]
    assert "sensor 1 is described but has no row" in campaign.warnings[1]
    assert list(campaign.sensors) == [2]
