"""Parameters against temperature: Table 1's answer, known truths, hysteresis, refusals, and what is written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.published.table import read_published_table
from hil.analysis.thermal.document import thermal_document, verdict_in_words
from hil.analysis.thermal.fit import ParameterFit, ThermalFit, fit_thermal
from hil.bench import build_bench
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.cli.output import check_result_folder
from hil.errors import InputError
from hil.files.strict import find_config
from hil.model import load_model, save_model
from hil.model.curve import Constant, Polynomial, Table
from hil.solve import repeats, solve_campaign
from hil.solve.beside_terms import solve_beside
from tests.hil.analysis.thermal.nights import PUBLISHED_DEGC, rotor_night, scaled
from tests.hil.twin.quiet import changed_bench, collect

TABLE_1 = "rd-gc-86-1-table-1"


@pytest.fixture(scope="module")
def table_1() -> ThermalFit:
    """Table 1, as hil import rebuilds its collects, against temperature."""
    return fit_thermal(read_published_table(Path(TABLE_1)))


@pytest.fixture(scope="module")
def smooth() -> ThermalFit:
    """A night whose biases are linear and cubic, GSA and GSB linear, MU constant."""
    curves = {
        "BA": lambda t: 20.0 + 15.0 * scaled(t),
        "BB": lambda t: -5.0 + 40.0 * (4 * scaled(t) ** 3 - 3 * scaled(t)),
        "GSA": lambda t: 55.0 + 10.0 * scaled(t),
        "GSB": lambda t: -25.0 - 4.0 * scaled(t),
        "MUA": lambda t: 9.0 + 0.0 * t,
    }
    return fit_thermal(rotor_night(np.random.default_rng(7), curves))


def means_of_table_1(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return temperature °F, mean, sigma and n of one parameter."""
    header, *rows = [line.split(",") for line in find_config("tables", TABLE_1).read_text().splitlines()]
    chosen = [dict(zip(header, row, strict=True)) for row in rows if row[header.index("parameter")] == name]
    columns = ("temperature_F", "mean_printed", "sigma_printed", "n_inferred")
    return tuple(np.array([float(row[c]) for row in chosen]) for c in columns)  # type: ignore[return-value]


@pytest.mark.slow
def test_a_cubic_does_not_describe_mub_of_table_1(table_1: ThermalFit) -> None:
    """Left-out temperatures are predicted worse by a cubic than by a constant, and no form is taken."""
    mub = table_1.sensors[2].parameters["MUB"]
    assert mub.choice.errors["cubic"] > 1.5 * mub.choice.errors["constant"]
    assert mub.form == "constant"
    assert mub.finding == "undescribed"
    assert mub.chance_constant < 1e-6  # it does depend on temperature, far beyond its noise
    assert "no curve is shown to predict" in thermal_document(table_1)["sensors"][0]["parameters"]["MUB"]["verdict"]


@pytest.mark.parametrize(
    ("name", "cubic", "constant"),
    [("MUA2_matrix", 6.5, None), ("MUB2_matrix", 11.1, 10.4), ("BA2_matrix", 3.5, None), ("BB2_matrix", 8.0, None)],
)
def test_in_sample_misfits_of_table_1(name: str, cubic: float, constant: float | None) -> None:
    """The residual rms of a cubic on 4 degrees of freedom (and of MUB's constant on 7), from the printed means."""
    temperature, mean, _, _ = means_of_table_1(name)
    for order, expected in ((3, cubic), (0, constant)):
        fit = np.polynomial.Polynomial.fit(temperature, mean, order)
        rms = np.sqrt(np.sum((mean - fit(temperature)) ** 2) / (len(mean) - order - 1))
        assert expected is None or rms == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize(("name", "expected", "pooled_se"), [("MUA2_matrix", 250, 2.9), ("MUB2_matrix", 144, 2.4)])
