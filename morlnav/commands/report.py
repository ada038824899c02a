"""``morlnav-report SWEEP_DIR``: the paper's table and figures of a sweep, with statistics over its seeds."""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from morlnav.analysis import load_settings, load_sweep
from morlnav.cli import folder, one_sentence_errors, quiet, set_threads, writable
from morlnav.deployment.policy import POLICY_FILE
from morlnav.evaluation.seeds import aggregate_scores, compare_scores
from morlnav.evaluation.seeds_plot import plot_curves, plot_scores
from morlnav.limits import check_at_least
from morlnav.navigation.evaluation.paper import TABLE_ONE, paper_name
from morlnav.navigation.evaluation.sweep import Sweep, read_columns
from morlnav.navigation.record.exact_front_plot import plot_reached_fronts
from morlnav.navigation.record.plots import plot_metrics, plot_trajectories
from morlnav.navigation.record.studies_plot import plot_studies
from morlnav.record.markdown import markdown_table
from morlnav.runs import Run

STUDIED = ["baseline", "baseline_low", "baseline_high", "demonstrator"]
CURVES = {"evaluation/success": "success", "evaluation/front_share": "share of the exact front"}
BOUNDED = {"success": 0.0, "SPL": 0.0, "fidelity": -1.0, "front share": 0.0}
"""Scores that are 1 at most, and their least value."""
STUDIES = {"noise": "epsilon", "number": "demonstrations"}
"""Files that ``morlnav-clone STUDY --output SWEEP_DIR/clone`` leaves, and their first columns (Fig. 2a, 2b)."""


class Report:
    """Tables and figures of a sweep; each is there as far as its runs keep what it needs, and ``notes`` say what lacks.

    Args:
        directories: of a sweep, or of single runs.
        scenes: held-out scenes that Fig. 3 shows, from the first on.

    Raises:
        FileNotFoundError: if there are no runs, or none of them is evaluated.
        ValueError: if a file is damaged.

    Examples:
        >>> report = Report([Path("results/two_styles")])
        >>> sorted(report.tables)
        ['extremes', 'scores', 'table1', 'times']
        >>> len(report.fronts().axes)
        1
    """

    def __init__(self, directories: list[Path], scenes: int = 4) -> None:
        check_at_least(1, scenes=scenes)
        self.source = [path for directory in directories for path in load_settings(directory)["path"]]
        self.directory, self.scenes = directories[0], scenes
        self.sweep = Sweep(self.source)
        self.notes = list(self.sweep.notes)
        scores = self.sweep.scores()
        tables = {"scores": _bounded(aggregate_scores(scores)), "comparisons": compare_scores(scores, self.sweep.agent)}
        if self.sweep.summaries:
            tables["table1"] = self.sweep.table_one()
        if len(next(iter(self.sweep.of(self.sweep.agent, self.sweep.summaries)), ())) > 1:
            kept, all_runs = (
                self.sweep.of(self.sweep.agent, each) for each in (self.sweep.episodes, self.sweep.summaries)
            )
            if len(kept) == len(all_runs):
                self.summary, tables["extremes"] = self.sweep.over_preferences()
            else:
                self.notes.append(f"No Fig. 3 and 4: runs of {self.sweep.agent} keep no evaluation/episodes.csv.")
        tables["times"] = self.sweep.times()
        self.tables = {name: table for name, table in tables.items() if len(table)}

    def studies(self) -> Figure | None:
        """Fig. 2: the clone over noise, and over the number of demonstrations."""
        if not self.sweep.summaries:
            return None
        tables = []
        for letter, (study, first) in zip("ab", STUDIES.items(), strict=True):
            file, columns = self.directory / "clone" / f"{study}.csv", [first, *STUDIED]
            if file.is_file():
                tables.append(read_columns(file, columns)[columns])
            else:
                self.notes.append(
                    f"No Fig. 2{letter}: `morlnav-clone {study} --output {file.parent}` makes {file.name}."
                )
        return plot_studies(*tables) if tables else None

    def trajectories(self) -> Figure | None:
        """Fig. 3: the first run of the agent that keeps its policy drives in held-out scenes, beside the oracle."""
        if "extremes" not in self.tables:
            return None
        runs = self.sweep.runs[self.sweep.runs["setting"] == self.sweep.agent]
        kept = [path for path in runs["path"] if (path / POLICY_FILE).is_file()]
        try:
            if not kept:
                raise FileNotFoundError(f"no run of {self.sweep.agent} keeps its {POLICY_FILE}.")
            evaluation = (run := Run(kept[0])).evaluation
            scenes = evaluation.scenes()[: self.scenes]
            rollouts = evaluation.drive(run.policy, scenes, evaluation.preferences())
        except (ValueError, OSError) as error:
            self.notes.append(f"No Fig. 3: {error}")
            return None
        world, paths = evaluation.env.world, evaluation.references(scenes)
        radii = {"human_radius": world.human_radius, "robot_radius": world.robot.radius}
        return plot_trajectories(rollouts, evaluation.objectives, range(len(scenes)), references=paths, **radii)

    def metrics(self) -> Figure | None:
        """Fig. 4: metrics under every λ, t-tests between the extremes, and the agent without preferences."""
        if "extremes" not in self.tables:
            return None
        if self.sweep.baseline is None:
            self.notes.append("No dotted line in Fig. 4: the sweep has no agent without preferences.")
        return plot_metrics(self.summary, self.tables["extremes"], baseline=self.sweep.without_preferences())

    def fronts(self) -> Figure | None:
        """The exact front of distance and time, and how much of it each setting reaches."""
        tables = {name: self.sweep.of(name, self.sweep.possible) for name in self.sweep.settings}
        tables = {name: seeds for name, seeds in tables.items() if seeds}
        return plot_reached_fronts(self.sweep.front, tables) if tables else None

    def curves(self) -> Figure | None:
        """Success and the share of the front while the settings learned, before their refinement."""
        names = dict(self.sweep.runs[["run", "setting"]].to_numpy())
        try:
            logs = load_sweep(self.source)
        except FileNotFoundError as error:
            self.notes.append(f"No learning curves: {error}")
            return None
        logs = logs[logs["run"].isin(names) & logs["metric"].isin(CURVES)]
        if logs.empty:
            self.notes.append(f"No learning curves: the logs hold none of {', '.join(CURVES)}.")
            return None
        return plot_curves(logs, names, {name: CURVES[name] for name in CURVES if (logs["metric"] == name).any()})

    def intervals(self) -> Figure:
        """Interquartile means of all scores with intervals over seeds."""
        return plot_scores(self.tables["scores"])

    def readable(self, name: str) -> pd.DataFrame:
        """A table as it is printed, every cell a text."""
        return READABLE[name](self.tables[name])

    def write(self, output: Path) -> Path:
        """Write every table as CSV and LaTeX, every figure as PNG, and ``report.md``, the page with all of them.

        Returns:
            The page.
        """
        output.mkdir(parents=True, exist_ok=True)
        tables = [f"{name}.{kind}" for name in SECTIONS for kind in ("csv", "tex")]
        for file in (*tables, *(f"{name}.png" for name in FIGURES)):
            (output / file).unlink(missing_ok=True)  # of an earlier report, which may have had more to show
        page = ["# Report of a sweep", ""]
        for name, (title, text) in SECTIONS.items():
            if name in self.tables:
                table = self.readable(name)
                self.tables[name].to_csv(output / f"{name}.csv", index=False)
                (output / f"{name}.tex").write_text(_latex(table), encoding="utf-8")
                shown = markdown_table(table, table.to_numpy(), (":--",))
                page += [f"## {title.format(agent=self.sweep.agent)}", "", text, "", shown, ""]
        page += ["## Figures", ""]
        for name, (method, caption) in FIGURES.items():
            if (figure := getattr(self, method)()) is not None:
                figure.savefig(output / f"{name}.png", dpi=150)
                caption = caption.format(agent=self.sweep.agent)
                page += [f"![{caption}]({name}.png)", "", f"*{caption}.*", ""]
        page += ["## What is missing", "", *(f"- {note}" for note in self.notes or ["Nothing."]), ""]
        (output / "report.md").write_text("\n".join(page), encoding="utf-8")
        return output / "report.md"


