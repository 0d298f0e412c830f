"""A published table becomes the collects that it must have come from, digits and doubts kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.published.audit import Audit
from hil.analysis.published.table import read_published_table
from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.fit import fit_thermal
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.cli.coefficients import budget
from hil.cli.data import solve
from hil.design.visibility.document import campaign_document
from hil.errors import InputError
from hil.model import built_in_model
from hil.model.curve import Constant
from hil.reconcile.scattering import what_scatters
from hil.records.export import open_source
from hil.report.content import gather
from hil.solve import solve_campaign
from hil.solve.omissions import AS_ZERO, in_words, what_is_wrong
from hil.solve.repeats import OF_MEANS

HEADER = "temperature_C,parameter,mean_printed,sigma_printed,n_stated,flag\n"
ROWS = [
    "20.0,BA2_matrix,10.0,1.2,3,ok",
    "20.0,BA2_collins,14.0,3.0,3,inconsistent",
    "20.0,BB2_matrix,-5.0,1.0,3,ok",
    "20.0,BB2_collins,-7.0,2.0,3,ok",
]


def table(folder: Path, rows: list[str]) -> Path:
    """Write a table."""
    path = folder / "table.csv"
    path.write_text(HEADER + "\n".join(rows) + "\n")
    return path


def test_the_matrix_solution_of_the_rebuilt_collects_is_the_printed_one(tmp_path: Path) -> None:
    """B is the mean of Collects 1 and 2, MUB and -MUA are what Collect 3 has more; the errors are the printed ones."""
    solution = solve_campaign(read_published_table(table(tmp_path, ROWS)))[0].parameters
    assert solution["BA"].value == pytest.approx(10.0)
    assert solution["BB"].value == pytest.approx(-5.0)
    assert solution["MUB"].value == pytest.approx(4.0)
    assert solution["MUA"].value == pytest.approx(2.0)
    assert solution["BA"].se == pytest.approx(1.2 / np.sqrt(3))


def test_of_what_is_not_printed_nothing_is_said_to_be_found(tmp_path: Path) -> None:
    """GSA and GSB are taken as zero, in the folder too: so every command says, and states no ± of them."""
    at = [[f"{degC}{row[row.index(',') :]}" for row in ROWS] for degC in (0, 20, 40)]
    made = read_published_table(table(tmp_path, [row for rows in at for row in rows]))
    campaign = read_campaign(write_campaign(made, tmp_path / "campaign"))
    assert f"GSA and GSB: {AS_ZERO}" in in_words(what_is_wrong(campaign))
    for answer in (solve(tmp_path / "campaign"), budget(str(tmp_path / "campaign"), draws=100)):
        lines = repr(answer).splitlines()
        assert f"GSA and GSB: {AS_ZERO}" in lines
        assert [{"GSA", "GSB"} & {*line.split()} for line in lines if {"BA", "MUA"} <= {*line.split()}] == [set()]
    solved, curves = solve_campaign(campaign)[0], fit_thermal(campaign)
    assert solved.covariance.shape == (4, 4)
    assert {*solved.parameters} == {*thermal_document(curves)["sensors"][0]["parameters"]} == {"BA", "BB", "MUA", "MUB"}
    of_all = solve_campaign(campaign, "matrix-6-thermal")[0].parameters
    assert {name.partition("_per_")[0] for name in of_all} == {*solved.parameters}
    (report,) = gather(campaign, None).sensors
    assert report.shown.names == ("BA", "BB", "MUA", "MUB")
    assert curves.model().sensors[2]["GSA"] == Constant(unit="deg/hr/g", value=0.0)
    assert not [text for text in in_words(what_is_wrong(replace(campaign, taken_as_zero=()))) if AS_ZERO in text]


def test_what_would_show_in_what_was_taken_as_zero_is_not_promised(reference: Path) -> None:
    """Collects 1 and 2 are copies of one mean: no GS of any run differs between them, and none is moved."""
    campaign = read_published_table(reference / "table1.csv")
    seen, measured = (
        {each["id"]: each for each in campaign_document(one, built_in_model("matrix-6"), ())["effects"]}
        for one in (campaign, replace(campaign, taken_as_zero=()))
    )
    gone = [name for name, each in measured.items() if each["visible"] and not seen[name]["visible"]]
    assert gone == ["GS_T"]  # what is 0 grows in no proportion, taken or not
    assert {name for each in seen.values() for name in each["leaks"]} == {"BA", "BB", "MUA", "MUB"}


def test_what_the_printed_runs_scattered_by_is_in_every_error_whoever_is_asked(tmp_path: Path) -> None:
    """And with a model also what that states; the earth rate, which the table's values are without, is in none."""
    write_campaign(read_published_table(table(tmp_path, ROWS)), campaign := tmp_path / "campaign")
    (known := tmp_path / "model.yaml").write_text(
        "{schema: hil.model/1, title: mine, form: matrix-6, noise: {2: {run_to_run: {BA: {unit: deg/hr, value: 4}}}}}"
    )
    assert campaign_document(read_campaign(campaign), changes=())["noise"]["source"] == OF_MEANS  # type: ignore[index]
    assert read_campaign(campaign).warnings == ()
    for model, stated in ((None, False), (str(known), True)):
        of_runs, sources = solve(campaign, model), budget(str(campaign), model=model, draws=100)
        assert not [each for each in of_runs.document["solutions"][0]["assumed"] if "the earth rate is given" in each]
        said, as_solved = repr(of_runs), sources.document["sensors"]["2"]["as_solved_for"]
        assert as_solved[0] == OF_MEANS
        assert [each for each in as_solved if each not in said] == []
        assert "in none of these" not in repr(sources)
        assert (len(as_solved) == 2) is stated


