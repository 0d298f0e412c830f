"""What other methods make of the same sealed cases, in the same run.

    pip install .[rivals]
    python -m benchmarks.blind.rivals --cases 20

Every rival gets the search's own first tier as its library (each effect at each shape), with the base projected out and
the columns scaled to one, and is used as its makers do: rows count as independent. A rival's name counts as right where
its columns reproduce the hidden term (90 % of its square), whatever the name is.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.blind.cases import Case, Noise, base_columns, make_case, write_case
from benchmarks.blind.jobs import FOUR, THERMAL, Job, doubles, singles
from benchmarks.blind.judge import all_right, first_is_right, share

Pick = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Columns (m, k) of length one and data (m,) to coefficients (k,), zero for what is not chosen."""


@dataclass(frozen=True)
class Library:
    """The case as a regression beside the base: data (2n,), columns (2n, k) of length one, and their names (k,)."""

    y: np.ndarray
    columns: np.ndarray
    names: np.ndarray
    hidden: np.ndarray  # (2n, number hidden): what is really missing, beside the base


def library(folder: Path, case: Case, model: str) -> Library:
    """Stack RA over RB, project the base out of everything."""
    from hil.campaign.reader import read_campaign
    from hil.model import load_model
    from hil.model.effects.catalogue import EFFECTS
    from hil.reconcile.search.problem import pose

    problem = pose(read_campaign(folder), load_model(model), EFFECTS)
    first = [c for c in problem.candidates if c.tier == 1]
    stacked = np.hstack([c.columns.transpose(1, 0, 2).reshape(-1, len(c.parameters)) for c in first])
    names = np.concatenate([[c.name] * len(c.parameters) for c in first])
    q, _ = np.linalg.qr(base_columns(case.night, model))

    def beside(values: np.ndarray) -> np.ndarray:
        return np.asarray(values - q @ (q.T @ values))

    left = beside(stacked)
    norm = np.linalg.norm(left, axis=0)
    usable = norm > 0.02 * np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
    y = beside((case.rates - case.night.w[:, :2]).T.ravel())
    hidden = [beside(s.T.ravel()) for s in case.signals]
    return Library(y, left[:, usable] / norm[usable], names[usable], np.array(hidden).T.reshape(len(y), -1))


def _least_squares(x: np.ndarray, y: np.ndarray, chosen: Sequence[int]) -> np.ndarray:
    out = np.zeros(x.shape[1])
    out[list(chosen)] = np.linalg.lstsq(x[:, list(chosen)], y, rcond=1e-8)[0]
    return out


def _bic(x: np.ndarray, y: np.ndarray, chosen: Sequence[int]) -> float:
    residual = y - x @ _least_squares(x, y, chosen) if chosen else y
    return float(len(y) * np.log(np.mean(residual**2)) + len(chosen) * np.log(len(y)))


def stepwise_bic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Add the column that helps most, as long as the information criterion falls."""
    chosen: list[int] = []
    best = _bic(x, y, chosen)
    while len(chosen) < 10:
        residual = y - x @ _least_squares(x, y, chosen) if chosen else y
        step = [*chosen, int(np.argmax(np.abs(x.T @ residual)))]
        value = _bic(x, y, step)
        if value >= best:
            break
        chosen, best = step, value
    return _least_squares(x, y, chosen) if chosen else np.zeros(x.shape[1])


def lasso_cv(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """scikit-learn's LassoCV, five folds."""
    from sklearn.linear_model import LassoCV

    return np.asarray(LassoCV(cv=5, fit_intercept=False, n_jobs=1).fit(x, y).coef_)