def _bounded(table: pd.DataFrame) -> pd.DataFrame:
    """Student's intervals of scores that have bounds, within these."""
    ends, least = ["mean_low", "mean_high"], table["score"].map(BOUNDED)
    table[ends] = table[ends].clip(lower=least, upper=least.where(least.isna(), 1.0), axis=0)
    return table


def _table_one(table: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for ablation, agents in table.groupby("ablation", sort=False):
        for setting, cells in agents.groupby("setting", sort=False):
            numbers = zip(TABLE_ONE.values(), cells.itertuples(), strict=True)
            row = {_heading(*entry): _interval(cell.mean, cell.low, cell.high, entry[1]) for entry, cell in numbers}
            rows.append({"agent": setting, "seeds": str(cells["seeds"].max()), **row})
        if cells["paper"].notna().any():
            numbers = zip(TABLE_ONE.values(), cells["paper"], strict=True)
            row = {_heading(*entry): _interval(number, digits=entry[1]) for entry, number in numbers}
            rows.append({"agent": f"paper: {paper_name(ablation)}", "seeds": "1", **row})
    return pd.DataFrame(rows)


def _heading(title: str, _: int, objective: str) -> str:
    return f"{title}, λ = {objective}" if objective else title


def _scores(table: pd.DataFrame) -> pd.DataFrame:
    readable = table[["score", "setting"]].assign(seeds=table["seeds"].astype(str))
    for name, heading in (("iqm", "interquartile mean"), ("mean", "mean")):
        numbers = table[[name, f"{name}_low", f"{name}_high"]].to_numpy()
        readable[heading] = [_interval(*row, digits=3) for row in numbers]
    return readable


def _comparisons(table: pd.DataFrame) -> pd.DataFrame:
    chance = table[["probability", "probability_low", "probability_high"]].to_numpy()
    readable = table[["score", "setting", "than"]].assign(difference=table["difference"].map("{:+.3f}".format))
    readable["P(better)"] = [_interval(*row, digits=2) for row in chance]
    return readable.assign(**_tests(table))


def _times(table: pd.DataFrame) -> pd.DataFrame:
    minutes = table.drop(columns=["setting", "runs"]).map(lambda cell: _interval(cell, digits=1))
    return table[["setting", "runs"]].astype(str).join(minutes)


def _extremes(table: pd.DataFrame) -> pd.DataFrame:
    table = table[table["first"] < table["second"]]  # every pair is there in both orders
    means = [" and ".join(_interval(mean) for mean in pair) for pair in table[["mean_first", "mean_second"]].to_numpy()]
    readable = table[["metric", "first", "second"]].assign(means=means, **_tests(table))
    return readable.assign(**{"between seeds": table["p_seeds"].map(_p)})


def _tests(table: pd.DataFrame) -> dict[str, pd.Series]:
    shown = {heading: table[name].map(_p) for name, heading in (("p", "p"), ("p_holm", "p, Holm"))}
    return shown | {"": table["stars"]}


def _p(value: float) -> str:
    return "–" if pd.isna(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def _interval(mean: float, low: float = float("nan"), high: float = float("nan"), digits: int = 2) -> str:
    """A number and its interval, as far as they are known."""
    if pd.isna(mean):
        return "–"
    return f"{mean:.{digits}f}" + ("" if pd.isna(low) else f" [{low:.{digits}f}, {high:.{digits}f}]")


def _latex(table: pd.DataFrame) -> str:
    text = table.to_latex(index=False, escape=True)
    for letter, command in {"λ": r"$\lambda$", "γ": r"$\gamma$", "–": "--"}.items():
        text = text.replace(letter, command)
    return text


READABLE = {
    "table1": _table_one,
    "extremes": _extremes,
    "scores": _scores,
    "comparisons": _comparisons,
    "times": _times,
}
FIGURES = {
    "fig2": ("studies", "Fig. 2: return of the clone over noise, and over the number of demonstrations"),
    "fig3": ("trajectories", "Fig. 3: {agent} under the preferences Λ, in black the demonstrator without boxes"),
    "fig4": ("metrics", "Fig. 4: {agent} over the preferences Λ, with 95 % intervals"),
    "fronts": ("fronts", "The exact front of distance and time, and the share of it that settings reach"),
    "intervals": ("intervals", "Interquartile means over seeds and λ, with 95 % intervals"),
    "curves": ("curves", "Learning curves, before the refinement, with 95 % intervals over seeds"),
}
"""Of each figure the method of :class:`Report` and the caption."""
SECTIONS = {
    "table1": (
        "Table I",
        "Mean and 95 % interval over seeds (Student's t), below it the paper's numbers. Rates are of all episodes and "
        "all λ, the other columns of episodes with all weight on one objective; times count successes alone.",
    ),
    "extremes": (
        "{agent}: the extreme preferences",
        "Means with all weight on one and on the other objective, and t-tests as in the paper, paired by scene (means "
        "over seeds), with Holm's correction for all rows; in the last column the same over seeds. "
        "\\*\\*\\* p ≤ 0.001, \\*\\* p ≤ 0.01, \\* p ≤ 0.05, ns: not significant.",
    ),
    "scores": (
        "Scores",
        "More is better. The interquartile mean is that of the middle half of all seeds and λ; its interval is a "
        "bootstrap's that resamples whole seeds, of each setting by themselves. The mean has Student's interval.",
    ),
    "comparisons": (
        "{agent} beside the others",
        "By how much it scores above another, how often one of its seeds does under the same λ (a tie is half of it), "
        "and Welch's t-test between seeds, with Holm's correction for all rows.",
    ),
    "times": (
        "Wall time",
        "Minutes: means over runs, and the sum of all. Runs beside each other share the processor; rewards from the "
        "cache cost nothing here.",
    ),
}


def main() -> None:
    """Entry point."""
    quiet()
    parser = argparse.ArgumentParser(prog="morlnav-report", description=__doc__.split(": ", 1)[1])
    parser.add_argument(
        "sweep", type=Path, nargs="+", metavar="SWEEP_DIR", help="of morlnav-train -m, or run directories"
    )
    parser.add_argument("--output", type=folder, help="where the report goes (default: SWEEP_DIR/report)")
    parser.add_argument("--scenes", type=int, default=4, help="that Fig. 3 shows (default: 4)")
    parser.add_argument("--threads", type=int, default=1, help="threads of PyTorch (default: 1)")
    args = parser.parse_args()
    with one_sentence_errors():
        set_threads(args.threads)
        output = writable(args.output or args.sweep[0] / "report")
        report = Report(args.sweep, args.scenes)
        page = report.write(output)
        for note in report.notes:
            print(note)
        print(f"The report is {page}")


if __name__ == "__main__":
    main()