@pytest.mark.slow
def test_of_rows_that_are_means_of_runs_nobody_says_that_their_scatter_is_not_known(reference: Path) -> None:
    """What a smooth model leaves of them is another thing, and said."""
    said = what_scatters(read_published_table(reference / "table1.csv")).sentences()
    assert said[0].startswith(f"sensor 2: {OF_MEANS}; what is observed is what a smooth model leaves")


def test_what_is_taken_as_zero_is_a_parameter(tmp_path: Path) -> None:
    """A name that no parameter of the campaign has would be passed over in silence: the file, the key, what is near."""
    made = replace(read_published_table(table(tmp_path, ROWS)), taken_as_zero=("GSA", "GBS"))
    header = write_campaign(made, tmp_path / "campaign") / "campaign.yaml"
    with pytest.raises(InputError, match=f"^{header}, key taken_as_zero: 'GBS' is no .*did you mean 'GSB'"):
        open_source(tmp_path / "campaign")


def test_flagged_cells_are_kept_and_said(tmp_path: Path) -> None:
    """A doubtful cell is named in the notes, which stay with the campaign, and never corrected."""
    campaign = read_published_table(table(tmp_path, ROWS))
    flagged, audited = campaign.notes.splitlines()[1:]
    assert flagged == "table.csv: at 20 °C flagged inconsistent, kept as printed: BA2_collins"
    assert audited.startswith("table.csv: hil audit: no temperature has contractor's bias, matrix bias and MU")


def test_cells_that_contradict_each_other_are_said_whoever_flagged_them(tmp_path: Path) -> None:
    """The contractor's bias less the matrix bias is MUB: in the import's notes as `hil audit` says it."""
    ties = "collins - matrix = MU*G1: {} of 2 inconsistent"
    for mub, said in (("9.0", ties.format("1") + " (20.0 degC, axis A)"), ("4.0", "all 4 identities hold")):
        rows = [*ROWS, f"20.0,MUB2_matrix,{mub},2.0,3,ok", "20.0,MUA2_matrix,2.0,2.0,3,ok"]
        assert f"\ntable.csv: hil audit: {said}" in read_published_table(table(tmp_path, rows)).notes


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (ROWS[:-1], "BB2_collins"),
        ([*ROWS[:-1], "20.0,BB2_collins,x,2.0,3,ok"], "row 5, column mean_printed"),
        ([*ROWS[:-1], "20.0,BB2_collins,1.0,0.0,3,ok"], "row 5"),
        ([], "no rows"),
        ([*ROWS[:-1], "20.0,BB2_collins,nan,2.0,3,ok"], "row 5, column mean_printed: 'nan' is not finite"),
        ([*ROWS[:-1], "20.0,BB2_collins,1.0,inf,3,ok"], "row 5, column sigma_printed: 'inf' is not finite"),
        ([*ROWS[:-1], "20.0,BB2_collins,1.0,1e10,3,ok"], "row 5, column sigma_printed: 1e.10 deg/hr cannot be"),
        ([*ROWS[:-1], "20.0,BB2_collins,1.0,2.0,nan,ok"], "row 5, column n_stated: 'nan' is not finite"),
        ([*ROWS[:-1], "20.0,BB2_collins,1.0,2.0,2.5,ok"], "2.5 is not a number of runs"),
        ([*ROWS, "20.0,BB2_collins,1.0,2.0,3,ok"], "BB2_collins at 20 °C stands there twice"),
        ([*ROWS[:-1], "20.0,BB2_collins"], "row 5, column mean_printed: the row ends before"),
        ([*ROWS, "-300.0,BB2_collins,1.0,2.0,3,ok"], "-300 °C is below absolute zero"),
    ],
)
def test_a_table_that_lacks_something_is_refused(tmp_path: Path, rows: list[str], words: str) -> None:
    """One sentence with file and row."""
    with pytest.raises(InputError, match=words):
        read_published_table(table(tmp_path, rows))


def test_table_1_closes_where_its_identities_do(reference: Path, tmp_path: Path) -> None:
    """The rebuilt MUB at 43.3 °F is the printed one to 0.03; the rebuilt MUA at 120 °F is +0.14, printed as -0.45."""
    written = write_campaign(read_published_table(reference / "table1.csv"), tmp_path / "campaign")
    solutions = solve_campaign(read_campaign(written))
    assert len(solutions) == 8
    mub = solutions[3].parameters["MUB"].value
    mua = solutions[6].parameters["MUA"].value
    assert mub == pytest.approx(4.6833 - 23.05, abs=1e-4)
    assert mua == pytest.approx(34.7000 - 34.5567, abs=1e-4)


def test_a_table_in_another_unit_is_refused_by_import_and_audit(tmp_path: Path) -> None:
    """A column `unit` that says deg/s: neither the collects nor the tolerances of the identities would be right."""
    path = tmp_path / "table.csv"
    path.write_text(
        HEADER.replace("flag", "flag,unit")
        + "\n".join([*(f"{row},deg/s" for row in ROWS), "20.0,MUB2_matrix,4,1,3,ok,deg/s"])
    )
    for read in (read_published_table, Audit):
        with pytest.raises(InputError, match="column unit: deg/s: biases in deg/hr and MU in deg/hr/g are needed"):
            read(path)


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    """Bytes of a spreadsheet's own format."""
    path = tmp_path / "table.csv"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="UTF-8"):
        read_published_table(path)
