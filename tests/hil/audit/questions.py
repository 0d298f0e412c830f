"""The questions that several commands answer, and where each keeps its answer.

A command that answers one of the questions joins by one line in `ANSWERS`: what it prints, and where the answer stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hil.solve.runs import UNSTATED
from tests.hil.audit.folders import LOGS

VERDICTS = ("PASS", "MARGINAL", "INCONCLUSIVE", "FAIL")
SURE = ("sd", "low", "high", "runs")
Answer = Mapping[Any, Any]
Ask = Callable[[str], dict[str, Any] | None]

MODEL = dict.fromkeys(("poses", "poses, one wrong", "poses, dead channel", *LOGS), "triad-12")
COMMANDS: dict[str, Callable[[Path, str], list[str]]] = {
    "solve": lambda folder, _: ["solve", str(folder), "--json"],
    "thermal": lambda folder, _: ["thermal", str(folder), "--json"],
    "budget": lambda folder, _: ["budget", str(folder), "--draws", "100", "--json"],
    "visibility": lambda folder, _: ["visibility", str(folder), "--json"],
    "scatter": lambda folder, _: ["scatter", str(folder), "--json"],
    "reconcile": lambda folder, model: [
        "reconcile", str(folder), "--model", model, "--out", str(folder / "out"), "--json",
    ],
}  # fmt: skip
BESIDE: dict[str, Callable[[Path, str], list[str]]] = {
    "fleet": lambda folder, model: ["fleet", str(folder), "--model", model, "--json"],
    "history": lambda folder, _: ["history", "0042", "--archive", str(folder.parent / "archive"), "--json"],
    "report": lambda folder, _: ["report", str(folder)],
}
"""Commands that answer some of the questions, and have no rows."""
READ: dict[str, Callable[[str], dict[str, Any]]] = {
    "report": lambda said: {"verdict": next(word for word in said.split(": ") if word in VERDICTS)},
}
"""What the lines of those say that print no document."""
FIRST: dict[str, Callable[[Path], list[str]]] = {
    "history": lambda folder: [
        "archive", str(folder.parent / "archive"), str(folder), "--found", "--serial", "0042", "--date", "2026-03-01",
    ],
}  # fmt: skip


def rows(document: dict[str, Any]) -> Answer:
    """Which rows are left out or mended, and which channels of them; what is only doubted is not compared."""
    treated = [each for each in document["rows"] if each["done"] != "used"]
    return {(r["sensor"], r["run"], tuple(r["collects"]), tuple(r["channels"])): r["done"] for r in treated}


def _mended(of: Answer) -> Answer:
    return {row: done for row, done in of.items() if done == "mended"}


def _soaks(runs: list[dict[str, Any]]) -> Answer:
    return {(each["sensor"], run): each["why"] for each in runs for run in each["runs"]}


def _solved_means(document: dict[str, Any], key: str) -> Answer:
    return {
        (int(number), place, name): each[key]
        for number, of in document["repeats"].items()
        for place, mean in enumerate(mean for mean in of["means"] if _tells_all(mean, of["means"]))
        for name, each in mean["parameters"].items()
    }


def _tells_all(mean: dict[str, Any], means: list[dict[str, Any]]) -> bool:
    """Whether thermal has the temperature, too: it leaves those out at which something is not told."""
    return len(mean["parameters"]) == max(len(each["parameters"]) for each in means)


def _thermal_means(document: dict[str, Any], key: str) -> Answer:
    return {
        (each["sensor"], place, name): value[key]
        for each in document["sensors"]
        for name, of in each["parameters"].items()
        for place, value in enumerate(of["values"])
    }


def _archived(document: dict[str, Any], key: str) -> Answer:
    """Values by sensor, temperature and parameter: an archive keeps those of runs that may be relied upon."""
    return {
        (each["sensor"], at["temperature_degC"], each["parameter"]): value[key]
        for each in document["parameters"]
        for at in each["temperatures"]
        for value in at["values"]
    }


def _solved_at(document: dict[str, Any], key: str) -> Answer:
    return {
        (int(number), mean["temperature_degC"], name): each[key]
        for number, of in document["repeats"].items()
        for mean in of["means"]
        for name, each in mean["parameters"].items()
    }


def _in_means(document: dict[str, Any]) -> list[dict[str, Any]]:
    unused = document["runs_not_used"]
    return [each for each in document["solutions"] if each["run"] not in unused.get(str(each["sensor"]), ())]


def _no_pass(runs: Mapping[str, list[int]]) -> Answer:
    return {verdict: runs[verdict] for verdict in ("FAIL", "INCONCLUSIVE") if runs.get(verdict)}


def _run_to_run(of_sensor: Mapping[str, Any], where: str) -> Answer:
    return {
        (number, name, key): each[key]
        for number, of in of_sensor.items()
        for name, each in of[where].items()
        for key in ("sd", "degrees_of_freedom")
    }


def _noise_assumed(document: dict[str, Any]) -> Answer:
    shown = document["repeats"]
    return {n: of.get("noise_deg_per_hr") == {} for n, of in shown.items() if of["run_to_run"]}


def _unstated_noise(document: dict[str, Any]) -> Answer:
    return {
        (n, channel): noise
        for n, of in document["repeats"].items()
        for channel, noise in of.get("noise_deg_per_hr", {}).items()
    }


def _by_chance(document: dict[str, Any]) -> Answer:
    """What a collect scatters by beside its offset, where the search is not sure of more than that beside the form.

    Of rows that nothing is said against: the search mends what others leave out.
    """
    found = {}
    for of in document["noise"]:
        sure = of["explained_deg_per_hr"] is not None and of["collect_to_collect_se_deg_per_hr"]
        more = of["scatter"] or sure
        smooth = any(f"sensor {of['sensor']}: " in each and "smooth model" in each for each in document["sentences"])
        if not (document["rows"] or more or smooth or "+" in of["under"] or of["observed_deg_per_hr"] is None):
            collects = of["explained_deg_per_hr"] or 0.0, of["collect_to_collect_deg_per_hr"]
            found[str(of["sensor"]), of["channel"]] = math.hypot(*collects)
    return found


def _rms_of_bias(run_to_run: Mapping[str, Any]) -> float | None:
    beyond = [each["beyond_standard_errors"] for name, each in run_to_run.items() if name.startswith("B")]
    return math.sqrt(sum(one**2 for one in beyond) / len(beyond)) if beyond else None


def _shared(both: dict[str, Any] | None) -> Answer:
    return {(each["first"], each["second"]): each["correlation"] for each in (both or {"shared": []})["shared"]}


def _scattering(document: dict[str, Any], named: list[str]) -> Answer:
    told = {(of["sensor"], of["channel"], of["under"]): of["observed_deg_per_hr"] for of in document["noise"]}
    return {"named": named, **told}


ANSWERS: dict[str, dict[str, Callable[[dict[str, Any]], Answer]]] = {
    "which rows are wrong": dict.fromkeys(COMMANDS, rows),
    "which rows are mended": {
        "solve": lambda document: _mended(rows(document)),
        "fleet": lambda document: _mended(rows({"rows": [], **document["units"][0]})),
    },
    "which runs are in no mean": {
        **dict.fromkeys(COMMANDS, lambda document: document["runs_not_used"]),
        "fleet": lambda document: document["units"][0].get("runs_not_used", {}),
        "solve, by sensor": lambda document: {
            number: of["runs_not_used"] for number, of in document["repeats"].items() if of["runs_not_used"]
        },
    },
    "what is missing of what was asked for": {
        **dict.fromkeys(COMMANDS, lambda document: dict.fromkeys(document["missing"])),
        "fleet": lambda document: dict.fromkeys(document["units"][0].get("missing", ())),
    },
    "which runs had not settled": {
        **dict.fromkeys(COMMANDS, lambda document: _soaks(document["runs_not_settled"])),
        "fleet": lambda document: _soaks(document["units"][0].get("runs_not_settled", ())),
        "solve, by run": lambda document: {
            (s["sensor"], run): words[0]
            for s in document["solutions"]
            for run in s["runs"]
            if (words := [each for each in s["reason"].split("; ") if each.endswith("the soak had not ended")])
        },
    },
    "whether what repeats show rests on an assumed noise": {
        "solve": _noise_assumed,
        "visibility": lambda document: {
            n: "assumed noise" in of["noise"]["source"]
            for n, of in document["sensors"].items()
            if "its repeats" in of["noise"]["source"]
        },
    },
    "of which parameters anything is told": {
        "solve": lambda document: {
            int(n): {name for mean in of["means"] for name in mean["parameters"]}
            for n, of in document["repeats"].items()
        },
        "thermal": lambda document: {each["sensor"]: {*each["parameters"]} for each in document["sensors"]},
    },
    "the mean at a temperature": {
        "solve": lambda document: _solved_means(document, "value"),
        "thermal": lambda document: _thermal_means(document, "value"),
    },
    "how sure that mean is": {
        "solve": lambda document: _solved_means(document, "sd"),
        "thermal": lambda document: _thermal_means(document, "se"),
    },
    "how sure the mean of a run and its repeats is": {
        "budget": lambda document: {
            (int(n), tuple(of["mean_as_solved"]["runs"]), name): sd
            for n, of in document["sensors"].items()
            for name, sd in of["mean_as_solved"].items()
            if name != "runs"
        },
        "solve": lambda document: {
            (int(n), tuple(mean["runs"]), name): of["sd"]
            for n, shown in document["repeats"].items()
            for mean in shown["means"]
            for name, of in mean["parameters"].items()
        },
    },
    "of how many runs the mean of a run and its repeats is": {
        "budget": lambda document: {
            (int(n), tuple(of["mean_as_solved"]["runs"]), name): count
            for n, of in document["sensors"].items()
            for name, count in of["mean_as_solved_of"].items()
        },
        "solve": lambda document: {
            (int(n), tuple(mean["runs"]), name): of["runs"]
            for n, shown in document["repeats"].items()
            for mean in shown["means"]
            for name, of in mean["parameters"].items()
        },
    },
    "what changes from run to run": {
        "solve": lambda document: _run_to_run(document["repeats"], "run_to_run"),
        "budget": lambda document: _run_to_run(document["sensors"], "observed_run_to_run"),
    },
    "by how much the bias changes from run to run beyond its standard errors": {
        "solve": lambda document: {
            n: _rms_of_bias(of["run_to_run"])
            for n, of in document["repeats"].items()
            if not _noise_assumed(document).get(n) and not of["standard_errors"]
        },
        "visibility": lambda document: {
            n: of["noise"]["run_bias_deg_per_hr"]
            for n, of in document["sensors"].items()
            if of["noise"]["source"].startswith("its repeats")
            and not any(each in of["noise"]["source"] for each in ("standard errors", "assumed"))
        },
    },
    "what a collect scatters by": {
        "visibility": lambda document: {
            (n, channel): size
            for n, of in document["sensors"].items()
            for channel, size in of["noise"]["channels_deg_per_hr"].items()
        },
        "solve, where nobody stated it": _unstated_noise,
        "scatter": _by_chance,
    },
    "what is said of standard errors": {
        "solve": lambda document: {
            n: of["standard_errors"] for n, of in document["repeats"].items() if of["run_to_run"]
        },
        "visibility": lambda document: {
            n: [said for said in of["noise"]["source"].split("; ")[1:] if "standard errors" in said]
            for n, of in document["sensors"].items()
            if "its repeats" in of["noise"]["source"]
        },
    },
    "how sure one run is": {
        "budget": lambda document: {
            (int(n), of["run"], name): sd
            for n, of in document["sensors"].items()
            for name, sd in of["as_solved"].items()
        },
        "solve": lambda document: {
            (each["sensor"], each["run"], name): of["sd"]
            for each in document["solutions"]
            for name, of in each["parameters"].items()
        },
    },
    "whether somebody has to see to what scatters": {
        "solve": lambda document: {
            "runs": sorted(
                {
                    s["run"]
                    for s in document["solutions"]
                    if "times what the standard" in s["reason"] and s["verdict"] == "FAIL"
                }
            )
        },
        "reconcile": lambda document: {"runs": document["runs_beyond_errors"]},
    },
    "what a unit's history keeps": {
        "solve": lambda document: _solved_at(document, "value"),
        "history": lambda document: _archived(document, "value"),
    },
    "of how many repeats, and how sure, what a history keeps is": {
        "solve": lambda document: {(key, *at): v for key in SURE for at, v in _solved_at(document, key).items()},
        "history": lambda document: {(key, *at): v for key in SURE for at, v in _archived(document, key).items()},
    },
    "which runs do not pass, and how bad they are": {
        "solve": lambda document: _no_pass(
            {
                verdict: sorted({s["run"] for s in _in_means(document) if s["verdict"] == verdict})
                for verdict in ("FAIL", "INCONCLUSIVE")
            }
        ),
        "reconcile": lambda document: _no_pass(document["runs_not_solved"]),
        "thermal": lambda document: _no_pass(document["runs_not_solved"]),
        "budget": lambda document: _no_pass(document["runs_not_solved"]),
    },
    "which runs FAIL by what was recorded": {
        "reconcile": lambda document: {"runs": document["contradicted_runs"]},
        "fleet": lambda document: {"runs": document["units"][0]["runs_failed"]},
    },
    "how bad the worst is": {
        # A history says of what is not whole that it is INCONCLUSIVE at best, whatever is there.
        "solve": lambda document: {
            "verdict": max(
                (
                    s["verdict"]
                    for s in [{"verdict": "INCONCLUSIVE"}] * bool(document["missing"]) + document["solutions"]
                ),
                key=VERDICTS.index,
            )
        },
        "history": lambda document: {"verdict": document["campaigns"][0]["verdict"]},
        "report": lambda document: document,
    },
    "which sensors' standard errors are used": {
        "solve": lambda document: {s["sensor"]: UNSTATED not in s["assumed"] for s in document["solutions"]},
        **dict.fromkeys(
            ("scatter", "reconcile"),
            lambda document: {of["sensor"]: of["stated_deg_per_hr"] is not None for of in document["noise"]},
        ),
    },
    "what is suspicious": dict.fromkeys(
        [name for name in COMMANDS if name != "reconcile"], lambda document: dict.fromkeys(document["warnings"])
    ),
    "whose its temperatures are": {
        "solve": lambda document: {n: of["means"][0]["temperature_of"] for n, of in document["repeats"].items()},
        "budget": lambda document: {n: of["temperature_of"] for n, of in document["sensors"].items()},
    },
    "whose the temperatures of its curves are": {
        "thermal": lambda document: {str(of["sensor"]): of["temperature_of"] for of in document["sensors"]},
        "reconcile": lambda document: {str(of["sensor"]): of["temperature_of"] for of in document["values"]},
    },
    "what is named of the scatter, and by how much they scatter": {
        "scatter": lambda document: _scattering(document, document["named"]),
        "reconcile": lambda document: _scattering(
            document, [e["id"] for e in document["effects"] if (e["acts_on"], e["kind"]) == ("scatter", "named")]
        ),
    },
    "what two sensors do together": dict.fromkeys(
        ("solve", "scatter", "reconcile"), lambda document: _shared(document["both_sensors"])
    ),
    "is it simulated": dict.fromkeys(
        (*COMMANDS, "fleet", "history"), lambda document: {"simulated": document["simulated"]}
    ),
}


IN_COMMON = (
    "what a collect scatters by",
    "what a unit's history keeps",
    "of how many repeats, and how sure, what a history keeps is",
    "whose its temperatures are",
    "whose the temperatures of its curves are",
    "which sensors' standard errors are used",
    "of which parameters anything is told",
    "the mean at a temperature",
    "how sure that mean is",
    "how sure one run is",
    "how sure the mean of a run and its repeats is",
    "of how many runs the mean of a run and its repeats is",
)
