"""Where the effects that were added act: the collects in which model and measurement differ because of them.

Of an effect the fit knows what it contributes to every collect, and how surely. The base was fitted to the same
collects and takes over what it can imitate, so that residuals show less of it, and in other places: a mass unbalance of
7.5 deg/hr, seen in three collects by a model without one, is 7.5 at position 3, but 2.5, 2.5 and 5 in the residuals of
positions 1 to 3. What an effect contributes itself is where a reader looks for it. Only where the base imitates a part
of it in whole, so that nobody can know that part, is it what the effect leaves beside the base.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
from scipy.special import ndtr

from hil.campaign import BoolArray, Conditions, FloatArray
from hil.campaign.stand_ins import temperature_of
from hil.reconcile.result import Disagreement
from hil.reconcile.search.fitted import Fitted, FittedBlock
from hil.solve.identifiability import CANNOT_BE_SEEN
from hil.solve.rows import Block

_MATERIAL = 0.25  # of an effect's largest contribution to the sensor: what is smaller is not a place of it
_ALIKE = 0.9  # F1 from which a simpler description stands for the collects it is about


def places(fit: Fitted, terms: Sequence[set[tuple[int, int]]], p_value: float, alpha: float) -> list[Disagreement]:
    """Return the places of what was added, largest first: `terms` (sensor, term) of each name, `p_value` its detection.

    A place is a channel, the positions, or, where a position is gone to again and moves another way then, the collects
    of a run, and the temperatures or runs in which all that was added contributes materially and with one sign; its
    size is the mean contribution. q-values hold for the whole map (Benjamini and Hochberg), and none is smaller than
    the chance that nothing is missing at all.
    """
    out: list[Disagreement] = []
    for sensor, known in fit.conditions.items():
        own = [block for block in fit.blocks if block.search.block.sensor == sensor]
        parts = [_described(members, fit, own) for members in terms]
        peaks = [max(float(np.abs(design @ fit.values).max(initial=0.0)) for design in part) for part in parts]
        if not any(peaks):
            continue
        least = _MATERIAL * min(peak for peak in peaks if peak > 0.0)
        for place, block in enumerate(own):
            design = np.sum([part[place] for part in parts], axis=0)
            values = design @ fit.values
            material = (np.abs(values) >= least) & _told(block, values)
            for where, rows in _cells(block.search.block, known, values, material):
                mean = design[rows].mean(axis=0)
                error = float(np.sqrt(max(mean @ fit.covariance @ mean, 0.0)))
                out.append(Disagreement(where, float(values[rows].mean()), error, 1.0))
    return sorted(_sure(out, p_value, alpha), key=lambda d: -abs(d.size_deg_per_hr))


def _described(members: set[tuple[int, int]], fit: Fitted, own: Sequence[FittedBlock]) -> list[FloatArray]:
    """Return how the sensor's blocks follow one effect, (N, p) each; beside the base where no more can be known."""
    itself, beside, white, rest_white = [], [], [], []
    for block in own:
        design, base = fit.design(block, members), block.search.block.base
        white_base, white_design = np.split(block.white(np.hstack([base, design])), [base.shape[1]], axis=1)
        absorbed = np.linalg.lstsq(white_base, white_design, rcond=1e-8)[0]
        white.append(white_design)
        rest_white.append(white_design - white_base @ absorbed)
        itself.append(design)
        beside.append(design - base @ absorbed)
    columns, rest = np.vstack(white), np.vstack(rest_white)
    norm = np.linalg.norm(columns, axis=0)
    acting = norm > 0.0
    # The smallest share of any combination of columns that is left beside the base, each column at unit size.
    least = np.linalg.svd(rest[:, acting] / norm[acting], compute_uv=False).min() if acting.any() else 0.0
    return itself if least > CANNOT_BE_SEEN else beside


def _told(block: FittedBlock, values: FloatArray) -> BoolArray:
    """Return the rows (N,) of temperatures at which what an effect does, (N,), is not all of the base's values there.

    That is where these were calibrated at each: at one that was only seen with the effect nothing disagrees.
    """
    rows = block.search.block
    if not block.search.noise.calibrated:
        return np.ones(len(values), dtype=bool)
    own = rows.at_each_temperature(rows.values)
    left = np.abs(values - own @ np.linalg.lstsq(own, values, rcond=1e-8)[0])
    stations, at = np.unique(rows.station, return_inverse=True)
    most = np.zeros(len(stations))
    np.maximum.at(most, at, left)
    return np.asarray(most[at] >= _MATERIAL * left.max())


