"""What nobody could beat on the sealed cases: a search that is told the noise's covariance and the true columns.

    python -m benchmarks.reconcile_oracle
    python -m benchmarks.reconcile_oracle --pairs 120
    python -m benchmarks.reconcile_oracle --scatter 400 --asked 10 --only flicker rrw    # what scatters, three sweeps

Its threshold holds 5 % over the same candidates as the product's search. What it misses is a limit of the data; what
the product misses beyond that is the price of not knowing the noise, or the product's own. Of two effects each must
stand beside the other, and no two others explain as much: a second candidate is grown from each of the best firsts.

Of an effect on the scatter it knows size, shape and white noise, and asks how much likelier averages are with it than
with white noise and an offset of each run, both of any size; and the spectra inside the collects than with white noise
and a Gauss-Markov process of any size and time constant, which stays inside.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.blind.cases import Noise, base_columns, make_case, noise_covariance, write_case
from benchmarks.blind.jobs import SETTINGS, SIZES, Job, doubles, visible
from benchmarks.blind.night import Design
from benchmarks.coverage import SWEEPS, asked_of, hidden
from hil.campaign import Campaign, Collects, Conditions
from hil.campaign.reader import read_campaign
from hil.config import load_bench, load_sweep
from hil.design.conditions import planned_conditions
from hil.errors import InputError
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS, variance_effect_by_id
from hil.model.effects.columns import flattened
from hil.model.forms import named_form
from hil.reconcile import reconcile
from hil.reconcile.search.problem import pose
from procedures.plan import make_plan

_ALPHA, _SAME, _LEAST_KEPT = 0.05, 0.95, 0.04
_NULLS, _DRAWS = 1500, 200
_FIRSTS = 30
_TRIAD, _WALK, _BLOCKS = "espec-stim300-example", 0.12, 60  # the white noise of the units of `benchmarks.coverage`
_OFFSETS = (0.0, 0.35, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0)


@dataclass(frozen=True)
class Known:
    """What is known of a night: what whitens its rows, the base's columns, the candidates' spans, and the threshold."""

    white: np.ndarray
    basis: np.ndarray
    spans: list[tuple[str, np.ndarray]]
    threshold: float

    def seen(self, signal: np.ndarray) -> np.ndarray:
        """Return what the base leaves of a signal (n, c), in units of the noise."""
        rows = self.white @ signal.T.ravel()
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def errors(self, draws: int, rng: np.random.Generator) -> np.ndarray:
        """Return noise beside the base, (rows, draws)."""
        rows = rng.standard_normal((len(self.white), draws))
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def same(self, name: str, true: np.ndarray) -> set[str]:
        """Return the names that are as good for a unit column `true`."""
        return {name, *(n for n, s in self.spans if np.linalg.norm(s.T @ true) > _SAME)}


def known(design: Design, model: str, seed: int) -> Known:
    """Lay out a night and find the threshold that holds 5 % over all candidates."""
    case, rng = make_case(seed, (), 1.0, model=model, design=design), np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as scratch:
        campaign = read_campaign(write_case(case, Path(scratch) / "case"))
    white = np.kron(np.eye(2), np.linalg.inv(np.linalg.cholesky(noise_covariance(case.night, Noise()))))
    basis, _ = np.linalg.qr(white @ base_columns(case.night, model))
    out = Known(white, basis, [], 0.0)
    for candidate in pose(campaign, load_model(model), (*BASE_EFFECTS, *EFFECTS)).candidates:
        columns = white @ np.concatenate([candidate.columns[:, channel, :] for channel in (0, 1)])
        columns = columns[:, np.any(columns, axis=0)] / np.linalg.norm(columns[:, np.any(columns, axis=0)], axis=0)
        left, kept, _ = np.linalg.svd(columns - basis @ (basis.T @ columns), full_matrices=False)
        if np.any(kept > _LEAST_KEPT):
            out.spans.append((candidate.name, left[:, kept > _LEAST_KEPT]))
    nulls = surprise(out.spans, out.errors(_NULLS, rng)).max(axis=0)
    return replace(out, threshold=float(np.quantile(nulls, 1.0 - _ALPHA)))


def surprise(spans: Sequence[tuple[str, np.ndarray]], data: np.ndarray) -> np.ndarray:
    """Minus log of each candidate's p-value, (candidates, data sets)."""
    return np.array([-stats.chi2.logsf(np.sum((s.T @ data) ** 2, axis=0), s.shape[1]) for _, s in spans])


def shares(design: Design, model: str, seed: int) -> dict[float, list[tuple[float, float]]]:
    """Per size: the shares detected, and detected with the true name first, one pair for each visible effect."""
    night, rng = known(design, model, seed), np.random.default_rng(seed)
    out: dict[float, list[tuple[float, float]]] = {d: [] for d in SIZES}
    for name in visible(design, model):
        true = night.seen(make_case(seed, (name,), 1.0, model=model, design=design).signals[0])
        true = true / np.linalg.norm(true)
        same = night.same(name, true)
        others = np.array([n not in same for n, _ in night.spans])
        errors = night.errors(_DRAWS, rng)
        for d in SIZES:
            data = d * true[:, None] + errors
            own = -stats.chi2.logsf((true @ data) ** 2, 1)
            found = own > night.threshold
            first = found & (own > surprise(night.spans, data)[others].max(axis=0))
            out[d].append((float(found.mean()), float(first.mean())))
    return out


