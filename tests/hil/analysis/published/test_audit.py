"""The audit finds what does not close in a published table, and what would mend it; it never corrects."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.published.audit import Audit, variants
from hil.analysis.published.identities import sigma_gap
from hil.analysis.published.reproduction import seven_biases
from hil.cli.app import run
from hil.errors import InputError

PARAMETERS = ("BA2_collins", "BA2_matrix", "MUB2_matrix", "BB2_collins", "BB2_matrix", "MUA2_matrix")
TABLE_1, TABLE_A1 = "rd-gc-86-1-table-1", "rd-gc-86-1-table-a1"


def where(audit: Audit, verdict: str, kind: str) -> dict[str, float]:
    """Return the residuals of one kind of identity by row and axis."""
    return {str(each.row.label): each.residual for each in audit.of(verdict) if each.identity.kind == kind}


def test_table_1_has_six_inconsistent_identities() -> None:
    """Collins less matrix is ±MU·G1: five rows close, five are minor, six do not, by the amounts of the report."""
    audit = Audit(TABLE_1)
    found = where(audit, "inconsistent", "collins - matrix = MU*G1")
    expected = {
        "6.1 degF, axis A": -2.9033,
        "6.1 degF, axis B": -0.1667,
        "19.7 degF, axis A": -0.0833,
        "19.7 degF, axis B": 0.1367,
        "43.3 degF, axis B": 0.2267,
        "120 degF, axis B": -0.5900,
    }
    assert found == pytest.approx(expected, abs=1e-6)
    assert len(where(audit, "minor", "collins - matrix = MU*G1")) == 5
    assert len(where(audit, "ok", "collins - matrix = MU*G1")) == 5


def test_the_sigmas_of_table_1_contradict_each_other_in_one_cell() -> None:
    """At 6.1 °F on axis A 3.88 - 1.4388 exceeds 1.718: the contractor's sigma must lie in 0.279 to 3.157."""
    audit = Audit(TABLE_1)
    assert where(audit, "inconsistent", "sigma triangle") == pytest.approx({"6.1 degF, axis A": 0.7232})
    broken = next(each for each in audit.of("inconsistent") if each.identity.kind == "sigma triangle")
    read = [float(each["read"]) for each in broken.candidates if each["cell"].endswith("collins sigma")]
    assert 2.88 in read
    assert all(0.279 - 0.02 <= value <= 3.157 + 0.02 for value in read)


def test_the_digits_tell_five_runs_at_one_temperature() -> None:
    """All means are multiples of 0.01/3, at 100.1 °F of 0.01/5; all 42 sigmas of three runs are possible ones."""
    audit = Audit(TABLE_1)
    assert audit.resolution == 0.01
    assert {group: told for group, told in audit.runs_told.items() if told != 3} == {"100.1 degF": 5}
    possible = [each for each in audit.findings if each.identity.kind == "sigma possible for 3 runs"]
    assert len(possible) == 42
    assert all(each.verdict == "ok" for each in possible)


@pytest.mark.parametrize(
    ("row", "cell", "read"),
    [
        ("-21.5 degF, axis A", "MUB2_matrix mean", "-7.5967"),
        ("-21.5 degF, axis A", "BA2_matrix mean", "22.0100"),
        ("19.7 degF, axis A", "BA2_matrix mean", "21.5067"),
        ("43.3 degF, axis B", "BB2_collins mean", "-28.9933"),
        ("43.3 degF, axis B", "MUA2_matrix mean", "23.6533"),
        ("74.1 degF, axis A", "BA2_collins mean", "17.7833"),
        ("120 degF, axis B", "BB2_matrix mean", "34.1000"),
    ],
)
def test_single_digits_that_would_mend_table_1(row: str, cell: str, read: str) -> None:
    """The candidates that a reader of the page should look at."""
    finding = next(
        each
        for each in Audit(TABLE_1).findings
        if each.row.label == row and each.identity.kind == "collins - matrix = MU*G1"
    )
    assert (cell, read) in {(each["cell"], each["read"]) for each in finding.candidates}


def test_two_rows_of_table_1_cannot_be_mended_by_a_digit() -> None:
    """At 6.1 and 19.7 °F on axis B no single reading closes the identity, and none is invented."""
    audit = Audit(TABLE_1)
    for row in ("6.1 degF, axis B", "19.7 degF, axis B"):
        finding = next(each for each in audit.of("inconsistent") if each.row.label == row)
        assert not finding.candidates
        assert finding.would_close


def test_rows_2_and_9_of_table_a1_are_inconsistent() -> None:
    """A-32 of row 2 must be 10.4250 given the others; A-33 of row 9 should be 18.526; the rest is minor."""
    audit = Audit(TABLE_A1)
    assert {each.row.label for each in audit.of("inconsistent")} == {2, 9}
    second, ninth = audit.of("inconsistent")
    assert second.identity.name == "A-28 - A-31 = A-32 - A-29"
    assert [(each["cell"], each["value"]) for each in second.would_close if each["others_hold"]] == [("A-32", 10.4250)]
    assert ninth.residual == pytest.approx(18.6149 - 18.5258, abs=3e-4)
    assert {each.row.label for each in audit.of("minor")} == {1, 4, 5, 7, 8, 10}
    seventh = next(each for each in audit.of("minor") if each.row.label == 7)
    assert seventh.candidates[0]["read"] == "20.1918"


