"""Statistics over seeds: how well a setting does, and whether it does better than another.

A seed is the unit of all of them: what one trained policy does in several scenes or under several preferences is not
independent, so seeds are resampled whole, those of every setting by themselves (a bootstrap stratified by setting).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
import scipy

RESAMPLES = 2000


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> tuple[float, float, float]:
    """Mean of a sample with its confidence interval by Student's t; numbers that are NaN do not count.

    Returns:
        Mean, lower and upper end; the ends of fewer than two numbers are NaN.

    Examples:
        >>> np.round(mean_interval([1.0, 2.0, 3.0]), 3).tolist()
        [2.0, -0.484, 4.484]
    """
    values = np.asarray(values, float)
    values = values[~np.isnan(values)]
    if len(values) < 2:
        return (*values, np.nan, np.nan, np.nan)[:3]
    half = scipy.stats.t.ppf((1 + confidence) / 2, len(values) - 1) * scipy.stats.sem(values)
    return values.mean(), values.mean() - half, values.mean() + half


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """Mean of the middle half of all scores ``[..., seeds, tasks]``, ``[...]``: neither luck nor a failure decides.

    >>> float(interquartile_mean(np.array([[0.0, 1.0, 2.0, 30.0]])))
    1.5
    """
    return scipy.stats.trim_mean(scores.reshape(*scores.shape[:-2], -1), 0.25, axis=-1)


def probability_of_improvement(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """How often a seed of the first scores above one of the second, ``[...]``; a tie is half of it.

    Args:
        first: scores ``[..., seeds, tasks]``.
        second: ``[..., other seeds, tasks]``; the result is the mean over tasks.

    Examples:
        >>> float(probability_of_improvement(np.array([[1.0], [3.0]]), np.array([[1.0], [2.0]])))
        0.625
    """
    difference = first[..., :, None, :] - second[..., None, :, :]
    return ((1 + np.sign(difference)) / 2).mean((-3, -2, -1))


def holm(p: Sequence[float]) -> np.ndarray:
    """p-values of several tests, corrected by Holm so that the chance of any false alarm stays what it was.

    >>> holm([0.01, 0.04, 0.03, float("nan")]).round(3).tolist()
    [0.03, 0.06, 0.06, nan]
    """
    p = np.asarray(p, float)
    order, corrected = np.argsort(p)[: (~np.isnan(p)).sum()], np.full(len(p), np.nan)
    factor = len(order) - np.arange(len(order))
    corrected[order] = np.maximum.accumulate(factor * p[order]).clip(max=1)
    return corrected


def welch(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Welch's t-test of two samples: t and p, NaN if one has fewer than two numbers.

    >>> welch(np.array([1.0, 1.0]), np.array([2.0, 2.0]))  # no variance: the test is exact
    (-inf, 0.0)
    """
    if min(len(first), len(second)) < 2:
        return np.nan, np.nan
    if np.allclose(first, first[0], atol=0) and np.allclose(second, second[0], atol=0):
        difference = first[0] - second[0]
        return (0.0, 1.0) if np.isclose(first[0], second[0]) else (float(np.copysign(np.inf, difference)), 0.0)
    moments = [moment for sample in (first, second) for moment in (sample.mean(), sample.std(ddof=1), len(sample))]
    return tuple(map(float, scipy.stats.ttest_ind_from_stats(*moments, equal_var=False)))


