"""Configuration is found by name from anywhere, and what ships is right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.config import check_sweep_against_bench, load_bench, load_sweep
from hil.errors import InputError
from hil.files.strict import config_folders, find_config, near, parse_yaml
from procedures.plan import StepKind, make_plan


def _shipped(kind: str) -> list[str]:
    return sorted({file.stem for folder in config_folders(kind) for file in folder.glob("*.yaml")})


@pytest.mark.parametrize("name", ["simulated", "simulated.yaml"])
def test_a_name_finds_what_ships_from_any_folder(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With or without its suffix, whatever the working folder."""
    monkeypatch.chdir(tmp_path)
    assert find_config("benches", name).name == "simulated.yaml"


def test_an_existing_path_wins_over_what_ships(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of the same name in the working folder is a path given in full."""
    mine = tmp_path / "simulated.yaml"
    mine.write_text("name: mine\n")
    monkeypatch.chdir(tmp_path)
    assert find_config("benches", "simulated.yaml") == Path("simulated.yaml")
    assert find_config("benches", mine) == mine


def test_a_file_beside_the_one_that_names_it_is_found(tmp_path: Path) -> None:
    """A bench file may name an IMU description in its own folder."""
    (tmp_path / "mfs.yaml").write_text("")
    assert find_config("imus", "mfs", tmp_path) == tmp_path / "mfs.yaml"
    assert find_config("imus", "mfs").parent != tmp_path


def test_of_nothing_there_is_no_list() -> None:
    """Who asks an empty archive for a unit is told that it has none."""
    assert near("0042", []) == "; there is none at all"


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        (
            "benches",
            "simulatd",
            "simulatd: there is no bench of this name, nor such a file or folder; did you mean 'simulated'?",
        ),
        (
            "sweeps",
            "rd-gc-86",
            "rd-gc-86: there is no sweep of this name, nor such a file or folder; did you mean 'rd-gc-86-1'?",
        ),
        ("benches", "zzz", "zzz: there is no bench of this name, nor such a file or folder; allowed: "),
        ("sweeps", "./nothing.yaml", "./nothing.yaml: there is no such file or folder"),
        ("sweeps", "/nothing/here.yaml", "/nothing/here.yaml: there is no such file or folder"),
        ("sweeps", "", "'': the name of the sweep is empty"),
        ("imus", "/", "/: this is a folder, not the file of an IMU description"),
    ],
)
def test_a_missing_file_is_one_sentence(kind: str, name: str, message: str) -> None:
    """It names what was asked for and the nearest that exists."""
    with pytest.raises(InputError) as refusal:
        find_config(kind, name)
    assert str(refusal.value).startswith(message)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1, 2\nb: 3\n", "f.yaml, line 2, column 2: not valid YAML"),
        ("a: 1\nb: 2\na: 3\n", "f.yaml, line 3, column 1: not valid YAML: the key 'a' is given twice"),
        ("a:\n\t- b\n", "f.yaml, line 2, column 1: not valid YAML"),
        ("- a\n- b\n", "f.yaml: must be a mapping of keys to values, not a list"),
        ("", "f.yaml: must be a mapping of keys to values, not nothing"),
        ("a: !!python/object/apply:os.getcwd []\n", "f.yaml, line 1, column 4: not valid YAML"),
        ("a: \x00\n", "f.yaml: not valid YAML"),
        ("a: " + "[" * 5000, "f.yaml: not valid YAML: lists or mappings are nested too deeply"),
    ],
)
def test_yaml_that_is_none_is_refused_with_its_line(text: str, message: str) -> None:
    """Duplicate keys count: the second would silently win."""
    with pytest.raises(InputError) as refusal:
        parse_yaml(text, "f.yaml")
    assert str(refusal.value).startswith(message)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", None])
def test_a_file_that_cannot_be_read_is_named(content: bytes | None, tmp_path: Path) -> None:
    """Binary rubbish, or no permission."""
    path = tmp_path / "bench.yaml"
    path.write_bytes(content or b"")
    if content is None:
        path.unlink()
        path.symlink_to(path)
    with pytest.raises(InputError, match=str(path)):
        load_bench(path)


def test_the_published_sweep_is_the_reports() -> None:
    """Eight temperatures in °F, three self-calibrations at each, 45 minutes, collects 1-2-3."""
    procedure = load_sweep("rd-gc-86-1").procedure()
    degF = np.array(procedure.temperatures_degC) * 1.8 + 32.0
    np.testing.assert_allclose(degF, [-21.5, 6.1, 19.7, 43.3, 74.1, 100.1, 120.0, 140.0], atol=1e-9)
    assert (procedure.self_calibrations, procedure.positions) == (3, ("1", "2", "3"))
    assert procedure.restabilisation.at_least_s == 2700.0
    assert procedure.collect.duration_s == 60.0
    assert len(make_plan(procedure).of_kind(StepKind.COLLECT)) == 72


_BENCHES_OF = {"triad-six-positions": ["espec-stim300-example"]}
"""Sweeps of positions that the simulated unit has not, with the benches that they are for."""


@pytest.mark.parametrize("sweep", _shipped("sweeps"))
def test_every_shipped_sweep_goes_with_the_benches_it_is_for(sweep: str) -> None:
    """Nothing that ships refuses the rest: both simulated benches, or the examples with other positions."""
    for bench in _BENCHES_OF.get(sweep, ["simulated", "simulated-pty"]):
        check_sweep_against_bench(load_sweep(sweep), load_bench(bench))


def test_the_quick_sweep_is_over_in_seconds() -> None:
    """It is what live tests wait for."""
    assert make_plan(load_sweep("quick").procedure()).total_s < 60.0


@pytest.mark.parametrize("name", _shipped("benches"))
def test_every_shipped_bench_can_be_read(name: str) -> None:
    """And says by its name which file it is."""
    bench = load_bench(name)
    assert bench.name == name
    assert bench.simulated == name.startswith("simulated")


@pytest.mark.parametrize("name", ["simulated", "simulated-pty"])
def test_the_two_sensors_of_a_bench_turn_as_one_body(name: str) -> None:
    """Between any two positions both sensors turn by the same rotation, as parts of one unit do."""
    bench = load_bench(name)
    one, two = bench.sensors[1].built, bench.sensors[2].built
    for start in bench.positions:
        for stop in bench.positions:
            turn_1 = one[stop].axes.T @ one[start].axes
            turn_2 = two[stop].axes.T @ two[start].axes
            np.testing.assert_allclose(turn_1, turn_2, atol=1e-12)
    assert bench.sensors[1].assumed
    assert not bench.sensors[2].assumed


def test_the_shipped_orientations_of_sensor_2_are_the_reports_figure_1() -> None:
    """Signed axes of the report, written out once more."""
    table = load_bench("simulated").sensors[2].built
    np.testing.assert_array_equal(table["1"].axes, [[-1, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(table["2"].axes, [[1, 0, 0], [0, 1, 0], [0, 0, -1]])
    np.testing.assert_array_equal(table["3"].axes, [[0, 0, 1], [0, 1, 0], [1, 0, 0]])