def both(job: Job) -> tuple[bool, bool]:
    """Whether each of two effects stands beside the other, and whether no two others explain as much."""
    case = make_case(job.seed, job.hidden, job.d, model=job.model, design=job.design)
    night = known(job.design, job.model, job.seed)
    signals = [night.seen(signal) for signal in case.signals]
    data = sum(signals) + night.errors(1, np.random.default_rng([job.seed, 2]))[:, 0]
    true, _ = np.linalg.qr(np.stack(signals, axis=1))
    stand = [one - other * (other @ one) / (other @ other) for one, other in (signals, signals[::-1])]
    seen = all(-stats.chi2.logsf((own @ data) ** 2 / (own @ own), 1) > night.threshold for own in stand)
    explained = -stats.chi2.logsf(np.sum((true.T @ data) ** 2), 2)
    same = [night.same(name, own / np.linalg.norm(own)) for name, own in zip(job.hidden, signals, strict=True)]
    gains = surprise(night.spans, data[:, None])[:, 0]
    for i in np.argsort(-gains)[:_FIRSTS]:
        first, span = night.spans[i]
        left = data - span @ (span.T @ data)
        known_by = np.sum((span.T @ data) ** 2)
        for second, further in night.spans:
            if first == second or all({first, second} & own for own in same):
                continue
            own, _ = np.linalg.qr(further - span @ (span.T @ further))
            gain = known_by + np.sum((own.T @ left) ** 2)
            if -stats.chi2.logsf(gain, span.shape[1] + own.shape[1]) > explained:
                return seen, False
    return seen, seen


@dataclass(frozen=True)
class Wandering:
    """A planned sweep (n collects, c channels) in which a sensor scatters: covariances (n·c, n·c), (deg/hr)²."""

    rows: Conditions
    model: str
    columns: np.ndarray
    white: np.ndarray
    added: np.ndarray

    @classmethod
    def of(cls, sweep: str, name: str, size: str) -> Wandering:
        """Lay out a sweep of `benchmarks.coverage`, by its unit and its sizes; `InputError` where no sensor has it."""
        entry, bench = variance_effect_by_id(name), load_bench(_TRIAD if sweep == "triad" else "simulated")
        planned = planned_conditions(make_plan(load_sweep(SWEEPS[sweep]).procedure()), bench)
        rows, model = planned[min(2, len(planned))], asked_of(name, sweep == "triad")
        if not entry.applies_to(rows.sensor):
            raise InputError(f"{name}: not in this sensor")
        term = hidden(entry, rows, size)
        (value,) = (each["value"] for each in term["parameters"].values())
        added = value**2 * sum(part.covariance(rows) for part in entry.scatter(rows, term["shape"]))
        columns = flattened(named_form(model, rows).columns(rows))
        white = np.repeat(_WALK**2 * 3600.0 / rows.duration_s, len(rows.sensor.channels))
        return cls(rows, model, np.linalg.qr(columns[:, np.any(columns, axis=0)])[0], np.diag(white), added)

    def log_likelihood(self, rates: np.ndarray, covariance: np.ndarray, *, scaled: bool) -> np.ndarray:
        """Of rates (n·c, m) beside any values of the base, (m,); of a covariance of any size where `scaled`."""
        factor = np.linalg.cholesky(covariance)
        white, columns = np.linalg.solve(factor, rates), np.linalg.solve(factor, self.columns)
        basis, r = np.linalg.qr(columns)
        left = np.sum(white**2, axis=0) - np.sum((basis.T @ white) ** 2, axis=0)
        freedom = len(rates) - self.columns.shape[1]
        log_det = np.sum(np.log(np.diag(factor))) + np.sum(np.log(np.abs(np.diag(r))))
        return np.asarray(-log_det - 0.5 * (freedom * (1.0 + np.log(left / freedom)) if scaled else left))

    def times_likelier(self, rates: np.ndarray) -> np.ndarray:
        """Log of how much likelier rates (n·c, m) are than with ordinary noise of any size, (m,)."""
        same = np.equal.outer(self.rows.run, self.rows.run).astype(np.float64)
        offsets = np.kron(same, np.eye(len(self.rows.sensor.channels))) * self.white[0, 0]
        ordinary = [self.log_likelihood(rates, self.white + o**2 * offsets, scaled=True) for o in _OFFSETS]
        return self.log_likelihood(rates, self.white + self.added, scaled=False) - np.max(ordinary, axis=0)

    def draw(self, nights: int, rng: np.random.Generator) -> np.ndarray:
        """Return rates of so many nights of a unit that is zero, (n·c, nights), deg/hr."""
        factor = np.linalg.cholesky(self.white + self.added)
        return np.asarray(factor @ rng.standard_normal((len(factor), nights)))

    @property
    def times_white(self) -> float:
        """How large the scatter beside the base is, in white noises."""
        beside = np.trace(self.added) - np.trace(self.columns.T @ self.added @ self.columns)
        return float(np.sqrt(max(beside, 0.0) / (len(self.added) - self.columns.shape[1]) / self.white[0, 0]))

    def campaign(self, rates: np.ndarray) -> Campaign:
        """Return a night of rates (n·c,) as a campaign of one sensor."""
        own = self.rows.w_channels_deg_per_hr + rates.reshape(len(self.rows), -1)
        errors = np.sqrt(np.diag(self.white)).reshape(own.shape)
        return Campaign("scatter", "simulated", {self.rows.sensor.number: Collects(self.rows, own, errors)})