def test_the_tilts_of_table_a1_are_those_of_three_set_ups() -> None:
    """G3/G1 is -0.013 to -0.017 in rows 1-3, 6-8 and 10, -0.006 in rows 4 and 5, and an outlier in row 9."""
    rows = {row["row"]: row["G3_over_G1"] for row in Audit(TABLE_A1).document()["rows"]}
    assert all(-0.017 < rows[row] < -0.013 for row in (1, 2, 3, 6, 7, 8, 10))
    assert rows[4] == pytest.approx(-0.00545, abs=1e-5)
    assert rows[5] == pytest.approx(-0.00587, abs=1e-5)
    assert rows[9] == pytest.approx(-0.0418, abs=1e-4)


@pytest.mark.parametrize("name", ["table1.csv", "table_a1.csv"])
def test_the_shipped_tables_have_the_printed_digits(reference: Path, name: str) -> None:
    """Every digit and every flag of the transcription, and the same audit."""
    shipped = Audit({"table1.csv": TABLE_1, "table_a1.csv": TABLE_A1}[name])
    ours = list(csv.DictReader(shipped.table.path.read_text().splitlines()))
    theirs = list(csv.DictReader((reference / name).read_text().splitlines()))
    assert [{key: row[key] for key in ours[0]} for row in theirs] == ours
    raw = Audit(reference / name).document()
    assert raw["identities"] == [
        {**each, "cells": raw["identities"][place]["cells"]}
        for place, each in enumerate(shipped.document()["identities"])
    ]


def consistent_table(rng: np.random.Generator, temperatures: int = 4) -> list[dict[str, str]]:
    """Return a table in the layout of Table 1, from three runs each at 0.01 deg/hr, printed to four digits."""
    rows = []
    for place in range(temperatures):
        for axis, sign in (("A", 1), ("B", -1)):
            matrix = np.round(rng.normal(10 * place, 3.0, 3), 2)
            mu = np.round(rng.normal(0.0, 8.0, 3), 2)
            contractor = np.round(matrix + sign * mu, 2)
            names = (f"B{axis}2_collins", f"B{axis}2_matrix", "MUB2_matrix" if axis == "A" else "MUA2_matrix")
            for name, runs in zip(names, (contractor, matrix, mu), strict=True):
                cells = {"mean_printed": f"{np.mean(runs):.4f}", "sigma_printed": f"{np.std(runs, ddof=1):.4f}"}
                rows.append({"temperature_F": str(20.0 * place), "parameter": name, **cells, "n_stated": "3"})
    return rows