def test_table_1_varies_with_temperature_far_beyond_repeatability(name: str, expected: int, pooled_se: float) -> None:
    """Chi-square of the means about their weighted mean, with the pooled sigma, on 7 degrees of freedom."""
    _, mean, sigma, runs = means_of_table_1(name)
    pooled = np.sqrt(np.sum((runs - 1) * sigma**2) / np.sum(runs - 1))
    chi_square = np.sum(runs * (mean - np.average(mean, weights=runs)) ** 2) / pooled**2
    assert pooled / np.sqrt(3) == pytest.approx(pooled_se, abs=0.06)
    assert chi_square == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_known_forms_are_found_with_their_coefficients(smooth: ThermalFit) -> None:
    """Linear, cubic, linear, linear, constant, constant; each coefficient within four standard errors."""
    found = smooth.sensors[2].parameters
    assert {name: each.form for name, each in found.items()} == {
        "BA": "linear",
        "BB": "cubic",
        "GSA": "linear",
        "GSB": "linear",
        "MUA": "constant",
        "MUB": "constant",
    }
    slope = found["BA"].coefficients
    assert abs(slope.values[1] - 15.0 / 44.85) < 4 * slope.se[1]
    at = np.array([-20.0, 10.0, 50.0])
    truth = -5.0 + 40.0 * (4 * scaled(at) ** 3 - 3 * scaled(at))
    np.testing.assert_allclose(found["BB"].curve.at(at), truth, atol=8.0)
    assert found["MUB"].repeatability == pytest.approx(np.hypot(3.95, 1.22 * 0.93), rel=0.35)


@pytest.mark.slow
def test_the_verdict_says_by_how_much_modelling_improves_the_unit(smooth: ThermalFit) -> None:
    """Held-out rates, a constant's beside the curves', with an interval, against the scatter of one collect."""
    document = thermal_document(smooth)["sensors"][0]
    assert document["verdict"]["improves"]
    assert document["rates"]["held_out_modelled"] < 0.5 * document["rates"]["held_out_constant"]
    assert 0.3 < document["rates"]["low"] < document["rates"]["share_removed"] < document["rates"]["high"] < 1.0
    assert "improves this unit" in document["verdict"]["words"]


@pytest.mark.slow
def test_without_temperature_dependence_it_says_so() -> None:
    """Every parameter constant, a bound for each, and modelling does not improve the unit."""
    flat = {name: (lambda t, v=value: v + 0.0 * t) for name, value in {"BA": 20.0, "GSA": 50.0, "MUA": -9.0}.items()}
    result = fit_thermal(rotor_night(np.random.default_rng(8), flat))
    assert all(each.finding == "constant" for each in result.sensors[2].parameters.values())
    document = thermal_document(result)["sensors"][0]
    assert not document["verdict"]["improves"]
    assert "no parameter is shown to depend on temperature" in document["verdict"]["words"]
    assert "not shown by its repeats to depend" in document["parameters"]["MUB"]["verdict"]
    once = thermal_document(fit_thermal(rotor_night(np.random.default_rng(8), flat, runs=1)))["sensors"][0]
    said = [once["verdict"]["words"], *(each["verdict"] for each in once["parameters"].values())]
    assert not [each for each in said if "its repeats" in each]  # of which there are none
    assert 0.5 < document["parameters"]["GSA"]["largest_linear_change"] < 5.0


@pytest.mark.slow
def test_what_is_not_shown_has_the_chance_of_all_that_was_asked() -> None:
    """MUB alone would be so uneven in 4 of 1000 campaigns; by one of three questions one of six in 77: no finding."""
    flat = {name: (lambda t, v=value: v + 0.0 * t) for name, value in {"BA": 20.0, "GSA": 50.0, "MUA": -9.0}.items()}
    for seed in (16, 29):
        fit = fit_thermal(rotor_night(np.random.default_rng(seed), flat))
        for name, each in thermal_document(fit)["sensors"][0]["parameters"].items():
            assert (each["finding"] == "constant") == (each["p_value"] >= 0.05), name
            if (seed, name) == (16, "MUB"):
                assert each["chance_constant"] < 0.005
                assert "(p = 0.077, 6 parameters asked together)" in each["words"]


def of_three_temperatures(seed: int, ends: tuple[float, float]) -> ParameterFit:
    """BA of a night of three temperatures, twice each, by a line between its ends, which scatters by 2 deg/hr."""
    line = {"BA": lambda t: ends[0] + (ends[1] - ends[0]) * (t + 15.0) / 70.0}
    rng, scatter = np.random.default_rng(seed), {"BA": 2.0, "BB": 4.0, "MUA": 3.0, "MUB": 2.0}
    night = rotor_night(rng, line, temperatures_degC=(-15.0, 25.0, 55.0), runs=2, run_to_run=scatter, white=1.0)
    return fit_thermal(night).sensors[2].parameters["BA"]


