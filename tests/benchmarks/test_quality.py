"""The time at which a run met the quality bar, read from the events that it logged."""

import math
import time

import pandas as pd
import pytest

from benchmarks import quality
from morlnav.record.loggers import TensorboardCSVLogger


def test_a_run_that_learned_nothing_never_met_the_bar(smoke_run):
    assert quality.times_to_bar(smoke_run) == (math.inf, math.inf)


def test_the_bar_may_be_met_lost_and_met_for_good(tmp_path):
    demands = quality.bar(["train/success", "evaluation/success/distance=0.5,efficiency=0.5"])
    assert set(demands) >= {
        "evaluation/success",
        "evaluation/min_human_distance/distance=1,efficiency=0",
        "evaluation/time_ratio/distance=0,efficiency=1",
    }
    logger, begin = TensorboardCSVLogger("logs", tmp_path), time.time()
    ends = []
    for step, good in enumerate([False, True, False, True, True]):
        time.sleep(0.05)
        for tag, (low, high) in demands.items():
            within = low + 0.1 if math.isinf(high) else (low + high) / 2
            logger.log_scalar(tag, within if good or tag != "evaluation/success" else 0.98, step=step)
        ends.append(time.time() - begin)
    logger.experiment[1].experiment.flush()
    first, kept = quality.times_to_bar(tmp_path)
    assert ends[0] < first
    assert first == pytest.approx(ends[1], abs=0.04)
    assert kept == pytest.approx(ends[3], abs=0.04)


def test_every_style_of_the_run_has_its_demands():
    demands = quality.bar(["evaluation/frechet/demo=1,distance=0,efficiency=0"])
    assert demands["evaluation/frechet/demo=1,distance=0,efficiency=0"] == (0, 0.41)
    assert len(demands) == 8


def test_a_missing_metric_meets_nothing():
    values = pd.DataFrame({"success": [1.0, 1.0], "timeout": [0.0, math.nan]})
    assert quality.meets(values, {"success": (0.99, 1), "timeout": (0, 0.005)}).tolist() == [True, False]


def test_a_run_without_events_is_reported_as_not_measured(tmp_path):
    (row,) = quality.measure([tmp_path])
    assert row.values == []
    assert "no TensorBoard events" in row.note


def test_a_run_that_logged_other_metrics_is_reported_as_not_measured(tmp_path):
    logger = TensorboardCSVLogger("logs", tmp_path)
    logger.log_scalar("evaluation/success", 1.0, step=0)
    logger.experiment[1].experiment.flush()
    (row,) = quality.measure([tmp_path])
    assert row.note.startswith("not measured: ")
    assert "logged no evaluation/" in row.note
