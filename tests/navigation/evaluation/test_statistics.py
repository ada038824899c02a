import numpy as np
import pandas as pd
import pytest
from scipy import stats

from morlnav.navigation.evaluation import compare_extremes, fidelity, overall, summarise


@pytest.fixture
def frame():
    """Five preferences, 20 scenes; more weight on distance raises the distance and the time."""
    rng = np.random.default_rng(0)
    rows = []
    for p, weight in enumerate(np.linspace(0, 1, 5)):
        for s in range(20):
            failed = s < p
            rows.append(
                {
                    "preference": p,
                    "scene": s,
                    "lambda_distance": weight,
                    "lambda_efficiency": 1 - weight,
                    "success": not failed,
                    "collision_human": failed and s == 0,
                    "collision_box": failed and s == 1,
                    "timeout": failed and s > 1,
                    "min_human_distance": 0.5 + weight + 0.1 * rng.standard_normal(),
                    "navigation_time": 99.0 if failed else 16 + 4 * weight + rng.standard_normal(),
                    "constant": 1.0,
                }
            )
    return pd.DataFrame(rows)


def test_rates_are_percentages_of_all_episodes(frame):
    summary = summarise(frame)
    assert summary["SR"].tolist() == [100, 95, 90, 85, 80]
    assert summary["CR_human"].tolist() == [0, 5, 5, 5, 5]
    assert summary["CR_box"].tolist() == [0, 0, 5, 5, 5]
    assert summary["CR"].tolist() == [0, 5, 10, 10, 10]
    assert summary["TR"].tolist() == [0, 0, 0, 5, 10]
    assert (summary["episodes"] == 20).all()


def test_times_count_successes_only(frame):
    last = frame[frame["preference"] == 4]
    row = summarise(frame).iloc[4]
    assert row["navigation_time"] == pytest.approx(last["navigation_time"][last["success"]].mean())
    assert row["min_human_distance"] == pytest.approx(last["min_human_distance"].mean())


def test_intervals_are_near_those_of_theory_and_repeat(frame):
    row = summarise(frame).iloc[0]
    values = frame[frame["preference"] == 0]["min_human_distance"]
    low, high = stats.norm.interval(0.95, values.mean(), stats.sem(values))
    assert row["min_human_distance_low"] == pytest.approx(low, abs=0.015)
    assert row["min_human_distance_high"] == pytest.approx(high, abs=0.015)
    assert summarise(frame).equals(summarise(frame))


def test_constants_and_empty_groups_have_honest_intervals(frame):
    frame.loc[frame["preference"] == 0, "success"] = False
    summary = summarise(frame)
    assert summary["constant_low"].tolist() == summary["constant_high"].tolist() == [1.0] * 5
    assert np.isnan(summary["navigation_time"][0])
    assert np.isnan(summary["navigation_time_low"][0])


def test_overall_is_one_row_without_a_preference(frame):
    row = overall(frame)
    assert len(row) == 1
    assert row["SR"].item() == 90
    assert row["episodes"].item() == 100
    assert not [name for name in row if name.startswith("lambda_") or name == "preference"]


@pytest.mark.parametrize(("metric", "scenes"), [("min_human_distance", 20), ("navigation_time", 16)])
def test_extremes_are_compared_in_the_scenes_that_count_for_both(frame, metric, scenes):
    tests = compare_extremes(frame.sample(frac=1, random_state=0), [metric])
    row = tests[(tests["first"] == "distance") & (tests["second"] == "efficiency")].iloc[0]
    values = [frame[(frame["preference"] == p) & (frame["scene"] >= 20 - scenes)][metric] for p in (4, 0)]
    expected = stats.ttest_rel(*values)
    assert row["t"] == pytest.approx(expected.statistic)
    assert row["p"] == pytest.approx(expected.pvalue)
    assert row["stars"] == "***"
    assert compare_extremes(frame, ["constant"])["stars"].tolist() == ["ns", "ns"]


def test_a_faithful_policy_scores_one(frame):
    table = fidelity(frame).set_index("objective")
    assert table.loc["distance", "spearman"] == pytest.approx(1)
    assert table.loc["efficiency", "spearman"] == pytest.approx(1)
    assert table.loc["efficiency", "mean"] < table.loc["efficiency", "mean_versus"]
    assert table.loc["distance", "versus"] == "efficiency"
    assert (table["edge_spearman"] == table["spearman"]).all()  # of two objectives there is one edge


def test_fidelity_along_an_edge_leaves_the_inner_preferences_out(frame):
    inner = frame.assign(lambda_demo=0.5, preference=frame["preference"] + 100, min_human_distance=-frame["preference"])
    inner[["lambda_distance", "lambda_efficiency"]] /= 2
    both = pd.concat([frame.assign(lambda_demo=0.0), inner], ignore_index=True)
    rows = fidelity(both, {"distance": ("min_human_distance", 1)}).set_index("versus")
    assert rows.loc["efficiency", "edge_spearman"] == pytest.approx(1)
    assert rows.loc["efficiency", "spearman"] < 0.9


def test_own_expectations_turn_the_sign(frame):
    table = fidelity(frame, {"distance": ("navigation_time", -1)})
    assert table["spearman"].item() == pytest.approx(-1)
    assert np.isnan(fidelity(frame, {"distance": ("constant", 1)})["spearman"].item())


def test_unknown_columns_are_explained(frame):
    with pytest.raises(ValueError, match="no column"):
        fidelity(frame, {"distance": ("comfort", 1)})
    with pytest.raises(ValueError, match="no column"):
        fidelity(frame, {"demo": ("constant", 1)})
    with pytest.raises(ValueError, match="sign"):
        fidelity(frame, {"distance": ("constant", 2)})