@pytest.mark.slow
def test_a_clear_line_at_three_temperatures_is_found() -> None:
    """32 and 33, 20 and 16, 9 and 8 deg/hr, each known to 2: six runs suffice where noise would hardly do so."""
    found = [of_three_temperatures(seed, (32.0, 8.0)) for seed in range(12)]
    assert sum(each.changes for each in found) >= 9
    assert all(each.form == "linear" for each in found if each.finding == "modelled")


@pytest.mark.slow
def test_few_repeats_beside_noise_make_no_dependence() -> None:
    """No parameter of a flat unit depends on temperature, in 95 of 100 nights of three temperatures, twice each."""
    found = [of_three_temperatures(seed, (20.0, 20.0)) for seed in range(60)]
    assert sum(each.p_value < 0.05 for each in found) <= 2  # of one of six: a half expected, more than two 1 %


@pytest.mark.parametrize(
    "curve",
    [
        Constant(unit="deg/hr", value=1.0, valid_degC=(-30.0, 60.0)),
        Polynomial(unit="deg/hr", polynomial=(1.0, 0.1), reference_degC=15.0, valid_degC=(-30.0, 60.0)),
        Table(unit="deg/hr", table={"temperature_degC": (-30.0, 60.0), "value": (1.0, 2.0)}, valid_degC=(-30.0, 60.0)),
    ],
)
def test_a_fitted_curve_refuses_to_be_extrapolated(curve: Constant | Polynomial | Table) -> None:
    """Inside, and a degree beyond, it answers; further out it says where it was measured."""
    assert np.all(np.isfinite(curve.at([-30.9, 0.0, 60.9])))
    for outside in (-35.0, 65.0):
        with pytest.raises(InputError, match="is outside -30 to 60 °C, where this curve"):
            curve.at([0.0, outside])


@pytest.mark.slow
def test_the_model_file_is_read_back_solves_and_drives_the_twin(smooth: ThermalFit, tmp_path: Path) -> None:
    """Written, read, evaluated at the campaign's rows, refused beyond its range, and used by solve and the bench."""
    save_model(smooth.model(), tmp_path / "thermal.yaml")
    model = load_model(tmp_path / "thermal.yaml")
    collects = smooth.campaign.sensors[2]
    residual = collects.rates_deg_per_hr - model.rates(collects.conditions)
    assert np.sqrt(np.mean(residual**2)) < 6.0
    assert len(solve_beside(smooth.campaign, model)) == 24
    hot = replace(collects.conditions, columns={"temperature_degC": np.full(len(collects), 75.0)})
    with pytest.raises(InputError, match="75 °C is outside"):
        model.rates(hot)
    both = model.model_copy(update={"sensors": {1: model.sensors[2], 2: model.sensors[2]}})
    save_model(both, tmp_path / "both.yaml")
    bench = changed_bench(tmp_path, model="both")
    with build_bench(bench) as live:
        measured = collect(live, "3")
    assert len(measured) > 0


def test_hysteresis_is_estimated_where_temperatures_were_reached_from_both_sides() -> None:
    """Up and down again: 8 deg/hr on BA is found and stays out of the curve, nothing is found on MUA."""
    there_and_back = (*PUBLISHED_DEGC, *PUBLISHED_DEGC[-2::-1])
    curves = {"BA": lambda t: 20.0 + 15.0 * scaled(t)}
    night = rotor_night(
        np.random.default_rng(9), curves, temperatures_degC=there_and_back, runs=2, hysteresis={"BA": 8.0}
    )
    fit = fit_thermal(night)
    sensor, (document,) = fit.sensors[2], thermal_document(fit)["sensors"]
    found, other = (document["parameters"][name]["hysteresis"] for name in ("BA", "MUA"))
    assert found["seen"]
    assert found["low"] < 8.0 < found["high"]
    assert found["se"] < 1.5
    assert not other["seen"]
    assert sensor.parameters["BA"].form == "linear"
    assert any("values are the middle between both directions" in note for note in sensor.notes)
    assert "improves this unit" in (said := verdict_in_words(sensor))
    assert "it may be time" not in said
    shown = repeats(night, solve_campaign(night))[2]
    layout = sensor.layout
    with_it = shown.of_a_collect(layout.collects.rates_se_deg_per_hr, layout.columns)
    assert sensor.rate_noise_deg_per_hr < 0.85 * with_it  # which hysteresis is no part of


