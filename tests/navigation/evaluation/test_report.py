import pandas as pd
import pytest
import torch

from morlnav.data import preference_edges
from morlnav.evaluation import hypervolume
from morlnav.navigation.envs import Efficiency, default_objectives
from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes, write_report
from morlnav.navigation.evaluation.report import default_reference, front_table


def drive(observation, preference):
    return torch.stack([0.2 + 0.3 * preference[:, -1], 2 * observation[:, 1].clamp(-1.5, 1.5)], -1)


@pytest.mark.parametrize("names", [("distance", "efficiency"), ("demo", "distance", "efficiency")])
def test_a_report_has_all_files_and_totals(tmp_path, names):
    terms = {"demo": Efficiency(-1.0), **default_objectives()}
    terms = {name: terms[name] for name in ("baseline", *names)}
    rollouts = evaluate_policy(
        drive, evaluation_scenes(4), preference_edges(len(names), 2), objectives=terms, max_steps=60
    )
    references = rollouts.path[0]
    table = write_report(rollouts, tmp_path / "new" / "report", tuple(terms), references=references)

    files = sorted(path.name for path in (tmp_path / "new" / "report").iterdir())
    csv = ["episodes.csv", "fidelity.csv", "front.csv", "summary.csv"]
    assert files == sorted([*csv, "metrics.png", "table.md", "trajectories.png"])
    episodes, _, front, summary = (pd.read_csv(tmp_path / "new" / "report" / name) for name in csv)
    assert len(episodes) == 4 * len(summary) == 4 * len(front) == rollouts.batch_size.numel()

    lines = table.splitlines()
    assert (tmp_path / "new" / "report" / "table.md").read_text(encoding="utf-8") == table + "\n"
    widths = {line.count("|") for line in lines if line.startswith("|")}
    assert len(widths) == 1
    total = next(line for line in lines if "**all**" in line)
    assert f" {100 * episodes['success'].mean():.1f} |" in total
    assert "Hypervolume" in lines[-1]


def test_the_front_holds_mean_returns_and_their_quality():
    rollouts = evaluate_policy(drive, evaluation_scenes(3), preference_edges(2, 2), max_steps=20)
    front = front_table(rollouts, ("baseline", "distance", "efficiency"))
    returns = rollouts.reward.double().sum(2).mean(1)
    assert front["return_efficiency"].tolist() == pytest.approx((-10 * rollouts.steps.double().mean(1)).tolist())
    expected = returns[:, 0] + (returns[:, 1:] * rollouts.preference[:, 0]).sum(-1)
    assert front["utility"].tolist() == pytest.approx(expected.tolist())
    assert front["expected_utility"].tolist() == pytest.approx([expected.mean().item()] * 3)
    assert front["hypervolume"][0] == pytest.approx(hypervolume(returns, default_reference(3, 2)))


def test_a_single_objective_needs_no_figures(tmp_path):
    terms = {name: default_objectives()[name] for name in ("baseline", "efficiency")}
    rollouts = evaluate_policy(drive, evaluation_scenes(2), torch.ones(1, 1), objectives=terms, max_steps=5)
    table = write_report(rollouts, tmp_path, tuple(terms))
    assert "2 episodes: 1 preference in 2 scenes" in table
    assert not list(tmp_path.glob("*.png"))


def test_wrong_names_are_explained(tmp_path):
    rollouts = evaluate_policy(drive, evaluation_scenes(1), torch.eye(2), max_steps=2)
    with pytest.raises(ValueError, match="3 entries"):
        write_report(rollouts, tmp_path / "report", ("baseline",))
    with pytest.raises(ValueError, match="3 entries"):
        front_table(rollouts, ("baseline",))
    with pytest.raises(ValueError, match="reference point"):
        write_report(rollouts, tmp_path / "report", reference_point=torch.zeros(2))
    assert not (tmp_path / "report").exists()
