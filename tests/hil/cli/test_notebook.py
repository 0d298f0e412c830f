"""The face for notebooks: frozen names, the commands' own documents, and notebooks that do what they say."""

from __future__ import annotations

import ast
import inspect
import io
import json
import re
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest

import hil
from hil.campaign.reader import read_campaign
from hil.campaign.writer import columns_of
from hil.cli.app import run
from hil.cli.night import refuse_but_demo
from hil.config import load_sweep
from hil.errors import InputError
from tests.hil.audit.folders import written

ROOT = Path(__file__).resolve().parents[3]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))

FACE = {
    "read_campaign": "(folder: 'Path | str') -> 'Measured'",
    "read_night": "(folder: 'Path | str') -> 'Night'",
    "load_bench": "(name: 'str | Path') -> 'Bench'",
    "Measured.solve": "(self, model: 'str | None' = None) -> 'Answer'",
    "Measured.thermal": "(self, model: 'str | None' = None, *, highest_order: 'int' = 5, apart: 'str | None' = None) "
    "-> 'Answer'",
    "Measured.allan": "(self, sensor: 'int | None' = None, channel: 'str | None' = None, *, "
    "collect: 'int | None' = None, reach: 'str | None' = None) -> 'Answer'",
    "Measured.scatter": "(self) -> 'Answer'",
    "Measured.budget": "(self, bench: 'str | None' = None, model: 'str | None' = None, *, run: 'int | None' = None, "
    "draws: 'int' = 100000) -> 'Answer'",
    "Measured.visibility": "(self, model: 'str | None' = None) -> 'Answer'",
    "Measured.reconcile": "(self, model: 'str', out: 'Path | None' = None, *, alpha: 'float' = 0.05) -> 'Answer'",
    "Measured.plot_collect": "(self, collect: 'int') -> 'Picture'",
    "Measured.to_dataframe": "(self) -> 'pd.DataFrame'",
    "Measured.to_xarray": "(self) -> 'xr.Dataset'",
    "Night.status": "(self) -> 'Mapping[str, Any]'",
    "Night.verify": "(self) -> 'Answer'",
    "Night.plot_temperatures": "(self) -> 'Picture'",
    "Answer.to_dataframe": "(self) -> 'pd.DataFrame'",
    "Answer.to_xarray": "(self) -> 'xr.Dataset'",
    "Answer.plot": "(self, sensor: 'int | None' = None) -> 'Picture'",
}
"""What notebooks rely on. A name or an argument may be added; none is taken away or renamed."""