def write(path: Path, rows: list[dict[str, str]]) -> Path:
    """Write a CSV."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


@pytest.mark.slow
def test_a_seeded_error_in_a_mean_is_found_with_its_true_reading(tmp_path: Path) -> None:
    """In 40 random tables: clean ones are clean; one wrong digit is found in its row, and the truth is a candidate."""
    rng = np.random.default_rng(11)
    for _ in range(40):
        rows = consistent_table(rng)
        assert not [each for each in Audit(write(tmp_path / "t.csv", rows)).findings if each.verdict != "ok"]
        victim = int(rng.integers(len(rows)))
        truth = rows[victim]["mean_printed"]
        changed = [text for text, _ in variants(truth) if abs(float(text) - float(truth)) > 0.15]
        rows[victim]["mean_printed"] = str(rng.choice(changed))
        broken = Audit(write(tmp_path / "t.csv", rows)).of("inconsistent")
        hit = [each for each in broken if each.identity.kind == "collins - matrix = MU*G1"]
        assert len(hit) == 1
        assert rows[victim]["parameter"] in {cell.what.split()[0] for cell in hit[0].row.cells.values()}
        assert truth in {each["read"] for each in hit[0].candidates if each["printed"] == rows[victim]["mean_printed"]}


def test_a_seeded_error_in_table_a1_is_found(tmp_path: Path) -> None:
    """In 40 random runs with tilt and a wrong GSA: clean ones are clean, a wrong digit in any but A-30 is found."""
    rng = np.random.default_rng(12)
    for _ in range(40):
        tilt, gsa, mub = rng.uniform(0.01, 0.03), rng.normal(0.0, 30.0), rng.choice([-1, 1]) * rng.uniform(3.0, 25.0)
        w = np.array([8.5, 10.7, 6.2])
        true = np.array([19.0 - gsa + mub * tilt, 19.0 + gsa - mub * tilt, 19.0 + gsa * tilt + mub])
        ra = true + np.array([-w[0], w[0], w[2]])
        rates = np.stack([ra, np.zeros(3)], -1)
        seven = seven_biases(rates, [1.0, 0.0, tilt], w, gsa + rng.normal(0.0, 0.3), 0.0, mub)
        row = {f"A{27 + place}_printed": f"{value:.4f}" for place, value in enumerate(seven)}
        clean = Audit(write(tmp_path / "a.csv", [row]))
        assert not clean.of("inconsistent"), row
        victim = f"A{rng.choice([27, 28, 29, 31, 32, 33])}_printed"
        wrong = [text for text, _ in variants(row[victim]) if 0.2 < abs(float(text) - float(row[victim])) < 5.0]
        seeded = Audit(write(tmp_path / "a.csv", [{**row, victim: str(rng.choice(wrong))}]))
        assert seeded.of("inconsistent")
        assert any(row[victim] == each["read"] for found in seeded.of("inconsistent") for each in found.candidates)


def test_a_wrong_digit_in_a_sigma_breaks_its_lattice() -> None:
    """Three runs 1.23, 4.56, 7.91 have the sigma 3.3402 with n - 1, and not 3.3442."""
    runs = np.array([1.23, 4.56, 7.91])
    assert sigma_gap(float(np.mean(runs)), round(float(np.std(runs, ddof=1)), 4), 0.01) < 5e-5
    assert sigma_gap(float(np.mean([1.23, 4.56, 7.91])), 0.0042, 0.01) > 1e-3


def test_readings_are_one_digit_the_sign_or_two_neighbours() -> None:
    """Nothing else, and the point stays where it is."""
    found = dict(variants("-1.2"))
    assert found["1.2"] == "sign"
    assert found["-2.1"] == "1 and 2 transposed"
    assert found["-7.2"] == "1 read as 7"
    assert len(found) == 1 + 18 + 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n", "neither the layout of Table 1"),
        (
            "temperature_F,parameter,mean_printed\n1.0,BA2_collins,x\n",
            "row 2, column mean_printed: 'x' is not a number",
        ),
        ("temperature_F,parameter,mean_printed\n1.0,BA2_collins,1.0\n", "matrix and mu not printed"),
        ("temperature_F,parameter,mean_printed\n1.0,GSA,1.0\n", "no parameter is named like BA2_collins"),
        (
            "temperature_F,parameter,mean_printed\n1.0,BA2_collins,1.0\n1.0,BA2_collins,1.1\n",
            "row 3, column parameter: BA2_collins at 1.0 degF stands there twice",
        ),
        ("temperature_F,parameter,mean_printed,sigma_printed\n1.0,BA2_matrix,1.0,-2\n", "a sigma cannot be negative"),
        ("temperature_F,parameter,mean_printed,n_stated\n1.0,BA2_matrix,1.0,some\n", "'some' is not a number of runs"),
    ],
)
def test_bad_tables_are_refused_with_file_row_and_column(tmp_path: Path, text: str, words: str) -> None:
    """One sentence that says where and what."""
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as raised:
        Audit(path)
    assert str(path) in str(raised.value)


def test_sigmas_and_the_number_of_runs_may_be_missing(tmp_path: Path) -> None:
    """What is not printed is not checked; what is, is."""
    lines = ["temperature_C,parameter,mean_printed,sigma_printed", "20,BA_collins,12.00,", "20,BA_matrix,10.00,1.5"]
    path = tmp_path / "few.csv"
    path.write_text("\n".join([*lines, "20,MUB,-2.00,"]) + "\n")
    audit = Audit(path)
    assert [(each.identity.kind, round(each.residual, 6)) for each in audit.of("inconsistent")] == [
        ("collins - matrix = MU*G1", 4.0)
    ]
    assert [each["read"] for each in audit.of("inconsistent")[0].candidates if each["change"] == "sign"] == ["2.00"]


def test_an_unknown_table_is_refused_with_those_that_ship() -> None:
    """The names are in the message."""
    with pytest.raises(InputError, match=TABLE_A1):
        Audit("table-7")


def test_the_command_prints_the_contract(capsys: pytest.CaptureFixture[str]) -> None:
    """The keys of the contract, for programs; and text for people, with the reading that would mend a cell."""
    assert run(["audit", TABLE_1, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "hil.audit/1"
    assert {"row", "identity", "residual", "tolerance", "verdict"} <= set(document["identities"][0])
    assert "6 of 16 inconsistent" in document["summary"]
    assert run(["audit", TABLE_1]) == 0
    assert "34.7000 read as 34.1000" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("table", "row", "identity", "cell", "value"),
    [
        ("rd-gc-86-1-table-a1", 1, "A-27 =", "A-27", 13.9643),
        ("rd-gc-86-1-table-a1", 1, "A-33 =", "A-33", 13.9616),
        ("rd-gc-86-1-table-1", "6.1 degF, axis A", "BA_collins", "BA2_collins mean", 34.1833),
    ],
)
def test_two_faults_in_a_row_do_not_hide_what_would_mend_each(
    table: str, row: object, identity: str, cell: str, value: float
) -> None:
    """The one value that closes an identity without breaking what holds is named, though another line stays broken."""
    finding = next(
        each for each in Audit(table).findings if each.row.label == row and each.identity.name.startswith(identity)
    )
    alone = [each for each in finding.would_close if each["others_hold"]]
    assert [each["cell"] for each in alone] == [cell]
    assert alone[0]["value"] == pytest.approx(value, abs=1e-4)
