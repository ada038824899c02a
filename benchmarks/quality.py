"""When a run met the quality bar, from the evaluations that it logged on the way."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from benchmarks.timing import Row
from morlnav.evaluation.labels import preference_label, read_preference_label

TITLE = "From an empty directory to the quality bar"
NOTES = """Seconds from the start of `morlnav-train` until an evaluation on the way met every demand, and until the
first from which on all did: success of at least 99 %, at most 0.5 % collisions and 0.5 % timeouts over all
preferences; at λ = distance a least distance to the human of at least 1.18 m; at λ = efficiency a time within 4 % of
the shortest path's; at λ = demo a Fréchet distance of at most 0.41 m with the human on the right in at least 95 %.
Demands on a style count where the run has that objective."""

ALWAYS = {"success": (0.99, 1), "collision_human": (0, 0.005), "collision_box": (0, 0.005), "timeout": (0, 0.005)}
STYLES = {
    "distance": {"min_human_distance": (1.18, math.inf)},
    "efficiency": {"time_ratio": (0, 1.04)},
    "demo": {"frechet": (0, 0.41), "human_on_right": (0.95, 1)},
}
"""Lowest and highest allowed values: of all preferences together, and of the one that asks for a style alone."""


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
    logs = Path(directory) / "logs"
    if not list(logs.glob("events.*")):
        raise FileNotFoundError(f"{directory} has no TensorBoard events, which tell the times.")
    events = EventAccumulator(str(logs), size_guidance={"scalars": 0}).Reload()
    tags = events.Tags()["scalars"]
    demands = bar(tags)
    missing = [tag for tag in demands if tag not in tags]
    if missing:
        raise FileNotFoundError(f"{directory} logged no {missing[0]} while training.")
    scalars = {tag: events.Scalars(tag) for tag in demands}
    values = pd.DataFrame({tag: {event.step: event.value for event in found} for tag, found in scalars.items()})
    last = max(scalars, key=lambda tag: scalars[tag][-1].wall_time)  # the metric that is written last
    seconds = pd.Series({event.step: event.wall_time - events.FirstEventTimestamp() for event in scalars[last]})
    return first_and_lasting(meets(values, demands), seconds)


def bar(tags: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Lowest and highest allowed value of every logged metric that the bar is about.

    Args:
        tags: of all logged metrics, whose labels tell what the objectives are.

    Examples:
        >>> list(bar(["evaluation/success/calm=0,distance=1"]))[-1]
        'evaluation/min_human_distance/calm=0,distance=1'
    """
    objectives = next(filter(None, map(read_preference_label, tags)), {})
    demands = {f"evaluation/{metric}": bounds for metric, bounds in ALWAYS.items()}
    for name in objectives:
        label = preference_label(objectives, [float(name == other) for other in objectives])
        demands |= {f"evaluation/{metric}/{label}": bounds for metric, bounds in STYLES.get(name, {}).items()}
    return demands


def meets(values: pd.DataFrame, demands: Mapping[str, tuple[float, float]]) -> pd.Series:
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
