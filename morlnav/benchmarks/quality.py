"""When a run met the quality bar, from the evaluations that it logged on the way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from omegaconf import DictConfig
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from morlnav.benchmarks.timing import Row
from morlnav.deployment.policy import load_config
from morlnav.evaluation import preference_label
from morlnav.trainers.builders import make_base_env

TITLE = "From an empty directory to the quality bar"
NOTES = """Seconds from the start of `morlnav-train` until an evaluation on the way met every demand, and until the
first from which on all did: success of at least 99 %, at most 0.5 % collisions and 0.5 % timeouts over all
preferences; at λ = distance a least distance to the human of at least 1.18 m; at λ = efficiency a time within 4 % of
the shortest path's; at λ = demo a Fréchet distance of at most 0.41 m with the human on the right in at least 95 %.
Demands on a style count where the run has that objective."""


def measure(runs: Sequence[Path]) -> list[Row]:
    """Two rows per run directory."""
    rows = []
    for directory in runs:
        try:
            first, kept = times_to_bar(directory)
        except FileNotFoundError as error:
            rows.append(Row("quality", str(directory), "met", "s", note=f"not measured: {error}"))
            continue
        for name, seconds in (("met", first), ("kept", kept)):
            values = [seconds] if math.isfinite(seconds) else []
            rows.append(Row("quality", str(directory), name, "s", values, "" if values else f"never {name}"))
    return rows


def times_to_bar(directory: str | Path) -> tuple[float, float]:
    """Seconds until the bar was first met, and until it was met for good; infinite where it never was.

    They count from the moment the run opened its logs, before it recorded its demonstrations, to the end of the
    evaluation. Of a resumed run, the pause counts too.

    Args:
        directory: a run directory with TensorBoard's events, which hold the times.

    Raises:
        FileNotFoundError: without events or evaluations.
    """
    directory = Path(directory)
    cfg = load_config(directory)
    if not list((directory / "logs").glob("events.*")):
        raise FileNotFoundError(f"{directory} has no TensorBoard events, which tell the times.")
    events = EventAccumulator(str(directory / "logs"), size_guidance={"scalars": 0}).Reload()
    demands = bar(cfg)
    missing = [tag for tag in demands if f"evaluation/{tag}" not in events.Tags()["scalars"]]
    if missing:
        raise FileNotFoundError(f"{directory} logged no evaluation/{missing[0]} while training.")
    tags = {tag: events.Scalars(f"evaluation/{tag}") for tag in demands}
    values = pd.DataFrame({tag: {event.step: event.value for event in scalars} for tag, scalars in tags.items()})
    last = max(tags, key=lambda tag: tags[tag][-1].wall_time)  # the metric that is written last
    seconds = pd.Series({event.step: event.wall_time - events.FirstEventTimestamp() for event in tags[last]})
    return first_and_lasting(meets(values, demands), seconds)


def bar(cfg: DictConfig) -> dict[str, tuple[float, float]]:
    """Lowest and highest allowed value of every logged metric that the bar is about."""
    env = make_base_env(cfg, num_envs=1)
    corners = {
        name: preference_label(env.objectives, [float(name == other) for other in env.objectives])
        for name in env.objectives
    }
    demands = {"success": (0.99, 1), "collision_human": (0, 0.005), "collision_box": (0, 0.005), "timeout": (0, 0.005)}
    if "distance" in corners:
        demands[f"min_human_distance/{corners['distance']}"] = (1.18, math.inf)
    if "efficiency" in corners:
        demands[f"time_ratio/{corners['efficiency']}"] = (0, 1.04)
    if "demo" in corners:
        demands[f"frechet/{corners['demo']}"] = (0, 0.41)
        demands[f"human_on_right/{corners['demo']}"] = (0.95, 1)
    return demands


def meets(values: pd.DataFrame, demands: dict[str, tuple[float, float]]) -> pd.Series:
    """Which evaluations, one per row, keep every metric within its bounds; a metric that is missing meets nothing."""
    return pd.concat([values[tag].between(low, high) for tag, (low, high) in demands.items()], axis=1).all(axis=1)


def first_and_lasting(met: pd.Series, seconds: pd.Series) -> tuple[float, float]:
    """The seconds of the first true entry, and of the first from which on all are true; ``inf`` where there is none.

    >>> first_and_lasting(pd.Series([False, True, False, True]), pd.Series([1.0, 2.0, 3.0, 4.0]))
    (2.0, 4.0)
    """
    lasting = met[::-1].cummin()[::-1]
    first, kept = (float(seconds[flags].min()) if flags.any() else math.inf for flags in (met, lasting))
    return first, kept
