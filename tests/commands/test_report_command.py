"""The report on a sweep: of a real one in seconds, and of numbers made up to be known."""

import re
import sys

import pandas as pd
import pytest
import scipy
import torch
import yaml
from support import BRIEF, SMALL

from morlnav.commands import report, train
from morlnav.navigation.evaluation.report import PLOTTED
from morlnav.navigation.evaluation.sweep import ENDS, Sweep
from morlnav.runs import Run

SHORT = (
    "trainer.total_frames=64",
    "collector.init_random_frames=32",
    "rewards.audit=null",
    *(word for word in BRIEF if "audit" not in word),
)
DISTANCES = {0: 1.1, 1: 1.3, 2: 1.5}


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """Two agents with two seeds each, the second one without preferences."""
    folder = tmp_path_factory.mktemp("sweep")
    words = [f"hydra.sweep.dir={folder}", f"cache={folder / 'cache'}", "ablation=our,baseline", "seed=0,1"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYDRA_FULL_ERROR", "")
        patch.delenv("HYDRA_FULL_ERROR")
        patch.syspath_prepend(folder)
        patch.setattr(sys, "argv", ["morlnav-train", "-m", *SMALL, *SHORT, *words])
        train.main()
    return folder


def test_the_report_on_a_sweep_has_all_tables_and_figures(sweep, tmp_path, monkeypatch, capsys):
    (tmp_path / "fig2.png").touch()  # of an earlier report
    monkeypatch.setattr(sys, "argv", ["morlnav-report", str(sweep), "--output", str(tmp_path), "--scenes", "2"])
    report.main()
    tables = ("table1", "extremes", "scores", "comparisons", "times")
    figures = ("fig3", "fig4", "fronts", "intervals")
    files = {f"{name}{kind}" for name in tables for kind in (".csv", ".tex")} | {f"{name}.png" for name in figures}
    assert {path.name for path in tmp_path.iterdir()} == files | {"report.md"}
    page, told = (tmp_path / "report.md").read_text(), capsys.readouterr().out
    assert set(re.findall(r"\]\((.+?\.png)\)", page)) == {f"{name}.png" for name in figures}
    for row in (
        "| our | 2 |",
        "| paper: OUR | 1 | 100.0 |",
        "| baseline | 2 |",
        "| paper: baseline agent | 1 | 97.0 |",
    ):
        assert row in page
    for sentence in (
        "The sweep lacks agents of the paper: ablation=no_human,state_reward,[no_human,state_reward],gamma_099.",
        "No Fig. 2a: `morlnav-clone noise",
        "No learning curves: the logs hold none of evaluation/success",
    ):
        assert sentence in page
        assert sentence in told
    scores = pd.read_csv(tmp_path / "scores.csv").set_index(["score", "setting"])["seeds"]
    assert scores.loc["front share"].to_dict() == {"our": 2, "baseline": 2}
    assert scores.loc["fidelity"].to_dict() == {"our": 2}  # nothing steers the other one
    table = pd.read_csv(tmp_path / "table1.csv").set_index(["setting", "metric"])
    assert table.loc["baseline"]["mean"].drop("navigation_time").notna().all()
    times = pd.read_csv(tmp_path / "times.csv").set_index("setting")
    assert times["runs"].to_dict() == {"our": 2, "baseline": 2, "all": 4}
    parts = times[["rewards", "learning", "refinement", "evaluation"]]
    assert (parts > 0).all(None)
    assert times["together"].tolist() == pytest.approx((times["runs"] * parts.sum(axis=1)).tolist())
    assert times["together"]["all"] == pytest.approx(times["together"].iloc[:2].sum())


def test_the_agent_without_preferences_learns_from_the_baseline_alone_and_is_the_dotted_line(sweep):
    made = report.Report([sweep])
    alone = Run(made.sweep.runs.set_index("setting")["path"]["baseline"].iloc[0])
    assert alone.policy.objectives == ("demo",)
    assert alone.evaluation.scalarisation(torch.ones(1, 1), 2).tolist() == [[1.0, 0.0]]
    assert [text.get_text() for text in made.metrics().legends[0].get_texts()] == ["agent without preferences"]


def test_the_latex_is_a_table_with_escaped_names(sweep):
    for name in (made := report.Report([sweep])).tables:
        text = report._latex(made.readable(name))
        assert text.startswith(r"\begin{tabular}")
        assert text.rstrip().endswith(r"\end{tabular}")
        rows = [line for line in text.splitlines() if line.endswith(r"\\")]
        assert len({line.count(" & ") for line in rows}) == 1
        assert not re.search(r"(?<!\\)[_%#]", text)
        assert not set(text) & set("λγ–")


def keep(run, ablation, seed, distance, **more):
    """A run that keeps its words and an evaluation: two preferences, three episodes each."""
    (run / ".hydra").mkdir(parents=True)
    (run / "evaluation").mkdir()
    (run / "config.yaml").write_text(yaml.safe_dump({"seed": seed, "ablated": ablation}))
    (run / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump([f"ablation={ablation}", f"seed={seed}"]))
    summary = pd.DataFrame({"preference": [0, 1], "lambda_distance": [1.0, 0.0], "lambda_efficiency": [0.0, 1.0]})
    summary = summary.assign(SR=[100.0, 90.0], CR=0.0, TR=[0.0, 10.0], min_human_distance=[distance, 0.5])
    summary = summary.assign(navigation_time=[20.0, 17.0], time_ratio=[1.2, 1.0], spl=0.9, min_obstacle_distance=0.4)
    ends = {f"{name}{end}": 0.5 for name in PLOTTED if name in summary for end in ENDS[1:]}
    summary.assign(**ends, **more).to_csv(run / "evaluation" / "summary.csv", index=False)
    episodes = summary.loc[summary.index.repeat(3)].assign(scene=[0, 1, 2] * 2, success=True, shortest_path=8.0)
    episodes.to_csv(run / "evaluation" / "episodes.csv", index=False)
    summary[["lambda_distance", "lambda_efficiency"]].assign(utility=1.0).to_csv(run / "evaluation" / "front.csv")
    return run


def drop(file, column="min_human_distance_low"):
    pd.read_csv(file).drop(columns=column).to_csv(file, index=False)


def test_table_one_holds_means_and_intervals_over_seeds_beside_the_papers_numbers(tmp_path):
    for seed, distance in DISTANCES.items():
        keep(tmp_path / f"{seed}", "our", seed, distance)
    keep(tmp_path / "3", "[state_reward,no_human]", 0, 0.7)
    table = Sweep(tmp_path).table_one().set_index(["setting", "metric"])
    row = table.loc[("our", "min_human_distance")]
    expected = scipy.stats.t.interval(0.95, 2, 1.3, scipy.stats.sem(list(DISTANCES.values())))
    assert row[["seeds", "mean", "low", "high", "paper"]].tolist() == pytest.approx([3, 1.3, *expected, 1.18])
    assert table.loc[("our", "navigation_time"), "mean"] == 17.0  # with all weight on efficiency
    assert table.loc[("our", "SR"), "mean"] == 95.0  # over all preferences
    assert pd.isna(table.loc[("our", "frechet"), "mean"])  # nobody demonstrated
    assert table.loc[("state_reward,no_human", "SR"), "paper"] == 79.6  # in any order


def test_two_families_stand_beside_each_other_and_beside_the_paper(tmp_path):
    for recipe, shift in (("none", 0.0), ("paper", 0.3)):
        for ablation in ("our", "baseline"):
            run = keep(tmp_path / f"{ablation}-{recipe}", ablation, 0, 1.1 + shift)
            (run / "config.yaml").write_text(yaml.safe_dump({"seed": 0, "ablated": ablation, "recipe": recipe}))
            words = [f"ablation={ablation}", f"recipe={recipe}", "seed=0"]
            (run / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(words))
    made = report.Report([tmp_path])
    agents = made.readable("table1")["agent"].tolist()
    families = {name: [f"{name}, recipe=none", f"{name}, recipe=paper"] for name in ("our", "baseline")}
    assert agents == [*families["baseline"], "paper: baseline agent", *families["our"], "paper: OUR"]
    assert made.sweep.agent in families["our"]
    assert made.sweep.baseline == made.sweep.agent.replace("our", "baseline")


def test_a_sweep_with_a_run_of_another_task_has_no_agent_without_preferences(tmp_path):
    keep(tmp_path / "0", "our", 0, 1.1)
    other = keep(tmp_path / "1", "baseline", 0, 1.1)
    (other / "evaluation" / "summary.csv").unlink()
    assert Sweep(tmp_path).without_preferences() is None
    assert "baseline" in set(report.Report([tmp_path]).tables["scores"]["setting"])


def test_a_report_into_a_run_leaves_the_runs_own_files(tmp_path):
    run = keep(tmp_path / "0", "our", 0, 1.1)
    (run / "times.json").write_text("{}")
    made = report.Report([run])
    made.tables = {"times": pd.DataFrame({"setting": ["our"], "runs": [1], "learning": [1.0]})}
    for figure, _ in report.FIGURES.values():
        setattr(made, figure, lambda: None)
    made.write(run)
    assert (run / "times.json").is_file()
    assert (run / "times.csv").is_file()


def test_a_run_in_other_scenes_than_the_front_is_told(tmp_path):
    run = keep(tmp_path / "0", "our", 0, 1.1)
    front = pd.DataFrame({"scene": [0, 0, 1, 1, 2, 2], "distance": [0.48, 2.0] * 3, "length": [7.0, 9.0] * 3})
    front.to_csv(run / "evaluation" / "exact_front.csv", index=False)
    sentence = "Run 0 drove in other scenes than those of the exact front."
    assert sentence in report.Report([tmp_path]).notes
    front.replace(7.0, 8.0).to_csv(run / "evaluation" / "exact_front.csv", index=False)
    assert sentence not in report.Report([tmp_path]).notes
    (run / "evaluation" / "episodes.csv").unlink()
    made = report.Report([tmp_path])
    for sentence in ("Run 0 keeps no evaluation/episodes.csv", "No Fig. 3 and 4: runs of our keep no"):
        assert any(sentence in note for note in made.notes)
    assert "table1" in made.tables
    assert made.trajectories() is None


def test_a_sweep_says_what_is_missing(tmp_path):
    keep(tmp_path / "0", "our", 0, 1.1)
    keep(tmp_path / "1", "our", 0, 1.2)
    unfinished = tmp_path / "2"
    unfinished.mkdir()
    (unfinished / "config.yaml").write_text("{seed: 1, ablated: our}")
    sweep = Sweep(tmp_path)
    assert sweep.runs["run"].tolist() == ["0"]
    assert sweep.notes[:3] == [
        "Run 2 (our, seed 1) has no evaluation.",
        "Run 1 repeats seed 0 of our: left out.",
        "A single seed has neither intervals nor tests: our.",
    ]
    assert any("No run keeps evaluation/exact_front.csv" in note for note in sweep.notes)


def test_the_plain_agent_comes_first_wherever_its_run_lies(tmp_path):
    for number, (tau, gamma) in enumerate([(0.2, 0.9), (0.1, 0.9), (0.1, 0.95)]):
        run = keep(tmp_path / f"{number}", "our", 0, 1.1)
        (run / "config.yaml").write_text(yaml.safe_dump({"seed": 0, "tau": tau, "gamma": gamma}))
    sweep = Sweep(tmp_path)
    assert sweep.settings == ["our", "tau=0.2", "gamma=0.95"]
    assert sweep.agent == "our"


def test_stars_are_corrected_and_no_interval_leaves_what_can_be(tmp_path):
    for seed, distance in DISTANCES.items():
        keep(tmp_path / f"{seed}", "our", seed, distance)
    summary, tests = Sweep(tmp_path).over_preferences()
    assert summary["min_human_distance"].tolist() == pytest.approx([1.3, 0.5])
    assert (summary["min_human_distance_low"] >= 0).all()
    row = tests[tests["metric"] == "min_human_distance"].iloc[0]
    first = list(DISTANCES.values())
    p = scipy.stats.ttest_1samp(first, 0.5).pvalue  # the other extreme has 0.5 with every seed
    assert row["p_seeds"] == pytest.approx(2 * p)  # time differs more surely, obstacles not at all
    assert tests.groupby("metric")["p_holm"].nunique().eq(1).all()  # in both orders


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (
            lambda run: (run / "config.yaml").unlink(),
            r"holds no runs: neither it nor a folder in it has a config\.yaml",
        ),
        (lambda run: (run / "evaluation" / "front.csv").unlink(), "None of the runs 0 is evaluated"),
        (lambda run: (run / "evaluation" / "front.csv").write_text(""), r"front\.csv cannot be read as a table"),
        (lambda run: (run / "evaluation" / "front.csv").write_text("a\n1"), r"front\.csv has no column utility"),
        (lambda run: drop(run / "evaluation" / "summary.csv"), r"summary\.csv has no column min_human_distance_low"),
        (lambda run: keep(run / "0", "our", 0, "far"), r"summary\.csv .* numbers in the column min_human_distance"),
    ],
)
def test_a_wrong_directory_ends_in_one_sentence(spoil, sentence, tmp_path, monkeypatch):
    run = keep(tmp_path / "0", "our", 0, 1.1) if "keep" not in spoil.__code__.co_names else tmp_path
    spoil(run)
    monkeypatch.setattr(sys, "argv", ["morlnav-report", str(tmp_path), "--output", str(tmp_path / "report")])
    with pytest.raises(SystemExit, match=sentence) as error:
        report.main()
    assert "\n" not in str(error.value)
    assert not (tmp_path / "report").exists()


def test_other_tasks_are_compared_by_utility_and_hypervolume(tmp_path):
    for number, (ablation, seed) in enumerate([("our", 0), ("our", 1), ("no_angle", 0), ("no_angle", 1)]):
        run = keep(tmp_path / f"{number}", ablation, seed, 1.0)
        (run / "evaluation" / "summary.csv").unlink()
        front = pd.read_csv(run / "evaluation" / "front.csv").assign(hypervolume=10.0 * number)
        front.to_csv(run / "evaluation" / "front.csv", index=False)
    made = report.Report([tmp_path])
    table = made.tables["comparisons"].set_index("score")
    assert table["difference"].to_dict() == {"utility": 0.0, "hypervolume": -20.0}
    assert sorted(made.tables) == ["comparisons", "scores"]
    assert made.write(tmp_path / "report").read_text().count("png") == 1
