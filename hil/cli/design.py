"""Commands that weigh a night before or after it: budget, design, scatter."""

import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hil.cli.answer import Answer, Aside
from hil.cli.data import Source, read_source
from hil.cli.output import listing
from hil.errors import InputError

_WHOSE = {"setpoint_degC": "as set", "temperature_degC": "the unit's own", "chamber_degC": "the chamber's"}
_MANY = 12  # positions that are still written out
_MOST_TWICE = 8  # parameters for which both columns fit beside each other; of more, --json has the second


def budget(
    source: Annotated[str, typer.Argument(help="A sweep file (or its name), a campaign folder, or a night.")],
    bench: Annotated[str | None, typer.Option(help="The bench; default: the night's own, else simulated.")] = None,
    model: Annotated[
        str | None, typer.Option(help="Take GS and MU, on which errors of attitude act, from this model file.")
    ] = None,
    run: Annotated[int | None, typer.Option(help="Which self-calibration; default: the worst.")] = None,
    repeats: Annotated[int | None, typer.Option(min=1, help="Repeats averaged; default: as many as were made.")] = None,
    draws: Annotated[int, typer.Option(min=100, max=10_000_000, help="Monte Carlo draws per source.")] = 100_000,
    seed: Annotated[int, typer.Option(min=0, help="Of the draws.")] = 0,
) -> Answer:
    """Say what each source of error contributes to each parameter, calculated and by Monte Carlo."""
    from hil.config import load_bench, load_sweep
    from hil.design.budget.document import Asked, budget_document
    from hil.design.budget.scenes import measured_scenes, planned_scenes
    from hil.model import load_model
    from hil.solve import repeats as what_repeats_show
    from hil.solve import solve_campaign
    from hil.solve.wrong_rows import what_is_wrong

    chosen = None if model is None else load_model(model)
    if Path(source).is_dir():
        campaign = read_source(Path(source))
        its_bench = load_bench(bench) if bench is not None else _bench_of(Path(source))
        shown = what_repeats_show(campaign, solve_campaign(campaign))
        times = max((len(each.runs) for of in shown.values() for each in of.means), default=1)
        document = budget_document(
            measured_scenes(campaign, its_bench, chosen),
            campaign.title,
            Asked(run, repeats or times, draws, seed),
            simulated=campaign.simulated,
            observed=shown,
        )
        document |= {"warnings": list(campaign.warnings), **what_is_wrong(campaign)}
    else:
        sweep, its_bench = load_sweep(source), load_bench(bench or "simulated")
        document = budget_document(
            planned_scenes(sweep, its_bench, chosen),
            sweep.title,
            Asked(run, repeats or sweep.self_calibrations_per_temperature, draws, seed),
        )
    return Answer(document, lambda: _budget(document))


def _bench_of(folder: Path) -> Any:
    """Return the bench that a night was recorded on, else the simulated one."""
    from hil.config import load_bench
    from hil.config.recorded import bench_of_record
    from hil.records import reading
    from hil.records.reader import is_night

    if not is_night(folder):
        return load_bench("simulated")
    with reading(folder) as journal:
        return bench_of_record(journal.night.configuration)


def _budget(document: Mapping[str, Any]) -> Iterator[str | Table]:
    from hil.solve.wrong_rows import in_words

    yield from (Aside(f"warning: {line}") for line in document.get("warnings", ()))
    yield f"{document['title']}{'  SIMULATED' * document['simulated']}"
    yield from (*in_words(document), *document["without"])
    for number, sensor in document["sensors"].items():
        degC, whose = sensor["temperature_degC"], _WHOSE.get(sensor["temperature_of"] or "", "planned")
        at = "" if degC is None else f" at {degC:.4g} °C ({whose})"
        yield (
            f"\nsensor {number}, run {sensor['run']}{at}, collects {_sequence(sensor)}; sensitivities "
            f"{sensor['acting_on']}\none standard deviation, calculated (Monte Carlo, {document['draws']} draws)"
        )
        yield _budget_table(document, sensor)
        yield _origins(sensor)
        if sensor["left_out"]:
            left_out = ", ".join(sensor["left_out"])
            yield f"left out, for how the sensor lay is not known (name its bench with --bench): {left_out}"
        if not sensor["agrees"]:
            yield _too_large(sensor)


def _too_large(sensor: Mapping[str, Any]) -> str:
    """Name what the linear calculation does not hold for."""
    titles = {each["id"]: each["title"] for each in sensor["sources"]}
    where = "; ".join(f"{titles[source]} in {', '.join(names)}" for source, names in sensor["too_large"].items())
    return (
        "calculation and Monte Carlo do NOT agree: too large for a linear calculation "
        f"({where or 'all together'}); there the numbers in brackets hold"
    )