def stability_selection(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Columns that the first five of the Lasso path hold in 60 % of half samples (Meinshausen and Bühlmann)."""
    from sklearn.linear_model import lars_path

    rng = np.random.default_rng(0)
    held = np.zeros(x.shape[1])
    for _ in range(50):
        half = rng.permutation(len(y))[: len(y) // 2]
        active = lars_path(x[half], y[half], method="lasso", max_iter=5)[1]
        held[active] += 1.0 / 50
    chosen = np.flatnonzero(held >= 0.6)
    return _least_squares(x, y, chosen.tolist()) if len(chosen) else np.zeros(x.shape[1])


def stlsq(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Sequentially thresholded least squares of pysindy; threshold at three standard errors of a unit column."""
    from pysindy import STLSQ

    scale = float(np.std(y))
    fitted = STLSQ(threshold=3.0, alpha=0.05).fit(x, y[:, None] / scale)
    return np.asarray(fitted.coef_).ravel() * scale


def frols(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """SysIdentPy's orthogonal forward regression by error reduction ratio, stopped by BIC."""
    from sysidentpy.model_structure_selection import FROLS

    search = FROLS(order_selection=False, n_terms=10, xlag=1, ylag=1)
    series = np.concatenate([np.zeros(search.max_lag), y])  # it drops the first rows of a time series
    _, order, _ = search.error_reduction_ratio(x, series[:, None], 10)
    order = [int(i) for i in order]
    lengths = [_bic(x, y, order[:k]) for k in range(len(order) + 1)]
    chosen = order[: int(np.argmin(lengths))]
    return _least_squares(x, y, chosen) if chosen else np.zeros(x.shape[1])


RIVALS: dict[str, Pick] = {
    "stepwise, BIC": stepwise_bic,
    "LassoCV (scikit-learn)": lasso_cv,
    "stability selection": stability_selection,
    "STLSQ (pysindy)": stlsq,
    "FROLS (SysIdentPy), BIC": frols,
}


def judged(given: Library, coefficients: np.ndarray) -> tuple[bool, bool, bool]:
    """(something found, the strongest name is a hidden term, exactly the hidden terms and nothing else)."""
    parts = {
        name: given.columns[:, given.names == name] @ coefficients[given.names == name]
        for name in dict.fromkeys(given.names[coefficients != 0.0])
    }
    strength = {name: float(np.linalg.norm(part)) for name, part in parts.items()}
    means = {name: {k for k in range(given.hidden.shape[1]) if _reproduces(given, name, k)} for name in parts}
    strongest = max(strength, key=strength.__getitem__, default="")
    all_told = set().union(*means.values()) if means else set()
    exact = bool(parts) and all(means.values()) and len(parts) == given.hidden.shape[1] == len(all_told)
    return bool(parts), bool(means.get(strongest)), exact or (not parts and not given.hidden.shape[1])


def _reproduces(given: Library, name: str, k: int) -> bool:
    """Whether some combination of a name's columns is 90 % of a hidden term's square."""
    x, s = given.columns[:, given.names == name], given.hidden[:, k]
    left = s - x @ np.linalg.lstsq(x, s, rcond=1e-8)[0]
    return bool(left @ left < 0.1 * (s @ s))


def compare(job: Job) -> dict[str, tuple[bool, bool, bool]]:
    """One case, everybody's answer."""
    from hil.campaign.reader import read_campaign
    from hil.reconcile import reconcile

    case = make_case(job.seed, job.hidden, job.d, model=job.model, design=job.design, noise=job.noise)
    with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = write_case(case, Path(scratch) / "case")
        given = library(folder, case, job.model)
        document = reconcile(read_campaign(folder), job.model, alpha=job.alpha).document()
        answers = {name: judged(given, pick(given.columns, given.y)) for name, pick in RIVALS.items()}
    exact = all_right(document, job.hidden) if job.hidden else document["verdict"] == "none"
    answers["hil reconcile"] = (document["verdict"] != "none", first_is_right(document, job.hidden), exact)
    return answers


def jobs(cases: int) -> list[Job]:
    """Nulls with and without correlation from run to run, one effect, two effects; four collects, thermal base."""
    none = Job("", 80_000)
    nulls = [
        replace(none, row=f"nothing, {kind}", seed=80_000 + i, noise=Noise(kind=kind))
        for kind in ("white", "plain")
        for i in range(cases)
    ]
    rest = [j for j in (*singles(4 * cases), *doubles(4 * cases)) if (j.design, j.model) == (FOUR, THERMAL)]
    rows = ("one effect, d = 6", "one effect, d = 8", "two effects, d = 8 each")
    return nulls + [j for row in rows for j in [j for j in rest if j.row == row][:cases]]


def main() -> None:
    """Run all cases and print one table."""
    parser = argparse.ArgumentParser(description="Other methods on the same sealed cases.")
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    todo = [replace(j, seed=j.seed + chosen.seed) for j in jobs(chosen.cases)]
    with ProcessPoolExecutor(2) as pool:
        answers = list(pool.map(compare, todo, chunksize=1))
    print("| method | case | n | finds something | first right | exactly right |\n|---|---|---|---|---|---|")
    for method in ("hil reconcile", *RIVALS):
        for row in dict.fromkeys(j.row for j in todo):
            mine = [a[method] for j, a in zip(todo, answers, strict=True) if j.row == row]
            cells = [share(flag[k] for flag in mine) for k in range(3)]
            print(f"| {method} | {row} | {len(mine)} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
