"""Statistics over episodes: rates and means per preference, differences between extremes, preference fidelity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np
import pandas as pd
import scipy

from morlnav.evaluation.seeds import paired, stars

FIDELITY = {"distance": ("min_human_distance", 1), "efficiency": ("navigation_time", -1), "demo": ("frechet", -1)}
"""The metric that each objective should move, and which way."""

RATES = {
    "SR": ["success"],
    "CR": ["collision_human", "collision_box"],
    "CR_human": ["collision_human"],
    "CR_box": ["collision_box"],
    "TR": ["timeout"],
}
ONLY_SUCCESS = ("navigation_time", "path_length", "time_ratio", "shortest_path")
INDEX = ("preference", "scene")


def tuneable_objectives(frame: pd.DataFrame) -> list[str]:
    """Names of the objectives that the preference columns ``lambda_<name>`` weigh, in order.

    >>> tuneable_objectives(pd.DataFrame(columns=["scene", "lambda_distance", "lambda_efficiency", "success"]))
    ['distance', 'efficiency']
    """
    return [name.removeprefix("lambda_") for name in frame.columns if name.startswith("lambda_")]


def metric_columns(frame: pd.DataFrame) -> list[str]:
    """Columns of an episode frame that are averaged: neither indices, nor preferences, nor outcomes.

    >>> metric_columns(pd.DataFrame(columns=["scene", "lambda_distance", "success", "navigation_time"]))
    ['navigation_time']
    """
    outcomes = [name for names in RATES.values() for name in names]
    return [name for name in frame.columns if name not in (*INDEX, *outcomes) and not name.startswith("lambda_")]


def summarise(frame: pd.DataFrame, confidence: float = 0.95, resamples: int = 1000, seed: int = 0) -> pd.DataFrame:
    """One row per preference: rates in percent as in Table I, and means with bootstrap intervals.

    Times, lengths and their ratio are means over the successful episodes alone, as a collision would make them short
    and a timeout long; all other metrics are means over all episodes.

    Args:
        frame: from :func:`~morlnav.navigation.evaluation.episode_metrics`.
        confidence: of the intervals.
        resamples: of the percentile bootstrap.
        seed: of the bootstrap.

    Returns:
        Columns ``preference``, ``lambda_<name>``, ``episodes``, ``SR``, ``CR``, ``CR_human``, ``CR_box``, ``TR`` (%),
        then ``<metric>``, ``<metric>_low`` and ``<metric>_high``. A mean over no episode, and an interval from fewer
        than two, is NaN.

    Examples:
        >>> frame = pd.DataFrame({"preference": [0, 0], "lambda_distance": [1.0, 1.0], "success": [True, True],
        ...     "collision_human": False, "collision_box": False, "timeout": False, "navigation_time": [16.0, 18.0]})
        >>> summarise(frame)[["SR", "navigation_time", "navigation_time_low"]].values.tolist()
        [[100.0, 17.0, 16.0]]
    """
    groups = frame.groupby("preference", sort=True)
    rng = np.random.default_rng(seed)
    return pd.DataFrame([_summary_row(group, confidence, resamples, rng) for _, group in groups])


def overall(frame: pd.DataFrame, confidence: float = 0.95, resamples: int = 1000, seed: int = 0) -> pd.DataFrame:
    """The same columns as :func:`summarise` in a single row over all preferences, without the preference.

    Examples:
        >>> frame = pd.DataFrame({"preference": [0, 1], "lambda_distance": [1.0, 0.0], "success": [True, False],
        ...     "collision_human": [False, True], "collision_box": False, "timeout": False,
        ...     "navigation_time": [16.0, 5.0]})
        >>> overall(frame)[["SR", "CR", "navigation_time"]].values.tolist()
        [[50.0, 50.0, 16.0]]
    """
    rng = np.random.default_rng(seed)
    row = pd.DataFrame([_summary_row(frame, confidence, resamples, rng)])
    return row.drop(columns=["preference", *(f"lambda_{name}" for name in tuneable_objectives(frame))])


def _summary_row(group: pd.DataFrame, confidence: float, resamples: int, rng: np.random.Generator) -> dict[str, float]:
    row = {name: group[name].iloc[0] for name in group if name == "preference" or name.startswith("lambda_")}
    row["episodes"] = len(group)
    row |= {rate: 100 * group[names].to_numpy(float).sum() / len(group) for rate, names in RATES.items()}
    for name in metric_columns(group):
        values = metric_values(group, name)
        row[name] = values.mean() if len(values) else np.nan
        row[f"{name}_low"], row[f"{name}_high"] = bootstrap_interval(values, rng, confidence, resamples)
    return row


def metric_values(frame: pd.DataFrame, metric: str) -> np.ndarray:
    """The finite values of a metric, over successful episodes where :func:`summarise` counts only these.

    >>> metric_values(pd.DataFrame({"success": [True, False], "navigation_time": [16.0, 5.0]}), "navigation_time")
    array([16.])
    """
    return _counting(frame, metric)[metric].to_numpy(float)


def _counting(frame: pd.DataFrame, metric: str) -> pd.DataFrame:
    chosen = frame[frame["success"].astype(bool)] if metric in ONLY_SUCCESS else frame
    return chosen[np.isfinite(chosen[metric].to_numpy(float))]


def bootstrap_interval(
    values: np.ndarray, rng: np.random.Generator, confidence: float = 0.95, resamples: int = 1000
) -> tuple[float, float]:
    """Ends of the bootstrap interval of a mean ``[N]``; NaN for less than two values."""
    if len(values) < 2:
        return np.nan, np.nan
    # Percentile rather than BCa, which is undefined for constant values.
    result = scipy.stats.bootstrap(
        (values,), np.mean, n_resamples=resamples, confidence_level=confidence, method="percentile", rng=rng
    )
    return tuple(result.confidence_interval)


def compare_extremes(frame: pd.DataFrame, metrics: Sequence[str]) -> pd.DataFrame:
    """t-tests of each metric between each two extreme preferences (Sec. IV-C, Fig. 4), paired by scene.

    The extreme preference of an objective is the evaluated one with its largest weight. Both drive the same scenes, so
    that what differs is their difference in each; how long a way a scene needs would hide it.

    Args:
        frame: from :func:`~morlnav.navigation.evaluation.episode_metrics`.
        metrics: its columns.

    Returns:
        Columns ``metric``, ``first`` and ``second`` (objectives), ``mean_first``, ``mean_second``, ``t``, ``p`` and
        ``stars``: ``***`` for p ≤ 0.001, ``**`` ≤ 0.01, ``*`` ≤ 0.05, else ``ns``; empty where fewer than two scenes
        allow no test. Means are over the scenes that count for both. Both orders of a pair are listed.

    Raises:
        ValueError: if a metric is not a column.

    Examples:
        >>> frame = pd.DataFrame({"scene": [0, 1, 0, 1], "lambda_distance": [1.0, 1.0, 0.0, 0.0],
        ...     "lambda_efficiency": [0.0, 0.0, 1.0, 1.0], "success": True, "min_human_distance": [1.5, 1.7, 0.6, 0.7]})
        >>> compare_extremes(frame, ["min_human_distance"])[["first", "second", "stars"]].values.tolist()
        [['distance', 'efficiency', '*'], ['efficiency', 'distance', '*']]
    """
    _check_columns(frame, metrics)
    names = tuneable_objectives(frame)
    extremes = {name: frame[np.isclose(frame[f"lambda_{name}"], frame[f"lambda_{name}"].max())] for name in names}
    rows = []
    for metric in metrics:
        values = {
            name: _counting(extreme, metric).groupby("scene")[metric].mean() for name, extreme in extremes.items()
        }
        for first, second in permutations(names, 2):
            both = pd.concat([values[first], values[second]], axis=1, join="inner").to_numpy(float)
            t, p = paired(*both.T)
            means = both.mean(0) if len(both) else (np.nan, np.nan)
            rows.append((metric, first, second, *means, t, p, stars(p)))
    return pd.DataFrame(rows, columns=["metric", "first", "second", "mean_first", "mean_second", "t", "p", "stars"])


def fidelity(frame: pd.DataFrame, expected: Mapping[str, tuple[str, int]] | None = None) -> pd.DataFrame:
    """Preference fidelity: does weighing an objective more move the metric that it should?

    Args:
        frame: from :func:`~morlnav.navigation.evaluation.episode_metrics`.
        expected: objective name to ``(column, sign)``; sign 1 where more weight should raise the metric, -1 where it
            should lower it. ``FIDELITY`` by default, and the Fréchet distance to its demonstration for any other
            objective, as far as the frame has the columns.

    Returns:
        One row per objective and other objective, with columns ``objective``, ``metric``, ``sign``, ``spearman``:
        rank correlation of λᵢ with the metric's mean per preference, times the sign (1 is perfect, NaN if a side is
        constant), ``versus``, ``edge_spearman``: the same over the preferences that weigh these two objectives alone,
        and the comparison of the two extreme preferences: ``mean``, ``mean_versus``, ``t``,
        ``p``, ``stars`` (see :func:`compare_extremes`).

    Raises:
        ValueError: if ``expected`` names an objective or column that the frame lacks, or a sign is not ±1.

    Examples:
        >>> frame = pd.DataFrame({"preference": [0, 0, 1, 1], "scene": [0, 1, 0, 1], "success": True,
        ...     "lambda_distance": [1.0, 1.0, 0.0, 0.0], "lambda_efficiency": [0.0, 0.0, 1.0, 1.0],
        ...     "min_human_distance": [1.5, 1.7, 0.6, 0.7]})
        >>> fidelity(frame)[["objective", "metric", "spearman"]].round(3).values.tolist()
        [['distance', 'min_human_distance', 1.0]]
    """
    names = tuneable_objectives(frame)
    if expected is None:
        expected = {name: FIDELITY.get(name, (f"frechet_{name}", -1)) for name in names}
        expected = {name: metric for name, metric in expected.items() if metric[0] in frame}
    _check_columns(frame, [f"lambda_{name}" for name in expected] + [metric for metric, _ in expected.values()])
    rows = []
    for name, (metric, sign) in expected.items():
        if sign not in (1, -1):
            raise ValueError(f"The sign of objective '{name}' must be 1 or -1, got {sign}.")
        tests = compare_extremes(frame, [metric]).query("first == @name")
        tests = tests.rename(columns={"second": "versus", "mean_first": "mean", "mean_second": "mean_versus"})
        along = [sign * _rank(frame[on_edge(frame, (name, other))], name, metric) for other in tests["versus"]]
        facts = {"objective": name, "sign": sign, "spearman": sign * _rank(frame, name, metric), "edge_spearman": along}
        rows.append(tests.drop(columns="first").assign(**facts))
    order = ["objective", "metric", "sign", "spearman", "versus", "edge_spearman"]
    order += ["mean", "mean_versus", "t", "p", "stars"]
    return pd.concat(rows, ignore_index=True)[order] if rows else pd.DataFrame(columns=order)


def _rank(frame: pd.DataFrame, objective: str, metric: str) -> float:
    """Rank correlation of an objective's weight with the metric's mean per preference."""
    groups = [(g[f"lambda_{objective}"].iloc[0], metric_values(g, metric)) for _, g in frame.groupby("preference")]
    weight, mean = np.array([(w, values.mean()) for w, values in groups if len(values)]).reshape(-1, 2).T
    varied = len(mean) > 1 and np.ptp(weight) > 0 and np.ptp(mean) > 0
    return scipy.stats.spearmanr(weight, mean).statistic if varied else np.nan


def on_edge(frame: pd.DataFrame, objectives: Sequence[str]) -> pd.Series:
    """Which rows weigh these objectives alone, ``bool``.

    >>> on_edge(pd.DataFrame({"lambda_demo": [0.0, 0.1], "lambda_distance": [1.0, 0.9]}), ["distance"]).tolist()
    [True, False]
    """
    others = [f"lambda_{name}" for name in tuneable_objectives(frame) if name not in objectives]
    return (frame[others] < 1e-6).all(axis=1)


def _check_columns(frame: pd.DataFrame, columns: Sequence[str]) -> None:
    missing = [name for name in columns if name not in frame]
    if missing:
        raise ValueError(f"The episodes have no column {missing}; they have {list(frame.columns)}.")
