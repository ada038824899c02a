"""Statistics over seeds, against scipy's and values worked out by hand."""

import numpy as np
import pandas as pd
import pytest
import scipy

from morlnav.evaluation.seeds import (
    aggregate_scores,
    compare_scores,
    holm,
    interquartile_mean,
    mean_interval,
    probability_of_improvement,
    welch,
)
from morlnav.evaluation.seeds_plot import plot_curves, plot_scores

RNG = np.random.default_rng(0)


def table_of(**settings):
    """Scores ``[seeds, tasks]`` of settings as a tidy table."""
    rows = [
        ("success", name, f"{name} {seed}", task, value)
        for name, scores in settings.items()
        for seed, row in enumerate(scores)
        for task, value in enumerate(row)
    ]
    return pd.DataFrame(rows, columns=["score", "setting", "run", "task", "value"])


def test_the_interval_of_a_mean_is_students():
    values = RNG.normal(size=5)
    expected = scipy.stats.t.interval(0.95, 4, values.mean(), scipy.stats.sem(values))
    assert mean_interval([*values, np.nan]) == pytest.approx((values.mean(), *expected))
    assert mean_interval([3.0])[0] == 3.0
    assert np.isnan(mean_interval([3.0])[1:]).all()
    assert np.isnan(mean_interval([])).all()


def test_the_interquartile_mean_drops_a_quarter_on_either_side():
    assert interquartile_mean(np.array([[-90.0, 1.0, 2.0, 3.0], [4.0, 5.0, 6.0, 700.0]])) == pytest.approx(3.5)


def test_the_probability_of_improvement_is_mann_whitneys_u():
    first, second = RNG.integers(0, 4, (5, 3)).astype(float), RNG.integers(0, 4, (4, 3)).astype(float)
    u = [scipy.stats.mannwhitneyu(first[:, task], second[:, task]).statistic / 20 for task in range(3)]
    assert probability_of_improvement(first, second) == pytest.approx(np.mean(u))


def test_holm_as_worked_out_by_hand():
    assert holm([0.01, 0.04, np.nan, 0.03, 0.005]) == pytest.approx([0.03, 0.06, np.nan, 0.06, 0.02], nan_ok=True)
    assert holm([0.9, 0.8]).tolist() == [1.0, 1.0]


def test_welchs_test_is_scipys_and_knows_constant_samples():
    first, second = RNG.normal(size=4), RNG.normal(1, 2, size=7)
    assert welch(first, second) == pytest.approx(tuple(scipy.stats.ttest_ind(first, second, equal_var=False)))
    assert welch(np.ones(3), np.ones(2) + 1e-15) == (0.0, 1.0)
    assert np.isnan(welch(np.ones(1), np.ones(2))).all()


def test_whole_seeds_are_resampled():
    lucky_and_unlucky = np.repeat([[0.0], [1.0]], 40, axis=1)
    row = aggregate_scores(table_of(our=lucky_and_unlucky)).iloc[0]
    assert row[["iqm", "iqm_low", "iqm_high"]].tolist() == [0.5, 0.0, 1.0]  # 40 tasks are no 80 samples
    alone = aggregate_scores(table_of(our=lucky_and_unlucky[:1])).iloc[0]
    assert alone["seeds"] == 1
    assert alone[["iqm_low", "mean_high"]].isna().all()


def test_one_setting_is_set_beside_every_other():
    ours = np.array([[0.9, 0.8], [1.0, 0.9], [0.95, 0.85]])
    table = compare_scores(table_of(our=ours, same=ours, worse=ours - 0.5, alone=ours[:1]), "our").set_index("than")
    assert table["difference"].tolist() == pytest.approx([0, 0.5, 0.05], abs=1e-9)
    assert table["probability"].tolist() == pytest.approx([0.5, 1.0, 5 / 6])  # above it, above it, and a tie
    assert table["stars"].tolist() == ["ns", "***", ""]
    p = scipy.stats.ttest_ind(ours.mean(1), ours.mean(1) - 0.5, equal_var=False).pvalue
    assert table.loc["worse", "p_holm"] == pytest.approx(2 * p)
    assert len(compare_scores(table_of(our=ours), "our")) == 0


def test_the_figures_name_every_setting():
    table = table_of(our=RNG.random((3, 2)), no_human=RNG.random((2, 2)))
    axes = plot_scores(aggregate_scores(table)).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["our", "no_human"]
    logs = pd.DataFrame({"run": ["a", "b"] * 2, "metric": "success", "step": [1, 1, 2, 2], "value": RNG.random(4)})
    figure = plot_curves(logs, {"a": "our", "b": "no_human"}, {"success": "success"})
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["our", "no_human"]
