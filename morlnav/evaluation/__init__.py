"""Evaluation of any multi-objective policy: returns, fronts, hypervolume, expected utility."""

from morlnav.evaluation.evaluator import Evaluation
from morlnav.evaluation.front import describe_front, front_table, read_reference, reference_from_bounds
from morlnav.evaluation.labels import preference_label, read_preference_label
from morlnav.evaluation.pareto import expected_utility, hypervolume, pareto_mask, utility
from morlnav.evaluation.returns import discounted_returns, eval_env

__all__ = [
    "Evaluation",
    "describe_front",
    "discounted_returns",
    "eval_env",
    "expected_utility",
    "front_table",
    "hypervolume",
    "pareto_mask",
    "preference_label",
    "read_preference_label",
    "read_reference",
    "reference_from_bounds",
    "utility",
]
