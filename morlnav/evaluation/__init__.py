"""Evaluation of any multi-objective policy: fronts, hypervolume, expected utility."""

from morlnav.evaluation.pareto import expected_utility, hypervolume, pareto_mask, utility

__all__ = [
    "expected_utility",
    "hypervolume",
    "pareto_mask",
    "utility",
]