def _sequence(sensor: Mapping[str, Any]) -> str:
    positions = sensor["positions"]
    return "-".join(positions) if len(positions) <= _MANY else f"at {len(positions)} positions"


def _origins(sensor: Mapping[str, Any]) -> str:
    """Say where the sizes come from: one line, so that a default is not taken for knowledge."""
    default = [each["id"] for each in sensor["sources"] if each["origin"].startswith("default of")]
    others = [f"{each['id']}: {each['origin']}" for each in sensor["sources"] if each["id"] not in default]
    return f"sizes: {'; '.join(others)}" + (f"; defaults, not this bench's: {', '.join(default)}" if default else "")


def _budget_table(document: Mapping[str, Any], sensor: Mapping[str, Any]) -> Table:
    units = (f"{name}\n{unit}" for name, unit in sensor["parameters"].items())
    table = listing("source", "size", *units, left={"source"})
    names = list(sensor["parameters"])
    told = _two if len(names) <= _MOST_TWICE else lambda cell: _one(cell["analytic"])
    for source in sensor["sources"]:
        cells = [told(source["parameters"][name]) for name in names]
        size = f"{source['size']:.3g} {source['unit']}"
        if source["id"] == "noise":
            size = f"{sensor['noise_deg_per_hr']:.3g} deg/hr"
        table.add_row(source["title"], size, *cells)
    table.add_row("all together, one run", "", *(told(sensor["total"][name]) for name in names), style="bold")
    seen = {name: of["sd"] for name, of in sensor["observed_run_to_run"].items()}
    solved = sensor["mean_as_solved"]
    runs = len(solved.get("runs", ()))
    rows = {
        "the part that is new in each run": sensor["run_to_run"],
        "repeats scatter by": seen,
        "one run, as hil solve states it": sensor["as_solved"],
        f"mean of {runs} runs, as hil solve states it": solved if runs > 1 else {},
        f"mean of {document['repeats']} runs, all together": sensor["mean_of_repeats"]
        if document["repeats"] > 1
        else {},
    }
    for title, values in rows.items():
        if values:
            table.add_row(title, "", *(_one(values.get(name)) for name in names))
    return table


def _two(cell: Mapping[str, float | None]) -> str:
    return "–" if cell["analytic"] is None else f"{_one(cell['analytic'])} ({_one(cell['monte_carlo'])})"


def _one(value: float | None) -> str:
    if value is None:
        return "–"
    return "0" if value < 5e-4 else f"{value:.3f}"


def design(
    sweep: Annotated[str, typer.Argument(help="The sweep whose temperatures and soaks to keep.")] = "rd-gc-86-1",
    bench: Annotated[str, typer.Option(help="The bench that would run it.")] = "simulated",
    goal: Annotated[
        list[str] | None,
        typer.Option(help="Uncertainty of the mean at a temperature: 'MU 0.5 deg/hr', 'BA 0.3 deg/hr'; repeatable."),
    ] = None,
    drift_immune: Annotated[bool, typer.Option("--drift-immune", help="Keep a steady drift out.")] = False,
    residuals: Annotated[int, typer.Option(min=0, help="Residuals left in each self-calibration.")] = 0,
    even_terms: Annotated[bool, typer.Option("--even-terms", help="Tell MU from terms in g squared.")] = False,
    within: Annotated[str | None, typer.Option(help="The whole night's time: '24 h'.")] = None,
    repeats: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Repeats at least; default: the sweep's.")
    ] = None,
    scatter_of_unit: Annotated[
        list[str] | None,
        typer.Option(
            "--scatter",
            help="How the unit scatters from run to run: 'MU 4 deg/hr', or a night that tells it; repeatable.",
        ),
    ] = None,
    sensor: Annotated[list[int] | None, typer.Option(help="Only these sensors; repeatable. Default: all.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write the proposal as this sweep file.")] = None,
) -> Answer:
    """Propose the sequence of collects for a goal and a time, beside the usual ones; --out writes it as a sweep."""
    from hil.config import load_bench, load_sweep
    from hil.design.sequence.proposal import check_new, design_document, write_sweep
    from hil.design.sequence.search import Goal, parse_target, propose
    from hil.files.units import TIME, to_number

    base, its_bench = load_sweep(sweep), load_bench(bench)
    if out is not None:
        check_new(out)
    try:
        time_s = None if within is None else to_number(within, TIME)
    except ValueError as error:
        raise InputError(f"--within: {error}") from error
    told = scatter_of_unit or ()
    asked = Goal(
        dict(parse_target(text) for text in goal or ()),
        drift_immune,
        residuals,
        even_terms,
        time_s,
        tuple(sensor or ()),
        repeats,
        dict(parse_target(text) for text in told if not Path(text).is_dir()),
        {n: sizes for text in told if Path(text).is_dir() for n, sizes in _scatter_of(text).items()},
    )
    proposal = propose(base, its_bench, asked)
    document = design_document(proposal, asked, base, its_bench)
    if out is not None:
        write_sweep(proposal, base, its_bench, out, "hil " + shlex.join(sys.argv[1:]))
    return Answer(document, lambda: _proposed(document, out))