@pytest.mark.parametrize("back", [True, False])
def test_where_nobody_knows_from_which_side_half_the_difference_is_uncertain(back: bool) -> None:
    """The first temperature was reached from below, and from above again or not at all: its value is the middle one."""
    visited, quiet = (-50.0, -30.0, 0.0, 30.0, 60.0, 30.0, 0.0, -30.0)[: 8 if back else 7], {"BA": 0.1}
    curves, wide = {"BA": lambda t: 20.0 + 0.0 * t}, {"BA": 10.0}
    night = rotor_night(
        np.random.default_rng(3), curves, temperatures_degC=visited, run_to_run=quiet, white=0.3, hysteresis=wide
    )
    rows = night.sensors[2]
    known = replace(night, sensors={2: rows.rows(rows.conditions.run > 3)})
    found = fit_thermal(known).sensors[2].parameters["BA"]
    first, *others = zip((found.values.values - 20.0).tolist(), found.values.se.tolist(), strict=True)
    assert abs(first[0]) < (0.5 if back else 5.5)
    assert first[1] == pytest.approx(0.15 if back else 5.0, rel=0.2)
    assert all(abs(off) < 3.0 * se < 0.7 for off, se in others)


def test_a_sweep_that_is_repeated_has_the_uncertainty_of_hil_solve() -> None:
    """Its first temperature is come back to from above: no other was reached from both sides, so nothing differs."""
    night = rotor_night(np.random.default_rng(4), {}, temperatures_degC=(0.0, 23.0, 50.0) * 3, runs=2)
    means, fit = repeats(night, solve_campaign(night))[2].means, fit_thermal(night).of(2)
    for name, each in fit.parameters.items():
        assert each.values.values == pytest.approx([mean.values[name].value for mean in means])
        assert each.values.se == pytest.approx([mean.values[name].sd for mean in means])


def test_a_curve_that_no_form_describes_is_no_hysteresis() -> None:
    """From below are the warm temperatures, from above the cold ones: beside a constant the curve would be in it."""
    curves = {"MUA": lambda t: np.interp(t, [-20.0, 5.0, 30.0, 55.0], [0.0, 24.0, 6.0, 40.0])}
    visited, quiet = (-20.0, 5.0, 30.0, 55.0, 30.0, 5.0), {"BA": 0.1}
    night = rotor_night(
        np.random.default_rng(4), curves, temperatures_degC=visited, runs=2, run_to_run=quiet, white=0.2
    )
    fit = fit_thermal(night).sensors[2].parameters["MUA"]
    assert (fit.finding, fit.hysteresis is None) == ("undescribed", False)
    assert fit.hysteresis is not None
    assert abs(fit.hysteresis.values[0]) < fit.hysteresis.half_width[0] < 1.0


@pytest.mark.slow
def test_one_direction_alone_gives_no_hysteresis_and_says_what_that_means(smooth: ThermalFit) -> None:
    """The curves then hold hysteresis and drift."""
    assert all(each.hysteresis is None for each in smooth.sensors[2].parameters.values())
    assert any("reached from both sides" in note for note in smooth.sensors[2].notes)


@pytest.mark.slow
def test_the_command_prints_one_document_and_writes_its_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Table 1 imported, fitted, exported; status 0, and 2 for what cannot be."""
    write_campaign(read_published_table(Path(TABLE_1)), tmp_path / "t1")
    assert run(["thermal", str(tmp_path / "t1"), "--out", str(tmp_path / "out"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "hil.thermal/1"
    mub = document["sensors"][0]["parameters"]["MUB"]
    assert mub["leave_one_out_errors"]["cubic"] > mub["leave_one_out_error_constant"]
    mua = document["sensors"][0]["parameters"]["MUA"]
    assert mua["order"] == 3
    assert mua["coefficients"][1]["unit"] == "deg/hr/g/degC"
    assert mua["reference_degC"] == 15.0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"model.yaml", "thermal.json", "sensor-2.svg"}
    check_result_folder(tmp_path / "out", "thermal.json", of=read_campaign(tmp_path / "t1"))  # its own: made anew
    assert load_model(tmp_path / "out" / "model.yaml").sensors[2]["MUA"].valid_degC == (-29.72, 60.0)
    assert run(["thermal", str(tmp_path / "t1")]) == 0
    assert "MUB: differs between temperatures beyond its noise" in capsys.readouterr().out
    assert run(["thermal", str(tmp_path / "nothing")]) == 2
    assert run(["thermal", str(tmp_path / "t1"), "--apart", "80 degC"]) == 2
    assert "at least three" in capsys.readouterr().err.replace("\n", " ")
