"""Commands about coefficients and their errors: allan, audit, budget, design, reproduce, scatter, thermal."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hil.cli.answer import Answer
from hil.cli.data import read_source
from hil.cli.exit_status import Exit
from hil.cli.output import check_result_folder, warn
from hil.errors import InputError, worded
from hil.files.durable import check_file, check_new
from hil.files.figure import PLOT, save_figure
from hil.files.units import DIFFERENCE, FREQUENCY, RATE, TIME, Kind, to_number

if TYPE_CHECKING:
    from hil.config import Bench
    from hil.design.sequence.unit_scatter import UnitScatter


def quantity(option: str, text: str, kind: Kind, usual: str = "") -> float:
    """Return what an option says, in the unit of its kind, a bare number in the `usual` one; else `InputError`."""
    from hil.files.columns import is_number

    with worded(InputError, f"{option}: "):
        return to_number(f"{text} {usual}" if usual and is_number(text) else text, kind)


def sample_rate_hz(text: str | None) -> float | None:
    """Return what --rate says, where it is given; raise `InputError` where it is no rate."""
    if text is None:
        return None
    rate_hz = quantity("--rate", text, FREQUENCY, "Hz")
    if rate_hz == 0.0:
        raise InputError("--rate: the sample rate must be more than 0 Hz")
    return rate_hz


def allan(
    source: Path,
    channel: str | None = None,
    sensor: int | None = None,
    collect: int | None = None,
    rate: str | None = None,
    unit: str | None = None,
    reach: str | None = None,
    collect_time: str | None = None,
    out: Path | None = None,
) -> Answer:
    """Say what a recording's noise is made of (N, B, K), how long to average, and when longer stops helping."""
    import numpy as np

    from hil.analysis.allan.document import AllanResult, draw
    from hil.analysis.allan.sources import read_recording

    if out is not None:
        check_file(out, *PLOT)
    wanted = None if reach is None else quantity("--reach", reach, RATE)
    collect_s = 60.0
    if collect_time is not None:
        collect_s = quantity("--collect-time", collect_time, TIME)
    elif source.is_dir():
        rows = read_source(source).sensors.values()
        collect_s = float(np.median(np.concatenate([each.conditions.duration_s for each in rows])))
    result = AllanResult(
        read_recording(source, channel=channel, sensor=sensor, collect=collect, rate_hz=sample_rate_hz(rate), unit=unit)
    )
    if out is not None:
        save_figure(draw(result), out)
    return Answer(result.document(collect_s, wanted), {"out": out}, lambda _: draw(result))


def audit(name: Path) -> Answer:
    """Check every identity in a published table: what does not close, by how much, which reading would mend it."""
    from hil.analysis.published.audit import Audit

    return Answer(Audit(name).document())


def thermal(
    source: Path, model: str | None = None, highest_order: int = 5, apart: str | None = None, out: Path | None = None
) -> Answer:
    """Fit every parameter against temperature, and say whether modelling it improves the unit."""
    from hil.analysis.thermal.document import thermal_document
    from hil.analysis.thermal.files import draw_fit, write_thermal
    from hil.analysis.thermal.fit import fit_thermal
    from hil.report.plots import which_sensor

    apart_degC = None if apart is None else quantity("--apart", apart, DIFFERENCE)
    if apart_degC == 0.0:
        raise InputError("--apart: two temperatures must be more than 0 °C apart")
    campaign = read_source(source)
    if out is not None:
        check_result_folder(out, "thermal.json", of=campaign)
    result = fit_thermal(campaign, model, highest_order=highest_order, apart_degC=apart_degC)
    written = [] if out is None else write_thermal(result, out)
    status = Exit.INCOMPLETE if result.not_fitted else Exit.DONE
    beside = {"out": out, "written_to": written}
    return Answer(
        thermal_document(result),
        beside,
        lambda sensor: draw_fit(result.of(which_sensor(source, campaign, sensor)), campaign),
        status,
    )


def reproduce(source: Path, sensor: int = 2) -> Answer:
    """Give RD-GC-86-1's Table 1, Figures 2-5 and Table A-1 again from a night, beside the printed values."""
    from hil.analysis.published.reproduction import reproduce as give_again

    campaign = read_source(source)
    return Answer(give_again(campaign, sensor), {"campaign": campaign})


