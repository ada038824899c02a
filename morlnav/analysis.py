"""Logs and evaluations of one run or of a sweep as tidy tables."""

from __future__ import annotations

import os
from collections.abc import Iterable
from operator import attrgetter
from pathlib import Path
from typing import TypeAlias

import pandas as pd
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from morlnav.runs.config import CONFIG_FILE, flat_settings, load_config, read_yaml

Runs: TypeAlias = "str | Path | Iterable[str | Path]"
"""A run directory, a sweep's directory with run directories in it, or several run directories."""


def load_run(directory: str | Path) -> pd.DataFrame:
    """The scalars that a run has logged so far; it need not have finished.

    Args:
        directory: a run directory.

    Returns:
        Columns ``run`` (its name), ``metric`` (such as ``train/success``), ``step`` (frames) and ``value``, sorted. A
        resumed run repeats the steps after its checkpoint; the last value counts.

    Raises:
        FileNotFoundError: if the directory is not a run's, or holds no logs.

    Examples:
        >>> import tempfile
        >>> from morlnav.record.loggers import TensorboardCSVLogger
        >>> directory = Path(tempfile.mkdtemp(), "first")
        >>> TensorboardCSVLogger("logs", directory).log_scalar("train/success", 0.5, step=10)
        >>> _ = (directory / "config.yaml").write_text("seed: 0")
        >>> load_run(directory)
             run         metric  step  value
        0  first  train/success    10    0.5
    """
    return load_sweep([directory])


def load_settings(source: Runs) -> pd.DataFrame:
    """The runs of a sweep, and what a table or a figure calls what was tried in each.

    Args:
        source: as for :func:`load_sweep`; runs that have not finished are among them.

    Returns:
        A row per run: ``run``; ``path``, its directory; ``seed``; and ``setting``: the word of the group ``ablation``,
        as ``no_human``, then other words of the command line in which runs differ, and what else differs, but seeds
        and what more than half of all settings have alike. So the runs of a setting differ in nothing but their seed.
        ``ablation`` is the word of that group alone.

    Raises:
        FileNotFoundError: if there are no runs.
        ValueError: if the sequence of directories is empty.

    Examples:
        >>> load_settings("results/default")[["setting", "seed"]].values.tolist()
        [['our', 0]]
    """
    runs = _find_runs(source)
    configs, words, ablations = _words(runs)
    words = words.drop(columns=["seed", "ablation"], errors="ignore")
    settings = configs.drop(columns=[name for name in configs if name.split(".")[-1] == "seed"])
    rest = _unexplained(settings, words.assign(ablation=ablations))
    others = pd.concat([words, rest], axis=1).map(_text)
    distinct = others.assign(ablation=ablations).drop_duplicates()
    usual = {
        key: value for key in others if 2 * (distinct[key] == (value := distinct[key].mode()[0])).sum() > len(distinct)
    }
    unusual = [
        ", ".join(f"{key}={value}" for key, value in row.items() if value != usual.get(key))
        for row in others.to_dict("records")
    ]
    several = len(set(ablations)) > 1
    named = [
        text if text and not several else ", ".join(filter(None, (word, text)))
        for word, text in zip(ablations, unusual, strict=True)
    ]
    kept = {"run": list(runs), "path": list(runs.values()), "seed": configs.get("seed")}
    return pd.DataFrame(kept | {"setting": named, "ablation": ablations})


