"""From rates to parameters: least squares, what is observable, the noise of the rows, the same temperature."""

from hil.solve.least_squares import Solution, solve
from hil.solve.repeats import repeats
from hil.solve.runs import Estimate, RunSolution, solve_campaign

__all__ = ["Estimate", "RunSolution", "Solution", "repeats", "solve", "solve_campaign"]