def budget(
    source: str,
    bench: str | None = None,
    model: str | None = None,
    run: int | None = None,
    repeats: int | None = None,
    draws: int = 100_000,
    seed: int = 0,
) -> Answer:
    """Say what each source of error contributes to each parameter, calculated and by Monte Carlo."""
    from hil.config import load_bench, load_sweep
    from hil.config.recorded import bench_of_record
    from hil.design.budget.document import Asked, budget_document
    from hil.design.budget.scenes import measured_scenes, planned_scenes
    from hil.model import fitting_campaign, load_model
    from hil.records import reading
    from hil.records.reader import is_night
    from hil.solve import repeats as what_repeats_show
    from hil.solve import solve_campaign
    from hil.solve.beside_terms import beside
    from hil.solve.document import not_solved
    from hil.solve.omissions import what_is_wrong

    chosen = None if model is None else load_model(model)
    if Path(source).is_dir():
        campaign = read_source(Path(source))
        if chosen is not None:  # as hil solve takes it
            campaign = beside(campaign, fitting_campaign(chosen, campaign))
        its_bench = load_bench(bench or "simulated")
        if bench is None and is_night(Path(source)):
            with reading(Path(source)) as journal:
                its_bench = bench_of_record(journal.night.configuration)
        shown = what_repeats_show(campaign, solve_campaign(campaign))
        scenes, asked = measured_scenes(campaign, its_bench, shown, chosen), Asked(run, repeats, draws, seed)
        document = budget_document(scenes, campaign.title, asked, simulated=campaign.simulated, observed=shown)
        document |= {"warnings": list(campaign.warnings), **what_is_wrong(campaign), **not_solved(campaign)}
    else:
        sweep, its_bench = load_sweep(source), load_bench(bench or "simulated")
        asked = Asked(run, repeats or sweep.self_calibrations_per_temperature, draws, seed)
        document = budget_document(
            planned_scenes(sweep, its_bench, chosen), sweep.title, asked, simulated=its_bench.simulated
        )
    return Answer(document)


def design(
    sweep: str = "rd-gc-86-1",
    bench: str = "simulated",
    goal: list[str] | None = None,
    drift_immune: bool = False,
    residuals: int = 0,
    even_terms: bool = False,
    within: str | None = None,
    repeats: int | None = None,
    scatter_of_unit: list[str] | None = None,
    sensor: list[int] | None = None,
    out: Path | None = None,
) -> Answer:
    """Propose the sequence of collects for a goal and a time, beside the usual ones; --out writes it as a sweep."""
    from hil.config import load_bench, load_sweep
    from hil.design.sequence.proposal import design_document, write_sweep
    from hil.design.sequence.search import Goal, parse_target, propose

    if Path(sweep).is_dir():
        told = "if it is a night or a campaign, what its unit scatters by is"
        raise InputError(f"{sweep}: a folder is no sweep; {told} --scatter {sweep}")
    base, its_bench = load_sweep(sweep), load_bench(bench)
    if out is not None:
        check_new(out)
    time_s = None if within is None else quantity("--within", within, TIME)
    showing = scatter_of_unit or ()
    asked = Goal(
        dict(parse_target(text) for text in goal or ()),
        drift_immune,
        residuals,
        even_terms,
        time_s,
        tuple(sensor or ()),
        repeats,
        dict(parse_target(text) for text in showing if not Path(text).is_dir()),
        {n: of for text in showing if Path(text).is_dir() for n, of in _scatter_of(text, its_bench).items()},
    )
    proposal = propose(base, its_bench, asked)
    document = design_document(proposal, asked, base, its_bench)
    if out is not None:
        write_sweep(proposal, base, its_bench, out, "hil " + shlex.join(sys.argv[1:]))
    return Answer(document, {"out": out})


def _scatter_of(folder: str, bench: Bench) -> dict[int, UnitScatter]:
    """Return how each sensor of a night or campaign scatters, by its repeats; raise `InputError` where it has none."""
    from hil.design.sequence.unit_scatter import scatter_of_unit

    told = scatter_of_unit(read_source(Path(folder)))
    if not told:
        raise InputError(f"--scatter {folder}: nothing was repeated there, so it does not tell what runs differ by")
    absent = f"is not on bench {bench.name}: how it scatters is not used"
    every = [(n, said) for n, of in told.items() for said in ([absent] * (n not in bench.sensors) or of.said)]
    warn([f"--scatter {folder}: sensor {n}: {said}" for n, said in every])
    return told


def scatter(source: Path) -> Answer:
    """Tell what makes repeats scatter: noise, the bias, MU, base, cold; or say that they cannot tell."""
    from hil.reconcile.scattering import what_scatters

    return Answer(what_scatters(read_source(source)).document())
