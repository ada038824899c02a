"""Roll-outs over all preferences, social metrics, preference fidelity, the report."""

from morlnav.navigation.evaluation.evaluator import NavigationEvaluation, reward_terms
from morlnav.navigation.evaluation.metrics import episode_metrics, frechet_distance
from morlnav.navigation.evaluation.paths import shortest_path, shortest_polylines
from morlnav.navigation.evaluation.planner import PathPlanner, PlannedPath
from morlnav.navigation.evaluation.possible import ExactFront, best_utility, exact_front, possible_table
from morlnav.navigation.evaluation.references import reference_paths
from morlnav.navigation.evaluation.report import write_report
from morlnav.navigation.evaluation.rollout import Outcome, Rollouts, evaluate_policy, evaluation_scenes
from morlnav.navigation.evaluation.statistics import compare_extremes, fidelity, overall, summarise

__all__ = [
    "ExactFront",
    "NavigationEvaluation",
    "Outcome",
    "PathPlanner",
    "PlannedPath",
    "Rollouts",
    "best_utility",
    "compare_extremes",
    "episode_metrics",
    "evaluate_policy",
    "evaluation_scenes",
    "exact_front",
    "fidelity",
    "frechet_distance",
    "overall",
    "possible_table",
    "reference_paths",
    "reward_terms",
    "shortest_path",
    "shortest_polylines",
    "summarise",
    "write_report",
]