def _scatter_of(folder: str) -> dict[int, dict[str, float]]:
    """Return what each sensor's repeats in a night or campaign show beyond standard errors, by parameter."""
    from hil.solve import repeats, solve_campaign

    campaign = read_source(Path(folder))
    shown = repeats(campaign, solve_campaign(campaign))
    told = {n: of for n, of in shown.items() if of.spread.degrees.any()}
    if not told:
        raise InputError(f"--scatter {folder}: nothing was repeated there, so it does not tell what runs differ by")
    return {n: dict(zip(of.names, of.spread.beyond.tolist(), strict=True)) for n, of in told.items()}


def _proposed(document: Mapping[str, Any], out: Path | None) -> Iterator[str | Table]:
    best, longer = document["proposed"], document["with_more_time"]
    yield f"{document['sweep']}, on bench {document['bench']}\n\nproposed: {_in_words(best)}"
    yield from (f"  the goal is not met: {text}" for text in document["missing"])
    if longer is not None:
        yield f"  with more time it is: {_in_words(longer)}"
    for number in best["sensors"]:
        unknown = bool(document["goal"]["scatter_of"]) and number not in document["goal"]["scatter_of"]
        without = "; how it scatters from run to run is not known, and not in it" * unknown
        yield f"\nsensor {number}: one standard deviation of the mean at a temperature, whole budget{without}"
        yield _design_table(document, number)
    yield "\ndrift out of: what a steady drift does not enter; g²: MU is told from terms in g squared"
    if out is not None:
        yield f"sweep: {out}"


def _in_words(each: Mapping[str, Any]) -> str:
    return (
        f"{each['sequence']}, {each['collect_duration_s']:g} s each, {each['self_calibrations_per_temperature']} per "
        f"temperature, {each['total_s'] / 3600.0:.1f} h"
    )


def _design_table(document: Mapping[str, Any], number: str) -> Table:
    names = list(document["proposed"]["sensors"][number]["uncertainty"])
    headings = ("", "sequence", "s", "times", "hours", *names, "residuals", "drift out of", "g²")
    table = listing(*headings, left={"", "sequence", "drift out of"})
    for mark, each in [("→", document["proposed"]), *(("", one) for one in document["compared"])]:
        of = each["sensors"][number]
        kept_out = of["immune_to_drift"]
        table.add_row(
            mark,
            each["sequence"],
            f"{each['collect_duration_s']:g}",
            str(each["self_calibrations_per_temperature"]),
            f"{each['total_s'] / 3600.0:.1f}",
            *(f"{of['uncertainty'][name]:.2f}" for name in names),
            str(of["residuals"]),
            "all" if len(kept_out) == len(names) else ", ".join(kept_out) or "–",
            "yes" if of["tells_even_terms"] else "no",
        )
    return table


def scatter(source: Source) -> Answer:
    """Tell what makes repeats scatter: noise, the bias, MU, base, cold; or say that they cannot tell."""
    from hil.reconcile.scattering import what_scatters

    found = what_scatters(read_source(source))
    document = found.document()
    return Answer(document, lambda: _scattered(document, found.campaign.warnings))


def _scattered(document: Mapping[str, Any], warnings: Sequence[str]) -> Iterator[str | Table]:
    yield from (Aside(f"warning: {line}") for line in warnings)
    yield f"{document['title']}{'  SIMULATED' * document['simulated']}"
    table = listing("sensor", "stated\ndeg/hr", "observed\ndeg/hr", "of that, offset\nof the whole run")
    for each in document["noise"]:
        stated = "–" if each["stated_deg_per_hr"] is None else f"{each['stated_deg_per_hr']:.2f}"
        numbers = (f"{each[of]:.2f}" for of in ("observed_deg_per_hr", "run_offset_deg_per_hr"))
        table.add_row(f"{each['sensor']} {each['channel']}", stated, *numbers)
    yield table
    yield from document["sentences"]


COMMANDS = (budget, design, scatter)
