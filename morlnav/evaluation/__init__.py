"""Evaluation of any multi-objective policy: returns, fronts, hypervolume, expected utility."""

from morlnav.evaluation.evaluator import Evaluation
from morlnav.evaluation.front import describe_front, front_table, read_reference, reference_from_bounds
from morlnav.evaluation.labels import preference_label, read_preference_label
from morlnav.evaluation.pareto import expected_utility, hypervolume, pareto_mask, utility
from morlnav.evaluation.returns import discounted_returns, eval_env
from morlnav.evaluation.seeds import (
    aggregate_scores,
    compare_scores,
    holm,
    interquartile_mean,
    mean_interval,
    probability_of_improvement,
)

__all__ = [
    "Evaluation",
    "aggregate_scores",
    "compare_scores",
    "describe_front",
    "discounted_returns",
    "eval_env",
    "expected_utility",
    "front_table",
    "holm",
    "hypervolume",
    "interquartile_mean",
    "mean_interval",
    "pareto_mask",
    "preference_label",
    "probability_of_improvement",
    "read_preference_label",
    "read_reference",
    "reference_from_bounds",
    "utility",
]