ASKED: dict[str, tuple[list[str], dict[str, Any]]] = {
    "solve": ([], {}),
    "thermal": ([], {}),
    "scatter": ([], {}),
    "visibility": ([], {}),
    "budget": (["--draws", "100"], {"draws": 100}),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a campaign folder with repeats at several temperatures."""
    return written("short soaks", tmp_path_factory.mktemp("given") / "campaign")


def test_names_and_signatures_are_those_that_notebooks_rely_on() -> None:
    """Every one in the table, and no public name beside them that is not in it."""
    for name, signature in FACE.items():
        found: Any = hil
        for part in name.split("."):
            found = getattr(found, part)
        assert str(inspect.signature(found)) == signature, name
    for kind in (hil.Measured, hil.Night, hil.Answer):
        public = {name for name, each in vars(kind).items() if inspect.isfunction(each) and not name.startswith("_")}
        assert public - {"show"} == {each.partition(".")[2] for each in FACE if each.startswith(f"{kind.__name__}.")}
    assert (ROOT / "hil" / "py.typed").is_file(), "a type checker is told that hil is typed"
    with pytest.raises(AttributeError, match="no attribute 'read_nigth'; it has Answer"):
        hil.read_nigth  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.slow
def test_importing_hil_loads_nothing_else() -> None:
    """A driver's test that says `import hil` does not wait for arithmetic, nor `hil status` for benches; names stay."""
    code = "import sys, hil; print(sorted({'numpy', 'typer', 'hil.cli.notebook'} & set(sys.modules)))"
    code += "; import hil.cli.watch; print(sorted({'pint', 'scipy', 'hil.config.bench'} & set(sys.modules)))"
    code += "; import hil.solve; hil.read_campaign; print(hil.solve.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout == "[]\n[]\nhil.solve\n"


@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize(
    "question",
    [pytest.param(each, marks=[pytest.mark.slow] * (each not in ("solve", "budget"))) for each in ASKED],
)
def test_an_answer_is_the_commands_own(question: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The document to the last digit, and what a terminal shows."""
    options, given = ASKED[question]
    answer = getattr(hil.read_campaign(folder), question)(**given)
    assert run([question, str(folder), *options, "--json"]) == 0
    assert json.loads(json.dumps(answer.document)) == json.loads(capsys.readouterr().out)
    assert run([question, str(folder), *options]) == 0
    shown = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert set(shown) <= {line.rstrip() for line in repr(answer).splitlines()}
    html = answer._repr_html_()
    assert answer.document["simulated"] is ("SIMULATED" in html)
    assert html.count("<") == html.count(">") > 0


@pytest.mark.slow
def test_rows_are_those_of_the_document(folder: Path) -> None:
    """One for each parameter of each run, by name, and the same over axes."""
    pytest.importorskip("pandas", reason="the extra `notebook` is not installed")
    answer = hil.read_campaign(folder).solve()
    frame = answer.to_dataframe()
    assert len(frame) == sum(len(each["parameters"]) for each in answer.document["solutions"])
    last = answer.document["solutions"][-1]
    row = frame[(frame.run == last["run"]) & (frame.sensor == last["sensor"]) & (frame.parameter == "MUB")].iloc[0]
    assert (row.value, row.se) == tuple(last["parameters"]["MUB"][of] for of in ("value", "se"))
    assert row.verdict == last["verdict"]
    assert set(frame.simulated) == {answer.document["simulated"]}
    pytest.importorskip("xarray", reason="the extra `notebook` is not installed")
    over = answer.to_xarray()
    assert float(over["value"].sel(run=last["run"], sensor=last["sensor"], parameter="MUB")) == row.value


def test_the_collects_are_the_files(folder: Path) -> None:
    """Column by column, as in collects.csv."""
    pytest.importorskip("pandas", reason="the extra `notebook` is not installed")
    frame = hil.read_campaign(folder).to_dataframe()
    known = columns_of(read_campaign(folder))
    assert list(frame) == [*known, "simulated"]
    assert frame["RA_deg_per_hr"].tolist() == known["RA_deg_per_hr"].tolist()


@pytest.mark.slow
@pytest.mark.parametrize("simulated", [True, False])
def test_what_is_simulated_says_so_in_every_row(simulated: bool, tmp_path: Path) -> None:
    """In the table of the collects, of an answer, in its text and its picture."""
    folder = written("short soaks", tmp_path / "campaign")
    header = folder / "campaign.yaml"
    header.write_text(header.read_text() + "simulated: true\n" * simulated)
    campaign = hil.read_campaign(folder)
    answer = campaign.solve()
    assert ("SIMULATED" in repr(campaign)) is ("SIMULATED" in answer._repr_html_()) is simulated
    assert ("SIMULATED" in answer.plot(2)._repr_svg_()) is simulated
    pytest.importorskip("pandas", reason="the extra `notebook` is not installed")
    assert set(campaign.to_dataframe()["simulated"]) == set(answer.to_dataframe()["simulated"]) == {simulated}


@pytest.mark.slow
def test_what_cannot_be_answered_is_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No such folder, no night, no picture, no table, no library."""
    with pytest.raises(InputError, match="there is no such folder"):
        hil.read_campaign(folder / "nowhere")
    with pytest.raises(InputError, match=r"no night .* hil\.read_campaign"):
        hil.read_night(folder)
    with pytest.raises(InputError, match="has no picture"):
        hil.read_campaign(folder).scatter().plot()
    with pytest.raises(InputError, match="no list of rows"):
        hil.Answer({"schema": "hil.verify/1"}, lambda: ()).to_dataframe()
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"needs pandas, which is not installed: pip install 'hil\[notebook\]'"):
        hil.read_campaign(folder).solve().to_dataframe()


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_do_what_they_say(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """Every code cell runs, in order, again too where it writes, and its last line can be shown. No output is kept.

    Commands are carried out in this process. A night takes long: what `hil demo` left is there, and may be replaced.
    """
    for library in ("pandas", "xarray"):
        pytest.importorskip(library, reason="the extra `notebook` is not installed")

    def carried_out(command: list[str], *, check: bool, **_: object) -> subprocess.CompletedProcess[str]:
        assert (command[:3], check) == ([sys.executable, "-m", "hil"], True)
        with redirect_stdout(io.StringIO()) as said:
            if command[3] == "demo":
                assert command[4:] == ["--quiet", "--out", "demo"]
                refuse_but_demo(tmp_path / "demo", load_sweep("rd-gc-86-1"))
            else:
                assert run(command[3:]) == 0
        return subprocess.CompletedProcess(command, 0, said.getvalue())

    monkeypatch.setattr(subprocess, "run", carried_out)
    monkeypatch.chdir(tmp_path)
    known: dict[str, Any] = {}
    code = [cell for cell in json.loads(path.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]
    if path.stem == "a-night":
        shutil.copytree(request.getfixturevalue("demo"), tmp_path / "demo")
    for cell in [*code, *(each for each in code if re.search("subprocess|told|write_", "".join(each["source"])))]:
        assert cell["outputs"] == []
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop()
        assert isinstance(last, ast.Expr), "a cell ends with what it shows"
        exec(compile(tree, path.name, "exec"), known)  # noqa: S102 - our own notebook
        shown = eval(compile(ast.Expression(last.value), path.name, "eval"), known)  # noqa: S307
        ways = [getattr(shown, way) for way in ("_repr_html_", "_repr_svg_", "__repr__") if hasattr(shown, way)]
        assert ways[0]()


def test_there_are_notebooks() -> None:
    """A night, what is missing, a unit of one's own; small ones."""
    assert len(NOTEBOOKS) >= 3
    assert all(path.stat().st_size < 8000 for path in NOTEBOOKS)
