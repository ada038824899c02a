import pytest
import torch

from morlnav.navigation.evaluation import Outcome, evaluate_policy, evaluation_scenes, frechet_distance, reference_paths
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import PymunkWorld, Scene, SceneSampler, TensorWorld


def drive(oracle, scenes, **options):
    return evaluate_policy(lambda observation, _: oracle(observation), scenes, torch.zeros(1, 2), **options)[0]


def around_human(rollouts):
    """Distance to the human in m, and angle at the human from the goal to the robot in rad, both ``[S, T + 1]``."""
    relative = rollouts.pose[..., :2] - rollouts.scene.human.unsqueeze(1)
    return relative.norm(dim=-1), torch.atan2(relative[..., 1], relative[..., 0])


def observe(pose, goal, human):
    world = TensorWorld()
    empty = torch.zeros(1, 0, 5)
    world.reset(Scene(start=pose[None], goal=goal[None], human=human[None], boxes=empty, batch_size=[1]))
    return world.observe()[0]


@pytest.fixture(scope="module")
def scenes():
    return evaluation_scenes(50, sampler=SceneSampler(num_boxes=0))


@pytest.fixture(scope="module")
def oracle():
    return CircumnavigationOracle()


@pytest.fixture(scope="module")
def rollouts(oracle, scenes):
    return drive(oracle, scenes)


def test_every_goal_is_reached_and_the_human_is_passed_at_one_metre(rollouts):
    assert (rollouts.outcome == Outcome.GOAL).all()
    closest = around_human(rollouts)[0].amin(1)
    assert ((closest > 0.95) & (closest < 1.05)).all()


def test_the_orbit_is_half_a_circle_of_one_metre_with_the_human_on_the_right(rollouts):
    distance, angle = around_human(rollouts)
    orbit = (angle > 0.1) & (angle < torch.pi - 0.1) & (distance < 1.2)
    assert (orbit.sum(1) >= 25).all()
    assert (distance[orbit] - 1).abs().max() < 0.03
    bearing = angle + torch.pi - rollouts.pose[..., 2]
    assert (bearing[orbit].sin() < -0.97).all()
    assert angle[distance < 1.2].cos().min() < -0.99  # entered in front of the human, left on the line to the goal
    assert angle[distance < 1.2].cos().max() > 0.99


def test_approach_and_departure_are_straight(rollouts):
    distance, _ = around_human(rollouts)
    lateral = rollouts.pose[..., 1].abs()  # sampled starts, humans and goals lie on the x axis
    assert lateral[distance > 1.05].max() < 0.04


def test_corners_are_sharp_and_the_speed_is_full_elsewhere(rollouts):
    slow = rollouts.action[..., 0] < 0.49
    driven = torch.arange(slow.shape[1]) < rollouts.steps.unsqueeze(1)
    assert ((slow & driven).sum(1) <= 15).all()
    distance, angle = around_human(rollouts)
    near_corner = (distance < 1.02) & (angle > torch.pi - 0.1)
    assert (rollouts.pose[..., 1].abs()[near_corner] < 0.1).all()


def test_orbit_begins_and_ends_on_the_spot(oracle):
    goal, human = torch.tensor([8.0, 0.0]), torch.tensor([4.0, 0.0])
    begin = oracle(observe(torch.tensor([3.0, 0.0, 0.0]), goal, human))
    end = oracle(observe(torch.tensor([5.0, 0.0, -torch.pi / 2]), goal, human))
    for action in (begin, end):
        assert action[0] < 1e-3
        assert action[1] == pytest.approx(torch.pi)
    north = oracle(observe(torch.tensor([4.0, 1.0, 0.0]), goal, human))
    assert torch.allclose(north, torch.tensor([0.5, -0.5]), atol=1e-4)  # one radian per metre, clockwise


@pytest.mark.parametrize("radius", [0.6, 2.5])
def test_the_radius_is_free(radius, scenes):
    rollouts = drive(CircumnavigationOracle(radius), scenes[:10])
    assert (rollouts.outcome == Outcome.GOAL).all()
    assert (around_human(rollouts)[0].amin(1) - radius).abs().max() < 0.03