def load_sweep(source: Runs) -> pd.DataFrame:
    """The scalars of several runs, with the settings in which they differ.

    They come from the CSV files of a run, or, where it has none, from its TensorBoard events, which hold single
    precision.

    Args:
        source: a sweep's directory, or run directories; runs that have logged nothing are left out.

    Returns:
        As for :func:`load_run`, with one more column per setting that is not the same in all runs: by the word that was
        typed, such as ``seed`` or ``ablation``, which stands for all that it changes, and by the dotted names of other
        config values that differ, such as ``loss.gamma``.

    Raises:
        FileNotFoundError: if there are no runs, or none of them has logs.
        ValueError: if the sequence of directories is empty.

    Examples:
        >>> import tempfile
        >>> from morlnav.record.loggers import TensorboardCSVLogger
        >>> sweep = Path(tempfile.mkdtemp())
        >>> for seed in (0, 1):
        ...     TensorboardCSVLogger("logs", sweep / f"seed={seed}").log_scalar("train/success", seed / 2, step=10)
        ...     _ = (sweep / f"seed={seed}" / "config.yaml").write_text(f"seed: {seed}")
        >>> load_sweep(sweep)
              run  seed         metric  step  value
        0  seed=0     0  train/success    10    0.0
        1  seed=1     1  train/success    10    0.5
    """
    runs = _find_runs(source)
    tables = {name: _scalars(path) for name, path in runs.items()}
    return _join(runs, tables, "logged scalars; wait for the first lines in logs/scalars")


def load_episodes(source: Runs) -> pd.DataFrame:
    """Every evaluated episode: ``run``, differing settings, and the columns of ``episodes.csv``.

    Args:
        source: as for :func:`load_sweep`; runs without an evaluation are left out.

    Raises:
        FileNotFoundError: if there are no runs, or none of them is evaluated.
        ValueError: if the sequence of directories is empty.

    Examples:
        >>> import tempfile
        >>> run = Path(tempfile.mkdtemp(), "first")
        >>> (run / "evaluation").mkdir(parents=True)
        >>> _ = (run / "config.yaml").write_text("seed: 0")
        >>> _ = (run / "evaluation" / "episodes.csv").write_text("preference,success\\n0,True\\n0,False\\n")
        >>> load_episodes(run).groupby("preference")["success"].mean()
        preference
        0    0.5
        Name: success, dtype: float64
    """
    return _load_evaluation(source, "episodes")


def load_summaries(source: Runs) -> pd.DataFrame:
    """Means and confidence bounds per preference: ``run``, differing settings, and the columns of ``summary.csv``.

    Arguments and errors are those of :func:`load_episodes`.

    Examples:
        >>> load_summaries("results/default")[["lambda_distance", "SR"]]  # doctest: +SKIP
    """
    return _load_evaluation(source, "summary")


def load_fronts(source: Runs) -> pd.DataFrame:
    """Mean return vector per preference: ``run``, differing settings, and the columns of ``front.csv``.

    Arguments and errors are those of :func:`load_episodes`.

    Examples:
        >>> load_fronts("results/three_styles").groupby("seed")["hypervolume"].first()  # doctest: +SKIP
    """
    return _load_evaluation(source, "front")


def _load_evaluation(source: Runs, name: str) -> pd.DataFrame:
    runs = _find_runs(source)
    files = {run: path / "evaluation" / f"{name}.csv" for run, path in runs.items()}
    tables = {run: pd.read_csv(file) for run, file in files.items() if file.is_file()}
    return _join(runs, tables, f"an evaluation/{name}.csv; finish the training or use morlnav-evaluate")


def _find_runs(source: Runs) -> dict[str, Path]:
    """Run directories by their names below the closest folder that holds them all."""
    if isinstance(source, (str, Path)):
        root = Path(source)
        configs = [root / CONFIG_FILE] if (root / CONFIG_FILE).is_file() else sorted(root.glob(f"*/{CONFIG_FILE}"))
        runs = [config.parent for config in configs]
        if not runs:
            raise FileNotFoundError(f"{root} holds no runs: neither it nor a folder in it has a {CONFIG_FILE}.")
    else:
        runs = list(source)
        if not runs:
            raise ValueError("No run directories were given.")
    paths = [Path(os.path.abspath(run)) for run in runs]
    root = Path(os.path.commonpath([path.parent for path in paths]))
    return {path.relative_to(root).as_posix(): path for path in paths}


def _scalars(run: Path) -> pd.DataFrame:
    tables = _from_csv(run / "logs" / "scalars") or _from_events(run / "logs")
    if not tables:
        return pd.DataFrame()
    logs = pd.concat(tables, names=["metric"]).reset_index("metric")
    return logs.drop_duplicates(["metric", "step"], keep="last").sort_values(["metric", "step"])


