"""Evaluation: roll-outs over all preferences, social metrics, preference fidelity and the quality of the front."""

from morlnav.evaluation.alternatives import Behaviour, PathFollower, alternative_behaviours, paths_around
from morlnav.evaluation.audit import Audit, Thresholds, audit_reward
from morlnav.evaluation.audit_report import write_audit
from morlnav.evaluation.front import describe_front, front_table, read_reference, reference_from_bounds
from morlnav.evaluation.labels import preference_label, read_preference_label
from morlnav.evaluation.metrics import episode_metrics, frechet_distance
from morlnav.evaluation.pareto import expected_utility, hypervolume, pareto_mask, utility
from morlnav.evaluation.paths import shortest_path, shortest_polylines
from morlnav.evaluation.planner import PathPlanner, PlannedPath
from morlnav.evaluation.references import reference_paths
from morlnav.evaluation.report import markdown_table, write_report
from morlnav.evaluation.rollout import Outcome, Rollouts, evaluate_policy, evaluation_scenes
from morlnav.evaluation.statistics import compare_extremes, fidelity, overall, summarise

__all__ = [
    "Audit",
    "Behaviour",
    "Outcome",
    "PathFollower",
    "PathPlanner",
    "PlannedPath",
    "Rollouts",
    "Thresholds",
    "alternative_behaviours",
    "audit_reward",
    "compare_extremes",
    "describe_front",
    "episode_metrics",
    "evaluate_policy",
    "evaluation_scenes",
    "expected_utility",
    "fidelity",
    "frechet_distance",
    "front_table",
    "hypervolume",
    "markdown_table",
    "overall",
    "pareto_mask",
    "paths_around",
    "preference_label",
    "read_preference_label",
    "read_reference",
    "reference_from_bounds",
    "reference_paths",
    "shortest_path",
    "shortest_polylines",
    "summarise",
    "utility",
    "write_audit",
    "write_report",
]