def test_counter_clockwise_is_the_mirror_image(oracle):
    scene = evaluation_scenes(5, sampler=SceneSampler(num_boxes=0))
    flip = torch.tensor([1.0, -1.0, -1.0])
    mirrored = Scene(
        start=scene.start * flip,
        goal=scene.goal * flip[:2],
        human=scene.human * flip[:2],
        boxes=scene.boxes,
        batch_size=[5],
    )
    right, left = drive(oracle, scene), drive(CircumnavigationOracle(clockwise=False), mirrored)
    assert torch.allclose(right.pose[..., :2] * flip[:2], left.pose[..., :2], atol=1e-3)


def test_it_reaches_the_goal_from_anywhere():
    generator = torch.Generator().manual_seed(0)
    start = torch.rand(400, 3, generator=generator) * torch.tensor([12.0, 8.0, 6.28]) + torch.tensor([-2.0, -4.0, 0.0])
    human, goal = torch.tensor([4.0, 0.0]), torch.tensor([8.0, 0.0])
    start = start[((start[:, :2] - human).norm(dim=1) > 0.5) & ((start[:, :2] - goal).norm(dim=1) > 0.4)]
    size = len(start)
    boxes = torch.zeros(size, 0, 5)
    scene = Scene(start=start, goal=goal.expand(size, 2), human=human.expand(size, 2), boxes=boxes, batch_size=[size])
    assert (drive(CircumnavigationOracle(), scene).outcome == Outcome.GOAL).all()


def test_it_recovers_when_it_is_pushed_off_the_circle(oracle, scenes):
    generator = torch.Generator().manual_seed(0)
    push = torch.zeros(len(scenes), 2)
    step = 0

    def disturbed(observation, _):
        nonlocal push, step
        if step % 10 == 0:
            push = torch.randn(len(scenes), 2, generator=generator) * torch.tensor([0.25, 3.14])
        step += 1
        action = oracle(observation) + push * (step % 10 < 3)
        return action.clamp(torch.tensor([0.0, -torch.pi]), torch.tensor([0.5, torch.pi]))

    rollouts = evaluate_policy(disturbed, scenes, torch.zeros(1, 2), drop_finished=False)[0]
    assert (rollouts.outcome == Outcome.GOAL).all()
    distance, angle = around_human(rollouts)
    orbit = (angle > 0.4) & (angle < 2.7) & (distance < 1.5)
    assert orbit.any(1).all()
    assert 0.95 < distance[orbit].mean() < 1.05
    assert 0.01 < distance[orbit].std() < 0.12


def test_both_engines_drive_the_same_path(rollouts, scenes, oracle):
    slow = drive(oracle, scenes[:2], world=PymunkWorld())
    assert (slow.outcome == Outcome.GOAL).all()
    assert frechet_distance(slow.unsqueeze(0).path[0], rollouts[:2].unsqueeze(0).path[0]).max() < 0.03


def test_a_batch_acts_as_its_rows_and_boxes_do_not_matter(oracle):
    world = TensorWorld()
    world.reset(SceneSampler()(12, generator=torch.Generator().manual_seed(0)))
    observation = world.observe()
    batch = oracle(observation.reshape(3, 4, 34)).reshape(12, 2)
    assert torch.allclose(batch, torch.stack([oracle(row) for row in observation]), atol=1e-6)
    blind = torch.cat([observation[:, :4], torch.zeros(12, 30)], -1)
    assert torch.equal(oracle(blind), oracle(observation))


def test_reference_paths_ignore_boxes_and_refuse_a_policy_that_misses_the_goal(oracle):
    scenes = evaluation_scenes(3)
    paths = reference_paths(scenes, oracle)
    for path, scene in zip(paths, scenes, strict=True):
        assert torch.equal(path[0], scene.start[:2])
        assert (path[-1] - scene.goal).norm() < 0.36
        assert (path - scene.human).norm(dim=-1).min() == pytest.approx(1, abs=0.03)
    with pytest.raises(ValueError, match="misses the goal in 3 of 3"):
        reference_paths(scenes, oracle, max_steps=5)


def test_observations_without_the_human_are_refused(oracle):
    with pytest.raises(ValueError, match="human"):
        oracle(torch.zeros(5, 32))


@pytest.mark.parametrize("name", ["radius", "speed", "band", "sector", "max_turn", "step_time"])
def test_impossible_numbers_are_refused(name):
    with pytest.raises(ValueError, match=name):
        CircumnavigationOracle(**{name: 0.0})
