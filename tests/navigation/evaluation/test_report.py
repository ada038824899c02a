import pandas as pd
import pytest
import torch

from morlnav.data import preference_edges
from morlnav.evaluation import reference_from_bounds
from morlnav.navigation.envs import Efficiency, NavigationEnv, default_objectives
from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes, write_report


def drive(observation, preference):
    return torch.stack([0.2 + 0.3 * preference[:, -1], 2 * observation[:, 1].clamp(-1.5, 1.5)], -1)


def spin(observation, preference):
    return torch.tensor([0.0, torch.pi]).expand(len(observation), 2)


class Calm:
    """A penalty on turning that is larger than those of the default rewards."""

    def __call__(self, transition):
        return -20 * transition.action[:, 1].abs() / torch.pi

    def bounds(self, reach):
        return -20.0, 0.0


@pytest.mark.parametrize("names", [("distance", "efficiency"), ("demo", "distance", "efficiency")])
def test_a_report_has_all_files_and_totals(tmp_path, names):
    terms = {"demo": Efficiency(-1.0), **default_objectives()}
    terms = {name: terms[name] for name in ("baseline", *names)}
    rollouts = evaluate_policy(
        drive, evaluation_scenes(4), preference_edges(len(names), 2), objectives=terms, max_steps=60
    )
    references = rollouts.path[0]
    point = reference_from_bounds(NavigationEnv(objectives=terms).reward_bounds, 60)
    table = write_report(
        rollouts, tmp_path / "new" / "report", tuple(terms), references=references, reference_point=point
    )

    files = sorted(path.name for path in (tmp_path / "new" / "report").iterdir())
    csv = ["episodes.csv", "fidelity.csv", "front.csv", "summary.csv"]
    more = ["exact_front.csv", "exact_front.png", "possible.csv"] if {"distance", "efficiency"} <= set(names) else []
    assert files == sorted([*csv, *more, "front.png", "metrics.png", "table.md", "trajectories.png"])
    episodes, _, front, summary = (pd.read_csv(tmp_path / "new" / "report" / name) for name in csv)
    assert len(episodes) == 4 * len(summary) == 4 * len(front) == rollouts.batch_size.numel()

    lines = table.splitlines()
    assert (tmp_path / "new" / "report" / "table.md").read_text(encoding="utf-8") == table + "\n"
    widths = {line.count("|") for line in lines if line.startswith("|")}
    assert len(widths) == 1
    total = next(line for line in lines if "**all**" in line)
    assert f" {100 * episodes['success'].mean():.1f} |" in total
    assert f"hypervolume {front['hypervolume'][0]:.4g} above" in lines[-1]
    assert front["hypervolume"][0] > 0
    assert front["reference_efficiency"].tolist() == [-10.0 * 61] * len(front)


def test_the_worst_that_an_objective_of_ones_own_can_pay_still_has_a_volume(tmp_path):
    terms = default_objectives() | {"calm": Calm()}
    rollouts = evaluate_policy(spin, evaluation_scenes(2), torch.eye(3), objectives=terms)
    point = reference_from_bounds(NavigationEnv(objectives=terms).reward_bounds, 250)
    write_report(rollouts, tmp_path, tuple(terms), reference_point=point)
    front = pd.read_csv(tmp_path / "front.csv")
    assert front["return_calm"][0] == pytest.approx(-20 * 250, rel=1e-3)
    assert front["hypervolume"][0] > 0


def test_a_reward_without_a_least_value_leaves_out_the_hypervolume_and_says_why(tmp_path):
    terms = default_objectives() | {"free": lambda transition: -transition.action[:, 0]}
    rollouts = evaluate_policy(drive, evaluation_scenes(1), torch.eye(3), objectives=terms, max_steps=5)
    point = reference_from_bounds(NavigationEnv(objectives=terms).reward_bounds, 5)
    table = write_report(rollouts, tmp_path, tuple(terms), reference_point=point)
    assert table.count("No hypervolume: some rewards have no known least value; give evaluation.reference") == 1
    assert pd.read_csv(tmp_path / "front.csv")["hypervolume"].isna().all()


def test_what_cannot_be_ranked_is_not_shown(tmp_path):
    rollouts = evaluate_policy(spin, evaluation_scenes(1), torch.eye(2), max_steps=5)
    assert "nan" not in write_report(rollouts, tmp_path)


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
    with pytest.raises(ValueError, match="reference point"):
        write_report(rollouts, tmp_path / "report", reference_point=torch.zeros(2))
    assert not (tmp_path / "report").exists()
