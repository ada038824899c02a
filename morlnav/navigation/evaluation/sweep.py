"""What a sweep says in numbers: the paper's Table I, and scores over seeds, from files that its runs keep."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
import torch

from morlnav.analysis import Runs, load_settings
from morlnav.evaluation import preference_label
from morlnav.evaluation.seeds import holm, mean_interval, stars
from morlnav.navigation.evaluation.paper import PAPER, TABLE_ONE, paper_name, published
from morlnav.navigation.evaluation.possible import EDGE, ExactFront, possible_table
from morlnav.navigation.evaluation.report import PLOTTED
from morlnav.navigation.evaluation.statistics import ONLY_SUCCESS, compare_extremes, fidelity, tuneable_objectives
from morlnav.runs.directory import PARTS, times_of

T = TypeVar("T")
ENDS = ("", "_low", "_high")
"""After the name of a metric: its mean, and the ends of the interval."""


class Sweep:
    """The evaluations that the runs of a sweep keep; nothing is driven again, and nothing is unpickled.

    Args:
        source: a sweep's directory, or run directories.

    Attributes:
        runs: a row per evaluated run, as of :func:`~morlnav.analysis.load_settings`; no setting has a seed twice.
        ablation: the word of that group of each setting.
        settings: those with the same word beside each other, the plain word first, as the same agent of two recipes.
        possible: every run beside the exact front (see :func:`possible_table`), if it drove in the front's scenes.
        notes: sentences on what is missing.

    Raises:
        FileNotFoundError: if there are no runs, or none of them is evaluated.
        ValueError: if a file is damaged; the sentence names it.

    Examples:
        >>> sweep = Sweep("results/two_styles")
        >>> sweep.settings, sweep.runs["seed"].tolist()
        (['our'], [0])
    """

    def __init__(self, source: Runs) -> None:
        runs = load_settings(source)
        done = runs["path"].map(lambda path: (path / "evaluation" / "front.csv").is_file())
        again = runs[done].duplicated(["setting", "seed"]).reindex(runs.index, fill_value=False)
        if not done.any():
            raise FileNotFoundError(
                f"None of the runs {', '.join(runs['run'])} is evaluated; finish one, or use morlnav-evaluate."
            )
        kept = runs[done & ~again]
        more_than_the_word, word = kept["setting"] != kept["ablation"], pd.factorize(kept["ablation"])[0]
        self.runs = kept.iloc[np.lexsort((more_than_the_word, word))].reset_index(drop=True)
        self.ablation = dict(self.runs[["setting", "ablation"]].to_numpy())
        self.settings = list(self.ablation)
        self._paths = dict(zip(self.runs["run"], self.runs["path"], strict=True))
        self.notes = [
            f"Run {run.run} ({run.setting}, seed {run.seed}) has no evaluation." for run in runs[~done].itertuples()
        ]
        self.notes += [
            f"Run {run.run} repeats seed {run.seed} of {run.setting}: left out." for run in runs[again].itertuples()
        ]
        seeds = self.runs["setting"].value_counts(sort=False)
        if single := list(seeds.index[seeds == 1]):
            self.notes.append(f"A single seed has neither intervals nor tests: {', '.join(single)}.")
        there = set(map(paper_name, self.ablation.values()))
        absent = [word for word, (name, _) in PAPER.items() if name not in there]
        if self.summaries and 0 < len(absent) < len(PAPER):
            words = ",".join(f"[{word}]" if "," in word else word for word in absent)
            self.notes.append(f"The sweep lacks agents of the paper: ablation={words}.")
        if untimed := [run for run, parts in self.seconds.items() if not parts]:
            self.notes.append(f"No wall time is known of {', '.join(untimed)}.")
        if self.summaries and self.front is None:
            self.notes.append("No run keeps evaluation/exact_front.csv; morlnav-evaluate RUN_DIR writes it.")
        beside = {} if self.front is None else {run: self._beside(run) for run in self.summaries}
        self.possible = {run: table for run, table in beside.items() if table is not None}

    @cached_property
    def fronts(self) -> dict[str, pd.DataFrame]:
        """``front.csv`` of every run."""
        return {
            run.run: read_columns(run.path / "evaluation" / "front.csv", ["utility"]) for run in self.runs.itertuples()
        }

    @cached_property
    def episodes(self) -> dict[str, Path]:
        """``episodes.csv`` of the runs that keep it."""
        files = {run: path / "evaluation" / "episodes.csv" for run, path in self._paths.items()}
        return {run: file for run, file in files.items() if file.is_file()}

    @cached_property
    def seconds(self) -> dict[str, dict[str, float]]:
        """``times.json`` of every run, as far as it keeps one."""
        return {run: times_of(path) for run, path in self._paths.items()}

    @cached_property
    def summaries(self) -> dict[str, pd.DataFrame]:
        """``summary.csv`` of the runs that navigate."""
        files = {run: path / "evaluation" / "summary.csv" for run, path in self._paths.items()}
        columns = ["preference", "SR", "CR", "TR", "min_human_distance", "navigation_time", "time_ratio", "spl"]
        return {run: read_columns(file, columns) for run, file in files.items() if file.is_file()}

    @cached_property
    def agent(self) -> str:
        """The setting that figures show: ``our``, plain if it is there, or else the first that several λ steer."""
        steered = [name for name in self.settings if len(next(iter(self.of(name, self.fronts)))) > 1]
        ours = [name for name in steered if self.ablation[name] == "our"]
        return (ours or steered or self.settings)[0]

    @cached_property
    def baseline(self) -> str | None:
        """The navigating agent without preferences (``ablation=baseline``) that differs from :attr:`agent` in that."""
        rest = self.agent.removeprefix(self.ablation[self.agent])
        alone = [name for name in self.settings if self.ablation[name] == "baseline" and self.of(name, self.summaries)]
        return next((name for name in alone if name.removeprefix("baseline") == rest), None)

    def of(self, setting: str, tables: dict[str, T]) -> list[T]:
        """The tables, or whatever else, of a setting's runs, as far as there are any."""
        return [tables[run] for run in self.runs.loc[self.runs["setting"] == setting, "run"] if run in tables]

    @cached_property
    def front(self) -> ExactFront | None:
        """The exact front that the first run with one keeps."""
        files = [path / "evaluation" / "exact_front.csv" for path in self._paths.values()]
        file = next((file for file in files if file.is_file()), None)
        if file is None:
            return None
        table = read_columns(file, ["scene", "distance", "length"])
        lengths = table.pivot_table(index="scene", columns="distance", values="length", dropna=False).fillna(np.inf)
        return ExactFront(torch.tensor(lengths.columns.to_numpy(float)), torch.tensor(lengths.to_numpy(float)), [])

    def _beside(self, run: str) -> pd.DataFrame | None:
        if run not in self.episodes:
            self.notes.append(f"Run {run} keeps no evaluation/episodes.csv: no share of the front.")
            return None
        episodes = read_columns(self.episodes[run], ["scene", "shortest_path"])
        shortest = episodes.groupby("scene")["shortest_path"].first().to_numpy()
        known = self.front.length[:, 0].numpy()
        if shortest.shape != known.shape or not np.allclose(shortest, known, rtol=1e-3):
            self.notes.append(f"Run {run} drove in other scenes than those of the exact front.")
            return None
        summary = self.summaries[run]
        weights = [f"lambda_{name}" for name in tuneable_objectives(summary)]
        if len(summary) == 1:  # without preferences it is a point of any front
            return possible_table(self.front, summary.drop(columns=weights))
        return possible_table(self.front, summary) if set(EDGE) <= set(tuneable_objectives(summary)) else None

    def table_one(self) -> pd.DataFrame:
        """Table I: a row per setting and metric of :data:`TABLE_ONE`.

        Returns:
            Columns ``setting``, ``ablation``, ``metric``, ``seeds`` (that have such a number), ``mean``, ``low`` and
            ``high`` (95 % interval over seeds, rates within 0 and 100), and ``paper``, the paper's number.
        """
        rows = []
        for name in self.settings:
            theirs = next((numbers for _, numbers in published(self.ablation[name])), [np.nan] * 6)
            for (metric, (*_, objective)), paper in zip(TABLE_ONE.items(), theirs, strict=True):
                values = [_measure(summary, metric, objective) for summary in self.of(name, self.summaries)]
                mean, *ends = mean_interval(values)
                low, high = np.clip(ends, 0, 100 if metric in ("SR", "CR", "TR") else np.inf)
                cell = {"seeds": int(np.isfinite(values).sum()), "mean": mean, "low": low, "high": high, "paper": paper}
                rows.append({"setting": name, "ablation": self.ablation[name], "metric": metric, **cell})
        return pd.DataFrame(rows)

    def scores(self) -> pd.DataFrame:
        """What settings are compared by, each better the larger it is.

        ``success`` (share of episodes) and ``SPL`` under every λ; ``fidelity``: rank correlation of a weight with the
        metric that it should move, along each edge of the simplex, 0 where nothing moves; and ``front share``, how much
        of the exact front is reached. Of other tasks ``utility`` under every λ and ``hypervolume``.

        Returns:
            Columns ``score``, ``setting``, ``run``, ``task`` and ``value``, as :func:`aggregate_scores` takes them. An
            agent without preferences does the same for every λ.
        """
        rows = [row for run in self.runs.itertuples() for row in self._scores_of(run.run, run.setting)]
        table = pd.DataFrame(rows, columns=["score", "setting", "run", "task", "value"]).dropna()
        order = ["success", "SPL", "fidelity", "front share", "utility", "hypervolume"]
        return table.sort_values("score", key=lambda name: name.map(order.index), kind="stable", ignore_index=True)

    def _scores_of(self, run: str, setting: str) -> list[tuple]:
        front, summary = self.fronts[run], self.summaries.get(run)
        if summary is None:
            rows = [("utility", task, value) for task, value in zip(_labels(front), front["utility"], strict=True)]
            if "hypervolume" in front:
                rows.append(("hypervolume", "", front["hypervolume"].iloc[0]))
            return [(score, setting, run, task, value) for score, task, value in rows]
        tasks = _labels(summary)
        if len(summary) == 1:
            tasks = list(dict.fromkeys(task for each in self.of(self.agent, self.summaries) for task in _labels(each)))
            summary = summary.loc[summary.index.repeat(len(tasks))]
        rows = [("success", task, value / 100) for task, value in zip(tasks, summary["SR"], strict=True)]
        rows += [("SPL", task, value) for task, value in zip(tasks, summary["spl"], strict=True)]
        if run in self.possible:
            rows.append(("front share", "", self.possible[run]["front_share"].iloc[0]))
        if len(self.summaries[run]) > 1:
            ranks = fidelity(summary.assign(success=True, scene=0))
            rows += [
                ("fidelity", f"{r.objective} against {r.versus}", np.nan_to_num(r.edge_spearman))
                for r in ranks.itertuples()
            ]
        return [(score, setting, run, task, value) for score, task, value in rows]

    def times(self) -> pd.DataFrame:
        """Wall time in minutes, of the runs that keep it in ``times.json``.

        Returns:
            A row per setting and one for ``all`` runs, with the columns ``setting``, ``runs``, the parts of a run and
            ``one run`` (means over runs), and ``together`` (their sum).
        """
        kept = pd.DataFrame(list(self.seconds.values()), self.runs["setting"], PARTS) / 60
        kept = kept.dropna(how="all").assign(**{"one run": lambda parts: parts.sum(axis=1)}).reset_index()
        groups = {name: kept[kept["setting"] == name] for name in kept["setting"].unique()}
        rows = [
            {"setting": name, "runs": len(runs), **runs.mean(numeric_only=True), "together": runs["one run"].sum()}
            for name, runs in ({**groups, "all": kept} if groups else {}).items()
        ]
        return pd.DataFrame(rows)

    def over_preferences(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Fig. 4 of :attr:`agent`: metrics under every λ, and t-tests between the extreme preferences.

        Returns:
            A summary with means and 95 % intervals over seeds, or over episodes for a single seed; and tests as of
            :func:`compare_extremes` over scenes, each a mean over seeds, with ``p_holm``, Holm's correction for all
            pairs and metrics, from which the ``stars`` are, and the same over seeds in ``p_seeds``.
        """
        tables = self.of(self.agent, self.summaries)
        metrics = [name for name in PLOTTED if all(name in table for table in tables)]
        weights = [f"lambda_{name}" for name in tuneable_objectives(tables[0])]
        files = self.of(self.agent, self.episodes)
        episodes = pd.concat([read_columns(file, [*weights, *metrics, "scene", "success"]) for file in files])
        late = [name for name in metrics if name in ONLY_SUCCESS]
        episodes[late] = episodes[late].where(episodes["success"].astype(bool))
        scenes = episodes.groupby([*weights, "scene"], as_index=False)[metrics].mean()
        seeds = pd.concat([table.assign(scene=seed) for seed, table in enumerate(tables)], ignore_index=True)
        tests = _test_extremes(scenes, metrics)
        tests["p_seeds"] = _test_extremes(seeds, metrics)["p_holm"]
        if len(tables) == 1:
            ends = [f"{name}{end}" for name in metrics for end in ENDS]
            return read_columns(files[0].with_name("summary.csv"), ends), tests
        rows = []
        for point, group in seeds.groupby(weights, sort=False):
            ends = {name: np.maximum(mean_interval(group[name]), 0) for name in metrics}  # no distance is below 0
            named = [
                (f"{name}{end}", value) for name, row in ends.items() for end, value in zip(ENDS, row, strict=True)
            ]
            rows.append(dict(zip(weights, point, strict=True)) | dict(named))
        return pd.DataFrame(rows), tests

    def without_preferences(self) -> pd.DataFrame | None:
        """Means over the seeds of the agent without preferences in one row, for the dotted line of Fig. 4."""
        if self.baseline is None:
            return None
        return pd.concat(self.of(self.baseline, self.summaries)).mean(numeric_only=True).to_frame().T


def read_columns(file: Path, columns: list[str]) -> pd.DataFrame:
    """A kept CSV file as numbers.

    Raises:
        ValueError: if the file is no table, or one of the columns is missing or holds no numbers; it is named.
    """
    try:
        table = pd.read_csv(file)
    except (ValueError, OSError) as error:  # pandas' own errors are ValueErrors, too
        raise ValueError(f"{file} cannot be read as a table: {error}") from error
    if missing := [name for name in columns if name not in table]:
        raise ValueError(f"{file} has no column {missing[0]}; write it anew with morlnav-evaluate.")
    if not len(table):
        raise ValueError(f"{file} has no rows; write it anew with morlnav-evaluate.")
    weights = [name for name in table if name.startswith("lambda_")]
    for name in [*columns, *weights]:
        if not pd.api.types.is_numeric_dtype(table[name]):
            raise ValueError(f"{file} holds something else than numbers in the column {name}.")
    return table


def _measure(summary: pd.DataFrame, metric: str, objective: str) -> float:
    """A metric of one run where the objective has all weight; without one, over all λ."""
    if metric not in summary:
        return np.nan
    weight = summary.get(f"lambda_{objective}")
    if not objective or len(summary) == 1:
        return summary[metric].mean()
    return np.nan if weight is None else summary.loc[np.isclose(weight, 1, atol=1e-5), metric].mean()


def _test_extremes(sample: pd.DataFrame, metrics: list[str]) -> pd.DataFrame:
    """:func:`compare_extremes` with Holm's correction for all metrics and pairs, which are there in both orders."""
    tests = compare_extremes(sample.assign(success=True), metrics)
    once = tests["first"] < tests["second"]
    tests.loc[once, "p_holm"] = holm(tests.loc[once, "p"])
    pair = tests[["first", "second"]].apply(lambda row: " ".join(sorted(row)), axis=1)
    tests["p_holm"] = tests.groupby(["metric", pair])["p_holm"].transform("max")
    return tests.assign(stars=tests["p_holm"].map(stars))


def _labels(table: pd.DataFrame) -> list[str]:
    names = tuneable_objectives(table)
    return [preference_label(names, row) for row in table[[f"lambda_{name}" for name in names]].to_numpy().tolist()]
