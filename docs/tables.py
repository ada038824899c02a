"""Writes the tables of README.md and of pages in docs anew, from what runs left: ``python docs/tables.py``."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pandas as pd

from morlnav.commands.report import READABLE
from morlnav.navigation.evaluation import (
    ExactFront,
    evaluation_scenes,
    exact_front,
    fidelity,
    possible_table,
    summarise,
)
from morlnav.navigation.evaluation.metrics import frechet_column
from morlnav.record.markdown import markdown_table

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "results"
STYLES = ("demo", "distance", "efficiency")


def styles() -> str:
    """The default run: a row for each preference with all weight on one style, and one for all preferences."""
    episodes = _read(RESULTS / "default", "episodes")
    rows = {name: episodes[episodes[f"lambda_{name}"] == 1] for name in STYLES}
    rows[f"all {episodes['preference'].nunique()}"] = episodes
    head = ["λ", "success", "collision", "time", "than shortest path", "distance to human", "off demonstration"]
    return _table(head, ([name, *_outcome(part, "collision"), *_driving(part)] for name, part in rows.items()))


def three_styles() -> str:
    """A row for each seed of the default recipe."""
    return _by_run("seed", {"0": RESULTS / "default"} | _seeds("three_styles"))


def worlds() -> str:
    """The default run, driven in the world that it was trained in and in the reference engine."""
    return _by_run("world", {"tensor": RESULTS / "default", "pymunk": RESULTS / "pymunk"})


def no_refinement() -> str:
    """The same seeds before their refinement."""
    return _by_run("seed", _seeds("no_refinement"))


def two_styles() -> str:
    """A row for each seed of ``recipe=analytical``."""
    head = ["seed", "distance to human", "than shortest path", "all: success", "collision", "timeout"]
    head += [*(f"ρ {name}" for name in STYLES[1:]), "of the front", "excess"]
    return _table(head, ([seed, *_seed_row(path)] for seed, path in _seeds("two_styles").items()))


def five_styles() -> str:
    """A row for each of five styles with all weight, and the distance to each demonstration there."""
    summary = _read(RESULTS / "five_objectives" / "seed_0", "summary")
    names = [name.removeprefix("lambda_") for name in summary if name.startswith("lambda_")]
    shown = [name for name in names if frechet_column(name) in summary]
    rows = []
    for name in names:
        row = summary[summary[f"lambda_{name}"] == 1].iloc[0]
        metres = [f"{row[frechet_column(other)]:.2f} m" for other in shown]
        metres = [f"**{text}**" if other == name else text for other, text in zip(shown, metres, strict=True)]
        rows.append([name, f"{row['SR']:.0f} %", *metres, f"{row['min_human_distance']:.2f} m"])
        rows[-1].append(f"+{100 * (row['time_ratio'] - 1):.0f} %")
    head = ["λ", "success", *(f"off {name}" for name in shown), "distance to human", "than shortest path"]
    return _table(head, rows)


def leave_one_out() -> str:
    """A row for each part that short runs left out, with a value for each seed, and one for the whole recipe."""
    return _short_runs("left out", _named("leave_one_out"))


def choices() -> str:
    """A row for each choice of the paper's in which the recipe differs, alone in short runs of the recipe."""
    kept = _named("leave_one_out")
    plain = ("products=float32", "replay.transforms.relabel.share=0.75", "loss.loss_function=smooth_l1")
    before, after = (
        {name: kept[name] for name in names} for names in (plain, ("nothing", "no_angle", "no_interpolator"))
    )
    return _short_runs("the paper's choice", before | _named("choices") | after)


def table_one() -> str:
    """The paper's Table I, as the report has it."""
    table = READABLE["table1"](pd.read_csv(RESULTS / "paper" / "table1.csv"))
    return _table(list(table), table.to_numpy().tolist())


TABLES = {
    "README.md": (styles, table_one),
    "docs/results.md": (styles, three_styles, worlds, no_refinement, two_styles),
    "docs/recipe.md": (leave_one_out,),
    "docs/paper.md": (choices,),
    "docs/demonstrations.md": (five_styles,),
}


def renewed(page: str) -> str:
    """The text of a page with its tables as they should be; each stands between comments with its name."""
    text = (ROOT / page).read_text()
    for table in TABLES[page]:
        name = table.__name__
        found = f"(<!-- {name} -->\n).*?(<!-- end -->)"
        text, places = re.subn(found, rf"\1\n{table()}\n\n\2", text, flags=re.DOTALL)
        if places != 1:
            raise ValueError(f"{page} has {places} places for the table {name}.")
    return text