def _sure(found: Sequence[Disagreement], p_value: float, alpha: float) -> list[Disagreement]:
    """Give every place its q-value, and keep those that hold; where none does by itself, the surest."""
    scores = [abs(d.size_deg_per_hr) / max(d.se_deg_per_hr, 1e-300) for d in found]
    q_values = false_discovery(2.0 * ndtr(-np.array(scores)))
    least = max(alpha, float(q_values.min(initial=np.inf)))
    pairs = zip(found, q_values.tolist(), strict=True)
    return [replace(d, q_value=max(q, p_value)) for d, q in pairs if q <= least]


def false_discovery(p_values: FloatArray) -> FloatArray:
    """Return the q-values of p-values (m,), after Benjamini and Hochberg (1995)."""
    order = np.argsort(p_values)[::-1]
    ranks = np.arange(len(p_values), 0, -1)
    out = np.empty(len(p_values))
    out[order] = np.minimum.accumulate(np.minimum(p_values[order] * len(p_values) / ranks, 1.0))
    return out


def _cells(
    block: Block, conditions: Conditions, values: FloatArray, material: BoolArray
) -> Iterator[tuple[dict[str, Any], BoolArray]]:
    """The material rows of a block as places in the campaign's own words, each with the rows that it covers."""
    names = list(conditions.sensor.channels)
    nth = np.zeros(len(conditions), dtype=np.int64)
    for own in conditions.of_each_run.values():
        nth[own[np.argsort(conditions.start_s[own], kind="stable")]] = np.arange(1, len(own) + 1)
    parted = {"": 0 * block.rows, "position": conditions.position[block.rows], "collect_of_run": nth[block.rows]}
    for channel in np.unique(block.channel):
        on_channel = block.channel == channel
        for sign in (1.0, -1.0):
            touched = on_channel & material & (sign * values > 0.0)
            where = {"sensor": block.sensor, "channel": names[channel]}
            every: dict[str, list[tuple[dict[str, Any], BoolArray]]] = {key: [] for key in parted}
            for key, parts in parted.items():
                for part in np.unique(parts[touched]).tolist():
                    there = on_channel & (parts == part)
                    cells = _extents(block, conditions, touched & there, there)
                    place = where | ({key: part} if key else {})
                    # Of what moves both ways the mean is nothing, and the same rows would be two places.
                    every[key] += [
                        (place | extra, rows)
                        for extra, rows in cells
                        if 2.0 * sign * values[rows].sum() > np.abs(values[rows]).sum()
                    ]
            alike = (found for found in every.values() if _agreement(_any(found, on_channel), touched) >= _ALIKE)
            yield from next(alike, every["position"])


def _extents(
    block: Block, conditions: Conditions, touched: BoolArray, among: BoolArray
) -> Iterator[tuple[dict[str, Any], BoolArray]]:
    """Describe the touched rows among some: all of them, ranges of temperature, or a list of runs; whichever fits."""
    if not np.any(touched):
        return
    if _agreement(among, touched) >= _ALIKE:
        yield {}, among
        return
    temperature = conditions.columns.get("temperature_degC")
    if temperature is not None:
        station = block.station  # unbroken ranges of setpoints of which most rows are touched
        stations = groupby(np.unique(station[among]), lambda n: n >= 0 and _mostly(touched, among & (station == n)))
        ranges = [among & np.isin(station, list(numbers)) for hit, numbers in stations if hit]
        if _agreement(_any([({}, rows) for rows in ranges], among), touched) >= _ALIKE:
            for rows in ranges:
                span = np.round(10.0 * temperature[block.rows[rows]], 6)  # in tenths
                ends = [float(np.floor(span.min()) / 10.0), float(np.ceil(span.max()) / 10.0)]
                yield {"temperature_degC": ends, "temperature_of": temperature_of(conditions)}, rows
            return
    runs = [run for run in np.unique(block.run[touched]) if _mostly(touched, among & (block.run == run))]
    rows = among & np.isin(block.run, runs)
    if np.any(rows):
        yield {"runs": list(dict.fromkeys(conditions.run[block.rows[rows]].tolist()))}, rows


def _mostly(touched: BoolArray, rows: BoolArray) -> bool:
    return bool(touched[rows].mean() >= 0.5) if np.any(rows) else False


def _any(cells: Sequence[tuple[dict[str, Any], BoolArray]], like: BoolArray) -> BoolArray:
    return np.any([rows for _, rows in cells], axis=0) if cells else np.zeros_like(like)


def _agreement(described: BoolArray, touched: BoolArray) -> float:
    """F1 of a description."""
    return 2.0 * float((described & touched).sum()) / max(float(described.sum() + touched.sum()), 1.0)