def inside(name: str, night: Wandering, size: str) -> float:
    """Expected log of how much likelier all spectra inside the collects are with an effect than with a short process.

    Of sixty blocks of each collect, their mean and slope taken off, beside white noise: both of any size.
    """
    rows, entry = night.rows, variance_effect_by_id(name)
    step = float(np.median(rows.duration_s)) / _BLOCKS
    begins = step * np.arange(_BLOCKS)
    one = replace(rows.rows(np.zeros(_BLOCKS, dtype=np.int64)), start_s=begins, duration_s=np.full(_BLOCKS, step))
    term = hidden(entry, rows, size)
    (value,) = (each["value"] for each in term["parameters"].values())
    channels = len(rows.sensor.channels)
    true = value**2 * sum(part.covariance(one) for part in entry.scatter(one, term["shape"]))[::channels, ::channels]
    line, _ = np.linalg.qr(np.vander(begins, 2))
    waves = np.fft.rfft(np.eye(_BLOCKS) - line @ line.T, axis=0)[1 : _BLOCKS // 2]
    seen = np.real(np.einsum("kn,nm,km->k", waves, true + np.eye(_BLOCKS) * _WALK**2 * 3600.0 / step, waves.conj()))
    white = np.sum(np.abs(waves) ** 2, axis=1)
    distance, least = np.abs(np.subtract.outer(begins, begins)), np.inf
    for tau_s in 60.0 * step * np.geomspace(0.02, 2.0, 9):
        short = np.real(np.einsum("kn,nm,km->k", waves, np.exp(-distance / tau_s), waves.conj()))
        for share in np.append(0.0, np.geomspace(1e-3, 1e3, 61)):
            ratio = seen / (white + share * short)
            least = min(least, float(np.sum(np.log(ratio.mean()) - np.log(ratio))))
    return least * len(rows) * channels


def scatter(nights: int, asked: int, only: Sequence[str]) -> None:
    """Print of effects on the scatter, in the middle and at the upper end of typical, how well they can be told."""
    heads = ["sweep", "effect", "times the white noise", "averages: log of how much likelier", "inside the collects"]
    heads += [f"of {asked} named, or in class", "other names"] * bool(asked)
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    for sweep, name, size in product(SWEEPS, only or (each.id for each in VARIANCE_EFFECTS), ("middle", "high")):
        try:
            night = Wandering.of(sweep, name, size)
        except InputError:
            continue
        if night.times_white < 1.0:
            continue
        rates = night.draw(nights, np.random.default_rng([7, len(name)]))
        low, middle, high = np.quantile(night.times_likelier(rates), (0.1, 0.5, 0.9))
        told = f"{middle:.1f} ({low:.1f} to {high:.1f}) | {inside(name, night, size):.1f} |"
        own, others = 0, list[str]()
        for k in range(asked):
            found = reconcile(night.campaign(rates[:, k]), night.model, prove=False).effects
            names = {each.id for each in found} | {rival.id for each in found for rival in each.confusable_with}
            own += name in names
            others += [each.id for each in found if name not in names]
        told += f" {own} | {', '.join(others) or 'none'} |" * bool(asked)
        print(f"| {sweep} | `{name}` {size} | {night.times_white:.1f} | {told}", flush=True)


def main() -> None:
    """Print the mean over all designs and their visible effects, one line per size; or that of pairs of effects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, help="so many pairs of effects, d = 8 each, those of the sealed cases")
    parser.add_argument("--scatter", type=int, help="effects on the scatter, so many nights of each")
    parser.add_argument("--asked", type=int, default=0, help="of so many of these nights ask hil reconcile, too")
    parser.add_argument("--only", nargs="*", default=[], help="of these effects on the scatter")
    given = parser.parse_args()
    if given.scatter:
        scatter(given.scatter, given.asked, given.only)
        return
    if count := given.pairs:
        found = np.array([both(job) for job in doubles(count)])
        seen, right = found.mean(axis=0)
        print(f"of {count} pairs each stands beside the other: {seen:.2f}; the right two: {right:.2f}")
        return
    everything = [shares(design, model, seed) for seed, (design, model) in enumerate(SETTINGS, start=1)]
    print("| d | finds something | true class first | effects |\n|---|---|---|---|")
    for d in SIZES:
        pairs = np.array([pair for part in everything for pair in part[d]])
        print(f"| {d:g} | {pairs[:, 0].mean():.3f} | {pairs[:, 1].mean():.3f} | {len(pairs)} |")


if __name__ == "__main__":
    main()
