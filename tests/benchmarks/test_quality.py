"""The time at which a run met the quality bar, read from the events that it logged."""

import math
import shutil
import time

import pandas as pd
import pytest
from omegaconf import OmegaConf

from benchmarks import quality
from morlnav.record.loggers import TensorboardCSVLogger


def test_a_run_that_learned_nothing_never_met_the_bar(smoke_run):
    assert quality.times_to_bar(smoke_run) == (math.inf, math.inf)


def test_the_bar_may_be_met_lost_and_met_for_good(smoke_run, tmp_path):
    shutil.copy(smoke_run / "config.yaml", tmp_path)
    demands = quality.bar(OmegaConf.load(smoke_run / "config.yaml"))
    assert set(demands) >= {
        "success",
        "min_human_distance/distance=1,efficiency=0",
        "time_ratio/distance=0,efficiency=1",
    }
    logger, begin = TensorboardCSVLogger("logs", tmp_path), time.time()
    ends = []
    for step, good in enumerate([False, True, False, True, True]):
        time.sleep(0.05)
        for tag, (low, high) in demands.items():
            within = low + 0.1 if math.isinf(high) else (low + high) / 2
            logger.log_scalar(f"evaluation/{tag}", within if good or tag != "success" else 0.98, step=step)
        ends.append(time.time() - begin)
    logger.experiment[1].experiment.flush()
    first, kept = quality.times_to_bar(tmp_path)
    assert ends[0] < first
    assert first == pytest.approx(ends[1], abs=0.04)
    assert kept == pytest.approx(ends[3], abs=0.04)


def test_a_missing_metric_meets_nothing():
    values = pd.DataFrame({"success": [1.0, 1.0], "timeout": [0.0, math.nan]})
    assert quality.meets(values, {"success": (0.99, 1), "timeout": (0, 0.005)}).tolist() == [True, False]


def test_a_run_without_events_is_reported_as_not_measured(smoke_run, tmp_path):
    shutil.copy(smoke_run / "config.yaml", tmp_path)
    (row,) = quality.measure([tmp_path])
    assert row.values == []
    assert "no TensorBoard events" in row.note


def test_a_run_that_logged_other_metrics_is_reported_as_not_measured(smoke_run, tmp_path):
    shutil.copy(smoke_run / "config.yaml", tmp_path)
    logger = TensorboardCSVLogger("logs", tmp_path)
    logger.log_scalar("evaluation/success", 1.0, step=0)
    logger.experiment[1].experiment.flush()
    (row,) = quality.measure([tmp_path])
    assert row.note.startswith("not measured: ")
    assert "logged no evaluation/" in row.note