def paired(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Paired t-test of two samples ``[N]``: t and p, NaN if they have fewer than two numbers.

    >>> paired(np.array([1.0, 5.0]), np.array([2.0, 6.0]))  # no variance of the differences: the test is exact
    (-inf, 0.0)
    """
    difference = np.where(np.isclose(first, second), 0.0, first - second)  # without what rounding makes of equal ones
    return welch(difference, np.zeros_like(difference))


def stars(p: float) -> str:
    """How significant ``p`` is, in the paper's signs; empty where nothing was tested.

    >>> stars(0.0005), stars(0.2), stars(float("nan"))
    ('***', 'ns', '')
    """
    if np.isnan(p):
        return ""
    return next((sign for level, sign in ((0.001, "***"), (0.01, "**"), (0.05, "*")) if p <= level), "ns")


def aggregate_scores(table: pd.DataFrame) -> pd.DataFrame:
    """How every setting does, with 95 % intervals over its seeds.

    Args:
        table: a row per score, setting, run and task: columns ``score``, ``setting``, ``run``, ``task`` and ``value``.

    Returns:
        A row per score and setting, in their order: ``score``, ``setting``, ``seeds``, the ``mean`` with ``mean_low``
        and ``mean_high`` (:func:`mean_interval` of the seeds' means), and the :func:`interquartile_mean` ``iqm`` with
        ``iqm_low`` and ``iqm_high`` (percentile bootstrap over seeds). Ends are NaN for a single seed.

    Examples:
        >>> rows = [("success", "our", run, 0, value) for run, value in enumerate([0.8, 0.9, 1.0])]
        >>> table = aggregate_scores(pd.DataFrame(rows, columns=["score", "setting", "run", "task", "value"]))
        >>> table[["setting", "seeds", "iqm"]].values.tolist()
        [['our', 3, 0.9]]
    """
    rows = []
    for (score, setting), group in table.groupby(["score", "setting"], sort=False):
        scores = _matrix(group)
        names = ("mean", "mean_low", "mean_high", "iqm", "iqm_low", "iqm_high")
        numbers = (*mean_interval(scores.mean(1)), *_bootstrap(interquartile_mean, scores))
        rows.append(
            {"score": score, "setting": setting, "seeds": len(scores), **dict(zip(names, numbers, strict=True))}
        )
    return pd.DataFrame(rows)


def compare_scores(table: pd.DataFrame, reference: str) -> pd.DataFrame:
    """One setting beside every other one.

    Args:
        table: as for :func:`aggregate_scores`.
        reference: the setting.

    Returns:
        A row per score and other setting: ``score``, ``setting`` (the reference), ``than`` (the other), ``difference``
        of their means, :func:`probability_of_improvement` of the reference over the other ``probability`` with its
        bootstrap interval ``probability_low`` and ``probability_high``, ``p`` of Welch's t-test between the seeds'
        means, ``p_holm``: the same with :func:`holm`'s correction for all rows, and its ``stars``. What a single seed
        cannot tell is NaN.

    Examples:
        >>> rows = [("success", "ab"[run // 2], run, 0, value) for run, value in enumerate([0.9, 1.0, 0.1, 0.0])]
        >>> table = compare_scores(pd.DataFrame(rows, columns=["score", "setting", "run", "task", "value"]), "a")
        >>> table[["than", "difference", "probability", "stars"]].round(2).values.tolist()
        [['b', 0.9, 1.0, '**']]
    """
    rows = []
    for score, group in table.groupby("score", sort=False):
        settings = dict(list(group.groupby("setting", sort=False)))
        ours = settings.pop(reference, None)
        for name, other in settings.items() if ours is not None else ():
            shared = set(ours["task"]) & set(other["task"])
            first, second = (_matrix(part[part["task"].isin(shared)]) for part in (ours, other))
            if not shared:
                continue
            row = {"score": score, "setting": reference, "than": name, "difference": first.mean() - second.mean()}
            names = ("probability", "probability_low", "probability_high")
            row |= dict(zip(names, _bootstrap(probability_of_improvement, first, second), strict=True))
            rows.append(row | {"p": welch(first.mean(1), second.mean(1))[1]})
    columns = ["score", "setting", "than", "difference", "probability", "probability_low", "probability_high", "p"]
    table = pd.DataFrame(rows, columns=columns)
    table["p_holm"] = holm(table["p"])
    return table.assign(stars=table["p_holm"].map(stars))


def _matrix(group: pd.DataFrame) -> np.ndarray:
    """Scores ``[seeds, tasks]``."""
    return group.pivot(index="run", columns="task", values="value").to_numpy(float)


def _bootstrap(statistic: Callable[..., np.ndarray], *samples: np.ndarray) -> tuple[float, float, float]:
    """A statistic of scores ``[seeds, tasks]`` with its 95 % interval, from resampling the seeds of each sample."""
    value = float(statistic(*samples))
    if min(map(len, samples)) < 2:
        return value, np.nan, np.nan
    seeds = tuple(np.arange(len(sample)) for sample in samples)

    def resampled(*chosen: np.ndarray, axis: int) -> np.ndarray:
        return statistic(*(sample[index] for sample, index in zip(samples, chosen, strict=True)))

    settings = {"n_resamples": RESAMPLES, "method": "percentile", "rng": np.random.default_rng(0)}
    interval = scipy.stats.bootstrap(seeds, resampled, vectorized=True, **settings).confidence_interval
    return value, float(interval.low), float(interval.high)
