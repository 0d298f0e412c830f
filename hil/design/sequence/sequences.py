"""Sequences of collects: which there are for a bench, and what each is worth before it is ever run.

    for sequence in sequences(("1", "2", "3", "4")):      # ("1", "2", "3"), ("1", "3", "2"), palindromes …
        worth = sequence_worth(scene_of(bench, 2, sequence, timing), form)
        worth.white            # {"MUB": 1.22}: standard errors for unit noise in every average
        worth.drift            # {"MUB": 1.5}: what a drift of 1 deg/hr per collect adds
        worth.residuals        # 0: nothing could contradict the model

The published order 1-2-3 makes of a steady drift one and a half times as much MU. The order 1-3-2 keeps it out of bias
and MU; a palindrome keeps it out of everything and comes to each position from both sides. A fourth collect with the
spin axis down leaves the first residuals, and separates MU from what goes with the square of the acceleration.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.config.bench import Bench
from hil.design.budget.sources import Scene
from hil.design.visibility.map import base_values
from hil.model import Model
from hil.model.forms import LinearForm
from hil.solve.runs import OBSERVABLE, solve_rates
from procedures.settings import CollectSettings

IMMUNE = 0.05
"""A drift counts as kept out of a parameter where not a twentieth of it per collect is left in.

The order 1-3-2 leaves in MU what a bench that is not level mixes from GS: 0.02 at a tilt of 16 milliradians.
"""

_FEWEST, _MOST = 3, 4  # different positions in a proposed sequence


@dataclass(frozen=True)
class Worth:
    """What one self-calibration of a sequence is worth for one sensor; every mapping is by parameter.

    `white` standard errors for 1 deg/hr of noise in every average, `drift` the change by 1 deg/hr per collect;
    `residuals` degrees of freedom; `tells_even_terms` whether MU and terms in the square of the acceleration are told
    apart; `terms` how many of 4 linear, 10 with the squares, 13 with scale factor and misalignments the rates can see.
    """

    white: Mapping[str, float]
    drift: Mapping[str, float]
    residuals: int
    condition_number: float
    tells_even_terms: bool
    terms: tuple[int, int, int]

    def immune(self, names: Sequence[str] | None = None) -> bool:
        """Whether a steady drift is kept out of the parameters `names` (None: all)."""
        return all(abs(self.drift[name]) < IMMUNE for name in (names or self.drift))


def sequences(positions: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield the sequences worth looking at: three or four of the positions in every order, and their palindromes.

    An order and its reverse are one; a palindrome has its turning point once or twice. Of more than four positions
    every choice comes in the given order only: there are too many others.
    """
    arranged = itertools.permutations if len(positions) <= _MOST else itertools.combinations
    for count in range(_FEWEST, min(_MOST, len(positions)) + 1):
        for order in arranged(positions, count):
            if order <= order[::-1] or len(positions) > _MOST:
                yield order
            yield from palindromes(order)


def palindromes(order: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return there and back, the turning point once and twice."""
    return order + order[-2::-1], order + order[::-1]


def scene_of(
    bench: Bench,
    sensor: int,
    positions: Sequence[str],
    collect: CollectSettings,
    temperature_degC: float = 20.0,
    model: Model | None = None,
) -> Scene:
    """Return one self-calibration on a bench as it would be: orientations, times, noise.

    Errors of attitude act on the model's values at that temperature, or on typical ones.
    """
    n = len(positions)
    table = bench.sensors[sensor].built
    apart_s = collect.index_s + collect.settle_s + collect.duration_s
    conditions = Conditions(
        bench.sensor(sensor),
        collect=np.arange(1, n + 1),
        run=np.ones(n, dtype=np.int64),
        position=np.array(positions),
        start_s=np.arange(n, dtype=np.float64) * apart_s,
        duration_s=np.full(n, collect.duration_s),
        **bench.along_axes(sensor, positions),
        columns={"temperature_degC": np.full(n, temperature_degC)},
    )
    axes = np.array([table[label].axes for label in positions])
    return Scene(conditions, axes, base_values(conditions, model), bench.uncertainties.of_collects(conditions))


def sequence_worth(scene: Scene, form: LinearForm) -> Worth | None:
    """Return what a sequence is worth for the parameters of `form`; None where it cannot know them all."""
    conditions = scene.conditions
    design = form.columns(conditions)
    order = np.arange(len(conditions)) - 0.5 * (len(conditions) - 1)
    ramp = np.repeat(order[:, None], scene.channels, axis=1)
    solution = solve_rates(design, ramp, 1.0, form.names)
    if np.any(np.isnan(solution.values)):
        return None
    return Worth(
        dict(zip(form.names, solution.se.tolist(), strict=True)),
        dict(zip(form.names, solution.values.tolist(), strict=True)),
        int(solution.degrees_of_freedom),
        float(solution.condition_number),
        _tells_even_terms(conditions, design),
        seen_terms(conditions.f_g, conditions.w_deg_per_hr),
    )


def seen_terms(f_g: FloatArray, w_deg_per_hr: FloatArray) -> tuple[int, int, int]:
    """Return how many combinations a channel's rates can see: of 4 linear terms, with six squares, with the scale.

    `f_g` (n, 3) in g and `w_deg_per_hr` (n, 3) are along the sensor's axes, one row per collect.

    Linear: bias and sensitivity along A, B, S. Squares: the six products of accelerations. Scale factor and the two
    misalignments act on the earth rate along the three axes, so that only a change of heading brings them apart.
    """
    one = np.ones((len(f_g), 1))
    squares = np.stack([f_g[:, i] * f_g[:, j] for i, j in itertools.combinations_with_replacement(range(3), 2)], -1)
    sets = ([one, f_g], [one, f_g, squares], [one, f_g, squares, w_deg_per_hr / 15.0])
    linear, quadratic, scale = (int(np.linalg.matrix_rank(np.hstack(columns), tol=OBSERVABLE)) for columns in sets)
    return linear, quadratic, scale


def _tells_even_terms(conditions: Conditions, design: FloatArray) -> bool:
    """Whether every parameter stays known beside a term in fS² of each channel."""
    even = conditions.f_g[:, 2, None, None] ** 2 * np.eye(design.shape[1])
    both = np.concatenate([design, even], axis=-1)
    values = solve_rates(both, np.zeros(both.shape[:2]), 1.0).values
    # The bias may stay entangled with a constant square; what matters are the sensitivities.
    return bool(np.all(np.isfinite(values[design.shape[1] : design.shape[-1]])))
