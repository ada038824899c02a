"""A policy is measured where somebody was recorded."""

import sys
from pathlib import Path

import pandas as pd
import pytest
import torch
import yaml

from morlnav.commands.evaluate import evaluate_route, main, use_recorded_scenes, use_world
from morlnav.navigation.demonstrations import record_demonstrations, save_demonstrations
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import PymunkWorld, SceneSampler
from morlnav.runs import Run

RUN = Path(__file__).parents[2] / "results" / "two_styles" / "seed_0"
OUT_OF_THE_WAY = [1000.0, 1000.0, 0.1, 0.1, 0.0]  # where a scene has fewer boxes than others of its folder


@pytest.fixture(scope="module")
def recorded():
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(num_boxes=2), 2)
    data["scene", "boxes"][data["episode"] == 1, 1] = torch.tensor(OUT_OF_THE_WAY)
    return data


def evaluate(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["morlnav-evaluate", str(RUN), *map(str, words)])
    main()


def test_a_run_is_evaluated_in_recorded_scenes(recorded, tmp_path, monkeypatch, capsys):
    save_demonstrations(recorded, tmp_path / "mine")
    evaluate(monkeypatch, "--scenes", tmp_path / "mine", "--steps", 1, "--output", tmp_path / "out")
    assert "4 episodes: 2 preferences in 2 scenes" in capsys.readouterr().out
    episodes = pd.read_csv(tmp_path / "out" / "episodes.csv")
    assert (episodes["success"] == 1).all()
    # Nobody gets there on less than the straight line, and the policy of efficiency hardly drives more.
    scenes = recorded["scene"][recorded["step"] == 0]
    straight = (scenes["goal"] - scenes["start"][:, :2]).norm(dim=-1) - 0.35
    fastest = episodes[episodes["lambda_efficiency"] == 1].sort_values("scene")["path_length"]
    torch.testing.assert_close(torch.tensor(fastest.to_numpy()), straight.double(), rtol=0.1, atol=0)
    assert {"table.md", "front.png", "trajectories.png"} <= {file.name for file in (tmp_path / "out").iterdir()}


def test_so_are_rooms(recorded, tmp_path):
    save_demonstrations(recorded[recorded["episode"] == 0], tmp_path / "mine")
    (tmp_path / "rooms.yaml").write_text("hall: {distance: 1}")
    run = Run(RUN)
    use_recorded_scenes(run, tmp_path / "mine")
    rooms = pd.read_csv(evaluate_route(run, tmp_path / "rooms.yaml", {0: "hall"}, tmp_path))
    assert rooms["episodes"].tolist() == [1, 1]


def test_another_world_drives_alike(recorded, tmp_path, monkeypatch):
    save_demonstrations(recorded, tmp_path / "mine")
    outcomes = []
    for world in ("tensor", "pymunk"):
        words = ["--scenes", tmp_path / "mine", "--world", world, "--steps", 1, "--output", tmp_path / world]
        evaluate(monkeypatch, *words)
        outcomes.append(pd.read_csv(tmp_path / world / "episodes.csv"))
    pd.testing.assert_frame_equal(*outcomes, atol=0.05)


def test_what_was_learned_in_one_world_counts_in_another():
    run = Run(RUN.parents[1] / "default")
    use_world(run, "pymunk")
    assert isinstance(run.evaluation.env.world, PymunkWorld)
    assert list(run.evaluation.demonstrators) == ["demo"]


def test_a_run_without_a_world_of_its_own_takes_the_named_one():
    run = Run(RUN)
    run.config["env"]["world"] = None
    use_world(run, "pymunk")
    assert isinstance(run.evaluation.env.world, PymunkWorld)


def test_only_who_navigates_drives_in_a_world(tmp_path):
    config = yaml.safe_load((RUN / "config.yaml").read_text())
    config["evaluation"] = {"_target_": "morlnav.evaluation.Evaluation", "episodes": 2}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
    with pytest.raises(ValueError, match="holds no navigating policy"):
        use_world(Run(tmp_path), "pymunk")


def blocked(data):
    data["scene", "boxes"][data["episode"] == 1, 0] = torch.tensor([0.0, 0.0, 0.5, 0.5, 0.0])


def distant(data):
    data["scene", "goal"][:] = torch.tensor([40.0, 0.0])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (blocked, "mine: Episode 1: The start lies inside a box"),
        (distant, r"mine: Episode 0: the goal is 40.0 m away, but after the 250 steps of an episode .* 25.4 m away"),
    ],
)
def test_a_scene_that_the_robot_cannot_drive_in_is_named(recorded, tmp_path, monkeypatch, change, sentence):
    data = recorded.clone()
    change(data)
    save_demonstrations(data, tmp_path / "mine")
    with pytest.raises(SystemExit, match=sentence):
        evaluate(monkeypatch, "--scenes", tmp_path / "mine")


def test_other_folders_and_contradictions_are_refused(tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit, match=r"holds no demonstrations: there is no demonstrations\.json"):
        evaluate(monkeypatch, "--scenes", tmp_path)
    for words in (["--episodes", 3], ["--seed", 1]):
        with pytest.raises(SystemExit):
            evaluate(monkeypatch, "--scenes", tmp_path, *words)
        assert "as many as were recorded; leave out --episodes and --seed" in capsys.readouterr().err


def test_a_planned_path_is_the_best_known_one_under_a_learned_reward(tmp_path):
    tables = {}
    for plan in (False, True):
        run = Run(RUN.parents[1] / "default", changes={"episodes": 1, "steps": 1, "seed": 3, "plan": plan})
        run.evaluation.report(run.policy, tmp_path / str(plan))
        tables[plan] = pd.read_csv(tmp_path / str(plan) / "possible.csv").set_index("lambda_demo")
    assert tables[True].loc[1.0, "best_utility"] > tables[False].loc[1.0, "best_utility"] + 1
    assert tables[True].loc[1.0, "regret"] > -5  # a path on a grid, beside a drive that knows none
    head, *_, demo, _, _, total = (tmp_path / "True" / "table.md").read_text().split("\n\n")[0].splitlines()
    assert [name.strip() for name in head.split("|")][-3:-1] == ["excess %", "regret"]
    assert demo.split("|")[-2].strip() == f"{tables[True].loc[1.0, 'regret']:.1f}"
    assert total.split("|")[-2].strip() == f"{tables[True]['regret'].mean():.1f}"


def test_what_is_possible_is_the_same_while_a_policy_learns_and_in_its_report(tmp_path):
    run = Run(RUN, changes={"seed": 3, "steps": 1})
    metrics = run.evaluation.measure(run.policy, episodes=3, steps=1)
    run.evaluation.use(run.evaluation.scenes(3, seed=4))
    run.evaluation.report(run.policy, tmp_path)
    reported = pd.read_csv(tmp_path / "possible.csv").set_index("lambda_distance")
    regrets = {1.0: metrics["regret/distance=1,efficiency=0"], 0.0: metrics["regret/distance=0,efficiency=1"]}
    assert reported["regret"].to_dict() == pytest.approx(regrets, abs=0.01)
    for name in ("front_share", "mean_excess"):
        assert reported[name].tolist() == pytest.approx([metrics[name]] * 2)