def _from_csv(folder: Path) -> dict[str, pd.DataFrame]:
    return {
        path.relative_to(folder).with_suffix("").as_posix(): pd.read_csv(path, names=["step", "value"])
        for path in folder.rglob("*.csv")
        if path.stat().st_size
    }


def _from_events(folder: Path) -> dict[str, pd.DataFrame]:
    if not any(folder.glob("*.tfevents.*")):
        return {}
    # Every scalar is kept, those of steps that a resumed run repeats too: the last one counts, as in the CSV files.
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}, purge_orphaned_data=False).Reload()
    return {
        name: pd.DataFrame(
            [(event.step, event.value) for event in sorted(events.Scalars(name), key=attrgetter("wall_time"))],
            columns=["step", "value"],
        )
        for name in events.Tags()["scalars"]
    }  # by time, for files that begin in the same second are read in the order of their names


def _join(runs: dict[str, Path], tables: dict[str, pd.DataFrame], wanted: str) -> pd.DataFrame:
    """Stack the tables of the runs beside the settings in which the runs differ."""
    settings = _differences(runs)
    tables = {name: table for name, table in tables.items() if len(table)}
    if not tables:
        named = ", ".join(runs) if len(runs) < 4 else f"in {', '.join(list(runs)[:3])} and {len(runs) - 3} more folders"
        raise FileNotFoundError(f"None of the runs {named} has {wanted}.")
    stacked = pd.concat(tables, names=["run"]).reset_index("run")
    return settings.merge(stacked, on="run")


def _differences(runs: dict[str, Path]) -> pd.DataFrame:
    """The settings in which runs differ: the words that were typed, and what these do not explain.

    A word such as ``ablation=no_human`` stands for all that it changes.
    """
    configs, typed, _ = _words(runs)
    return pd.concat([pd.Series(list(runs), name="run"), typed, _unexplained(configs, typed)], axis=1)


def _unexplained(configs: pd.DataFrame, words: pd.DataFrame) -> pd.DataFrame:
    """What differs between the configs of runs that share all words."""
    same = words.map(_text).agg(", ".join, axis=1) if len(words.columns) else pd.Series("", configs.index)
    differs = configs.groupby(same).nunique(dropna=False).max() > 1
    return configs.loc[:, differs].drop(columns=list(words), errors="ignore")


def _text(value: object) -> str:
    """A setting as it is typed; one that a version of the code did not know is null."""
    return "null" if pd.isna(value) else str(value)


def _words(runs: dict[str, Path]) -> tuple[pd.DataFrame, pd.DataFrame, list[str]]:
    """The configs of runs, the words of the command line in which they differ, and each one's word of ``ablation``.

    A run that did not type a word beside one that did has the config's value, or the choice that Hydra noted.
    """
    configs = pd.DataFrame([flat_settings(load_config(path), path) for path in runs.values()])
    typed, choices = zip(*map(_chosen, runs.values()), strict=True)
    keys = dict.fromkeys(key for words in typed for key in words)
    known = [
        {**groups, **words, **flat}
        for groups, words, flat in zip(choices, typed, configs.to_dict("records"), strict=True)
    ]
    words = pd.DataFrame([{key: row.get(key) for key in keys} for row in known], index=configs.index)
    ablations = [str(row.get("ablation", "our")).strip("[]") for row in known]
    return configs, words.loc[:, words.nunique(dropna=False) > 1], ablations


def _chosen(run: Path) -> tuple[dict[str, str], dict[str, str]]:
    """The words of a run's command line, and the choice of every group, for a run beside it may have typed another."""
    words, groups = (run / ".hydra" / name for name in ("overrides.yaml", "hydra.yaml"))
    pairs = [str(word).lstrip("+~").partition("=") for word in (read_yaml(words) or [] if words.is_file() else [])]
    typed = {key: value for key, _, value in pairs if key != "resume"}
    try:
        choices = read_yaml(groups)["hydra"]["runtime"]["choices"] if groups.is_file() else {}
        return typed, {group: choice for group, choice in choices.items() if not group.startswith("hydra/")}
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{groups} is damaged: it does not say what the run was composed of.") from error
