import math

import pytest
import torch

from morlnav.navigation.evaluation import (
    Outcome,
    PathPlanner,
    evaluation_scenes,
    frechet_distance,
    reference_paths,
    shortest_path,
)
from morlnav.navigation.evaluation.pose_grid import PoseGrid
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import Lidar, Scene, SceneSampler, TensorWorld


@pytest.fixture(scope="module")
def scenes():
    return evaluation_scenes(3, seed=5, sampler=SceneSampler(num_boxes=0, distance=(6.0, 8.0)))


def constant(value):
    return lambda observation, action: torch.full_like(action[:, 0], value)


def test_a_reward_for_the_demonstration_leads_around_the_human(scenes, ideal):
    plan = PathPlanner()(ideal, scenes[0])
    reference = reference_paths(scenes[:1], CircumnavigationOracle())
    assert plan.outcome == Outcome.GOAL
    assert plan.human_on_right
    assert 0.9 < plan.min_human_distance < 1.1
    assert frechet_distance([plan.path], reference).item() < 0.25


def test_its_mirror_image_leads_around_the_other_side(scenes, ideal):
    def mirrored(observation, action):
        flip = torch.ones(34)
        flip[[1, 3]] = -1
        return ideal(observation * flip, action)

    plan = PathPlanner()(mirrored, scenes[0])
    assert not plan.human_on_right
    assert 0.9 < plan.min_human_distance < 1.1


@pytest.mark.parametrize("index", range(3))
def test_a_constant_reward_leads_along_the_shortest_path(scenes, index):
    plan = PathPlanner()(constant(0.7), scenes[index])
    length = plan.path.diff(dim=0).norm(dim=-1).sum().item()
    assert plan.outcome == Outcome.GOAL
    assert length == pytest.approx(shortest_path(scenes[index : index + 1]).item(), rel=0.03)


def test_boxes_are_avoided_and_the_frame_does_not_matter():
    boxes = torch.tensor([[1.5, 0.0, 0.3, 0.6, 0.0], [4.5, -0.7, 0.3, 0.9, 0.2]])
    scene = Scene(
        start=torch.tensor([0.0, 0.0, 0.0]),
        goal=torch.tensor([6.0, 0.0]),
        human=torch.tensor([3.0, 1.5]),
        boxes=boxes,
        batch_size=[],
    )
    angle, shift = torch.tensor(2.0), torch.tensor([3.0, -5.0])
    turn = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])

    def moved(points):
        return points @ turn.T + shift

    elsewhere = Scene(
        start=torch.cat([moved(scene.start[:2]), angle.reshape(1)]),
        goal=moved(scene.goal),
        human=moved(scene.human),
        boxes=torch.cat([moved(boxes[:, :2]), boxes[:, 2:4], boxes[:, 4:] + angle], -1),
        batch_size=[],
    )
    planner = PathPlanner(spacing=0.15)
    here, there = planner(constant(0.8), scene), planner(constant(0.8), elsewhere)
    assert here.outcome == there.outcome == Outcome.GOAL
    grid = PoseGrid(scene, TensorWorld())
    assert not grid.touches(here.path).any()
    length = [plan.path.diff(dim=0).norm(dim=-1).sum().item() for plan in (here, there)]
    assert length[0] == pytest.approx(shortest_path(scene.unsqueeze(0)).item(), rel=0.06)
    assert length[1] == pytest.approx(length[0], rel=0.03)


def test_a_reward_that_pays_for_every_step_never_arrives(scenes, ideal):
    plan = PathPlanner(offset=1.0, spacing=0.2, max_steps=150)(ideal, scenes[0])
    assert plan.outcome == Outcome.TIMEOUT


def test_the_grid_sees_what_the_world_sees():
    scene = evaluation_scenes(1, seed=3)[0]
    world = TensorWorld()
    grid = PoseGrid(scene, world, spacing=0.5)
    point = grid.point[grid.free]
    for heading in (0, 4, 29):
        many = scene.expand(len(point)).clone()
        angle = torch.full_like(point[:, :1], heading * 2 * math.pi / 30)
        world.reset(many)
        world.pose = grid.to_world(torch.cat([point, angle], -1))
        assert torch.allclose(grid.observation(heading)[:, 4:], world.observe()[:, 4:], atol=0.05)
        assert torch.allclose(grid.observation(heading)[:, :4], world.observe()[:, :4], atol=1e-4)


def test_the_reward_may_be_blind_to_the_human(scenes):
    widths = set()

    def blind(observation, action):
        widths.add(observation.shape[1])
        return action[:, 0]

    PathPlanner(spacing=0.3, max_steps=20, observe_human=False)(blind, scenes[0])
    assert widths == {32}


def test_impossible_problems_are_explained(scenes):
    with pytest.raises(ValueError, match="one scene at a time"):
        PathPlanner()(constant(0.5), scenes)
    coarse = TensorWorld(lidar=Lidar(rays=720, sectors=8))
    with pytest.raises(ValueError, match="at least 10 sectors"):
        PathPlanner(world=coarse)(constant(0.5), scenes[0])
