import math

import pytest
import torch

from morlnav.navigation.evaluation import (
    Outcome,
    Rollouts,
    episode_metrics,
    evaluate_policy,
    evaluation_scenes,
    frechet_distance,
)
from morlnav.navigation.evaluation.metrics import path_length
from morlnav.navigation.world import Scene


@pytest.fixture
def rollouts():
    """Two preferences in one free scene, goal 3 m ahead: a straight success of 4 steps, and a collision after 2."""
    scene = Scene(
        start=torch.zeros(1, 3),
        goal=torch.tensor([[3.0, 0.0]]),
        human=torch.tensor([[1.0, 1.5]]),
        boxes=torch.zeros(1, 0, 5),
        batch_size=[1],
    )
    pose = torch.zeros(2, 1, 5, 3)
    pose[0, 0, :, 0] = torch.tensor([0.0, 1.0, 2.0, 2.5, 3.0])
    pose[1, 0, :, 1] = torch.tensor([0.0, 1.0, 2.0, 2.0, 2.0])
    action = torch.zeros(2, 1, 4, 2)
    action[0, 0, :, 0] = torch.tensor([0.5, 0.4, 0.0, 0.3])
    action[1, 0, :2, 0] = 0.5
    reward = torch.zeros(2, 1, 4, 3)
    reward[0, 0] = torch.tensor([[10.0, -1.0, -10.0]] * 4)
    reward[1, 0, :2] = torch.tensor([[-5.0, -2.0, -10.0]] * 2)
    return Rollouts(
        pose=pose,
        clearance=torch.tensor([[[4.0, 1.0, 0.5, 0.7, 0.9]], [[4.0, 2.0, 0.2, 0.2, 0.2]]]),
        action=action,
        reward=reward,
        steps=torch.tensor([[4], [2]]),
        duration=torch.tensor([[0.8], [0.4]]),
        outcome=torch.tensor([[Outcome.GOAL], [Outcome.BOX]]),
        preference=torch.tensor([[[0.3, 0.7]], [[1.0, 0.0]]]),
        scene=scene.expand(2, 1),
        batch_size=[2, 1],
    )


def test_every_metric_by_hand(rollouts):
    frame = episode_metrics(rollouts, personal_space=1.6)
    assert frame["preference"].tolist() == [0, 1]
    assert frame["lambda_distance"].tolist() == [0.3, 1.0]
    assert frame["lambda_efficiency"].tolist() == [0.7, 0.0]
    assert frame["success"].tolist() == [True, False]
    assert frame["collision_box"].tolist() == [False, True]
    assert not frame["collision_human"].any()
    assert not frame["timeout"].any()
    assert frame["min_human_distance"].tolist() == pytest.approx([1.5, math.hypot(1, 0.5)], abs=1e-5)
    assert frame["min_obstacle_distance"].tolist() == pytest.approx([0.5, 0.2])
    assert frame["navigation_time"].tolist() == pytest.approx([0.8, 0.4])
    assert frame["path_length"].tolist() == pytest.approx([3.0, 2.0])
    assert frame["shortest_path"].tolist() == pytest.approx([2.65, 2.65])
    assert frame["spl"].tolist() == pytest.approx([2.65 / 3, 0.0], abs=1e-5)
    assert frame["time_ratio"].tolist() == pytest.approx([0.8 * 0.5 / 2.65, 0.4 * 0.5 / 2.65], abs=1e-5)
    assert frame["human_on_right"].tolist() == [0.0, 1.0]  # below the human going east, left of it going north
    # Speeds 0.5, 0.4, 0, 0.3: second differences -0.3 and 0.7, over (0.2 s)².
    assert frame["mean_jerk"][0] == pytest.approx(0.5 / 0.04, abs=1e-4)
    assert math.isnan(frame["mean_jerk"][1])
    assert frame["stalled_time"].tolist() == pytest.approx([0.2, 0.0])
    # Distances after each step: 1.5, 1.80, 2.12, 2.5 m, and 1.12, 1.12 m.
    assert frame["personal_space"].tolist() == pytest.approx([0.75, 0.0])
    assert frame["return_baseline"].tolist() == [40.0, -10.0]
    assert frame["return_distance"].tolist() == [-4.0, -4.0]
    assert frame["return_efficiency"].tolist() == [-40.0, -20.0]
    assert "frechet" not in frame


def test_frechet_distance_ignores_the_padding(rollouts):
    reference = torch.tensor([[0.0, 0.0], [1.0, 0.4], [2.0, 0.0], [3.0, 0.0]])
    frame = episode_metrics(rollouts, references=[reference])
    # Row 0: 0.5 m at x = 2.5. Row 1: its end (0, 2) against the reference's end (3, 0).
    assert frame["frechet"].tolist() == pytest.approx([0.5, math.hypot(3, 2)], abs=1e-5)
    assert frame["frechet_free"].tolist() == frame["frechet"].tolist()


@pytest.mark.parametrize(("y", "free"), [(1.2, True), (1.0, False)])
def test_the_frechet_distance_is_told_apart_where_a_box_is_in_the_references_way(rollouts, y, free):
    reference = torch.tensor([[0.0, 0.0], [1.0, 0.4], [2.0, 0.0], [3.0, 0.0]])
    box = torch.tensor([[[1.5, y, 0.5, 0.5, 0.0]]])  # 0.3 m or 0.1 m from the reference; the robot's radius is 0.18 m
    old = rollouts.scene[0]
    rollouts.scene = Scene(start=old.start, goal=old.goal, human=old.human, boxes=box, batch_size=[1]).expand(2, 1)
    assert episode_metrics(rollouts, references=[reference])["frechet_free"].notna().tolist() == [free, free]


def test_frechet_distance_agrees_with_the_recursion():
    generator = torch.Generator().manual_seed(0)
    first, second = torch.rand(2, 6, 2, generator=generator).cumsum(1)
    gap = torch.cdist(first, second)

    def coupling(i, j):
        if i == j == 0:
            return gap[0, 0]
        before = [(a, b) for a, b in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if min(a, b) >= 0]
        return max(gap[i, j], min(coupling(a, b) for a, b in before))

    assert frechet_distance([first], [second]).item() == pytest.approx(coupling(5, 5).item(), abs=1e-5)


def test_path_length_follows_the_arc():
    pose = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, torch.pi / 2], [1.0, 3.0, torch.pi / 2]])
    assert path_length(pose).item() == pytest.approx(math.pi / 2 + 2, abs=1e-5)


def test_driven_length_is_speed_times_time():
    rollouts = evaluate_policy(
        lambda o, p: torch.tensor([[0.4, 0.9]]).expand(len(o), 2), evaluation_scenes(2), torch.eye(2), max_steps=10
    )
    frame = episode_metrics(rollouts)
    assert frame["path_length"].tolist() == pytest.approx([0.8] * 4, abs=1e-4)


def test_known_shortest_paths_are_taken(rollouts):
    assert episode_metrics(rollouts, shortest=torch.tensor([5.0]))["shortest_path"].tolist() == [5.0, 5.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rewards": ["baseline", "distance"]}, "3 entries"),
        ({"references": []}, "reference path"),
        ({"shortest": torch.ones(2)}, "shortest path"),
    ],
)
def test_wrong_arguments_are_explained(rollouts, arguments, message):
    with pytest.raises(ValueError, match=message):
        episode_metrics(rollouts, **arguments)