def _by_run(label: str, runs: dict[str, Path]) -> str:
    head = [label, "off demonstration", "human on right", "distance to human", "than shortest path"]
    head += ["all: success", "collision", "timeout", *(f"ρ {name}" for name in STYLES), "of the front", "excess"]
    return _table(head, ([name, *_seed_row(path)] for name, path in runs.items()))


def _named(folder: str) -> dict[str, dict[str, Path]]:
    """Short runs by what they tried, and by seed."""
    runs: dict[str, dict[str, Path]] = {"nothing": {}}
    for path in sorted((RESULTS / folder).iterdir()):
        name, seed = path.name.rsplit("_", 1)
        runs.setdefault("nothing" if name == "our" else name, {})[seed] = path
    return {name: seeds for name, seeds in runs.items() if seeds}


def _short_runs(label: str, runs: dict[str, dict[str, Path]]) -> str:
    head = [label, "seeds", "of the front", "excess", "distance to human", "than shortest path"]
    head += ["off demonstration", "where free", "success"]
    return _table(head, ([f"`{name}`", ", ".join(seeds), *_short_row(seeds.values())] for name, seeds in runs.items()))


def _seed_row(run: Path) -> list[str]:
    episodes = _read(run, "episodes")
    at = {name: episodes[episodes[f"lambda_{name}"] == 1] for name in STYLES if f"lambda_{name}" in episodes}
    row = []
    if "demo" in at:
        row = [f"{at['demo']['frechet'].mean():.2f} m", _percent(at["demo"]["human_on_right"], "{:.0f}")]
    row.append(f"{at['distance']['min_human_distance'].mean():.2f} m")
    row.append(_percent(_times(at["efficiency"])["time_ratio"] - 1, "+{:.1f}"))
    ranks = fidelity(episodes).groupby("objective")["edge_spearman"].min()
    possible = possible_table(_front(), summarise(episodes, resamples=2)).iloc[0]
    reached = f"{100 * possible['front_share']:.0f} %", f"+{100 * possible['mean_excess']:.1f} %"
    return [*row, *_outcome(episodes, "collision", "timeout"), *(f"{ranks[name]:.2f}" for name in at), *reached]


def _short_row(runs: Iterable[Path]) -> list[str]:
    rows = []
    for run in runs:
        summary, possible = _read(run, "summary"), _read(run, "possible").iloc[0]
        demo, distance, efficiency = (summary[summary[f"lambda_{name}"] == 1].iloc[0] for name in STYLES)
        shares = possible["front_share"], possible["mean_excess"], efficiency["time_ratio"] - 1
        share, excess, longer = (f"{100 * value:.1f} %" for value in shares)
        metres = (f"{value:.2f} m" for value in (demo["frechet"], demo["frechet_free"]))
        success = f"{summary['SR'].mean():.1f} %"
        rows.append([share, excess, f"{distance['min_human_distance']:.2f} m", longer, *metres, success])
    return [" / ".join(values) for values in zip(*rows, strict=True)]


@cache
def _front() -> ExactFront:
    """Of the scenes that every kept run was evaluated in."""
    return exact_front(evaluation_scenes(100, seed=12345))


def _outcome(episodes: pd.DataFrame, *others: str) -> list[str]:
    rates = {"collision": episodes["collision_human"] | episodes["collision_box"], "timeout": episodes["timeout"]}
    return [_percent(rate) for rate in (episodes["success"], *(rates[name] for name in others))]


def _driving(episodes: pd.DataFrame) -> list[str]:
    times = _times(episodes)
    longer = _percent(times["time_ratio"] - 1, "+{:.0f}")
    distances = episodes[["min_human_distance", "frechet"]].mean()
    return [f"{times['navigation_time'].mean():.1f} s", longer, *(f"{distance:.2f} m" for distance in distances)]


def _times(episodes: pd.DataFrame) -> pd.DataFrame:
    """Times count successes only."""
    return episodes[episodes["success"]]


def _percent(share: pd.Series, form: str = "{:.1f}") -> str:
    return f"{form.format(100 * share.mean())} %"


def _read(run: Path, name: str) -> pd.DataFrame:
    return pd.read_csv(run / "evaluation" / f"{name}.csv")


def _seeds(folder: str) -> dict[str, Path]:
    return {path.name.removeprefix("seed_"): path for path in sorted((RESULTS / folder).iterdir())}


def _table(head: list[str], rows: Iterable[list[str]]) -> str:
    return markdown_table(head, rows, (":--", "--:"))


if __name__ == "__main__":
    for page in TABLES:
        (ROOT / page).write_text(renewed(page))
