"""Both engines, driven side by side through whole episodes, with resets, restarts and bodies of the user's own."""

import copy
import pickle

import pymunk
import pytest
import torch

from morlnav.navigation.world import PymunkWorld, SceneSampler, TensorWorld
from morlnav.navigation.world.pymunk import ROBOT_FILTER, Kind

ENGINES = [TensorWorld, PymunkWorld]


def random_actions(steps, batch, generator):
    action = torch.rand(steps, batch, 2, generator=generator)
    return action * torch.tensor([0.5, 2 * torch.pi]) - torch.tensor([0.0, torch.pi])


def seek_goal(world, noise):
    """Turn toward the goal while driving, with noise so that not all robots take the same way."""
    turn = (2 * world.observe()[:, 1] + noise[:, 1]).clamp(-torch.pi, torch.pi)
    return torch.stack([0.5 - 0.2 * noise[:, 0].abs(), turn], -1)


def assert_same_scans(ours, theirs):
    # Rays that graze an edge may fall either way in single precision; all else agrees.
    assert ((ours - theirs).abs() > 1e-3).float().mean() < 2e-3


def assert_same_contacts(ours, theirs):
    for name in ("human", "box", "goal"):
        assert torch.equal(getattr(ours, name), getattr(theirs, name)), name


@pytest.mark.parametrize("num_boxes", [0, 3])
def test_both_engines_agree_over_random_episodes(num_boxes):
    generator = torch.Generator().manual_seed(num_boxes)
    scene = SceneSampler(num_boxes=num_boxes)(12, generator=generator)
    tensor, pymunk_ = TensorWorld(), PymunkWorld()
    for world in (tensor, pymunk_):
        world.reset(scene)
    for t, action in enumerate(random_actions(250, 12, generator)):
        assert_same_contacts(tensor.step(action), pymunk_.step(action))
        torch.testing.assert_close(tensor.pose[:, :2], pymunk_.pose[:, :2], atol=1e-4, rtol=0)
        if t % 50 == 0:
            assert_same_scans(tensor.scan(), pymunk_.scan())
    for i, pose in enumerate(pymunk_.pose.tolist()):
        robot = next(shape.body for shape in pymunk_.space(i).shapes if shape.collision_type == Kind.ROBOT)
        assert robot.position == pytest.approx(pose[:2], abs=1e-4)


def test_both_engines_agree_on_the_way_to_the_goal_with_new_scenes_for_those_who_end():
    generator = torch.Generator().manual_seed(5)
    sampler, met = SceneSampler(), {"human": 0, "box": 0, "goal": 0}
    tensor, pymunk_ = TensorWorld(), PymunkWorld()
    scene = sampler(16, generator=generator)
    for world in (tensor, pymunk_):
        world.reset(scene)
    for t in range(250):
        action = seek_goal(tensor, torch.randn(16, 2, generator=generator))
        ours, theirs = tensor.step(action), pymunk_.step(action)
        assert_same_contacts(ours, theirs)
        torch.testing.assert_close(tensor.pose[:, :2], pymunk_.pose[:, :2], atol=1e-4, rtol=0)
        met = {name: count + int(getattr(ours, name).sum()) for name, count in met.items()}
        if t % 50 == 0:
            assert_same_scans(tensor.observe(), pymunk_.observe())
        ended = ours.human | ours.box | ours.goal
        if t % 60 == 59:  # Else too few would come past the human, who stands in the way.
            ended |= torch.rand(16, generator=generator) < 0.5
        if ended.any():
            fresh = sampler(16, generator=generator)
            fresh.human += 3 * torch.eye(2)[1] * (torch.rand(16, 1, generator=generator) < 0.5)
            for world in (tensor, pymunk_):
                world.reset(fresh, ended)
    assert min(met.values()) > 0, met


@pytest.mark.parametrize("engine", ENGINES)
def test_a_partial_reset_leaves_the_other_slots_alone(engine):
    generator = torch.Generator().manual_seed(1)
    first, second = SceneSampler()(4, generator=generator), SceneSampler()(4, generator=generator)
    world, undisturbed = engine(), engine()
    actions = random_actions(10, 4, generator)
    for each in (world, undisturbed):
        each.reset(first)
        for action in actions[:5]:
            each.step(action)
    mask = torch.tensor([False, True, False, True])
    world.reset(second, mask)
    assert torch.equal(world.pose[mask], second.start[mask])
    assert torch.equal(world.pose[~mask], undisturbed.pose[~mask])
    for action in actions[5:]:
        world.step(action)
        undisturbed.step(action)
    assert torch.equal(world.observe()[~mask], undisturbed.observe()[~mask])
    assert torch.equal(world.scene.boxes[mask], second.boxes[mask])


def test_a_partial_reset_keeps_the_other_slots_spaces():
    world = PymunkWorld()
    world.reset(SceneSampler()(3))
    before = [world.space(i) for i in range(3)]
    world.reset(SceneSampler()(3), torch.tensor([True, False, True]))
    assert [world.space(i) is before[i] for i in range(3)] == [False, True, False]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_partial_reset_cannot_change_the_number_of_boxes(engine):
    world = engine()
    world.reset(SceneSampler(num_boxes=3)(2))
    with pytest.raises(ValueError, match=r"cannot change the boxes' shape from \(2, 3, 5\) to \(2, 1, 5\)"):
        world.reset(SceneSampler(num_boxes=1)(2), torch.tensor([True, False]))
    world.reset(SceneSampler(num_boxes=1)(2))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("duplicate", ["state_dict", "pickle", "deepcopy"])
def test_a_copy_goes_on_exactly_as_the_original(engine, duplicate):
    generator = torch.Generator().manual_seed(2)
    world = engine()
    world.reset(SceneSampler()(4, generator=generator))
    actions = random_actions(12, 4, generator)
    for action in actions[:6]:
        world.step(action)
    if duplicate == "state_dict":
        twin = engine()
        twin.load_state_dict(world.state_dict())
    else:
        twin = pickle.loads(pickle.dumps(world)) if duplicate == "pickle" else copy.deepcopy(world)
    for action in actions[6:]:
        assert_same_contacts(world.step(action), twin.step(action))
        assert torch.equal(world.pose, twin.pose)
    assert torch.equal(world.observe(), twin.observe())


class Street(PymunkWorld):
    """A walker crosses two metres ahead of the robot, and a sensor lies on the road."""

    def build_space(self, scene):
        space = super().build_space(scene)
        walker = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        walker.position, walker.velocity = (2.0, -3.0), (0.0, 1.0)
        shape = pymunk.Circle(walker, self.human_radius)
        shape.collision_type = Kind.HUMAN
        mat = pymunk.Circle(space.static_body, 0.2)
        mat.sensor, mat.filter = True, ROBOT_FILTER
        space.add(walker, shape, mat)
        return space


def test_bodies_that_users_add_move_are_seen_and_are_run_into():
    world = Street()
    world.reset(SceneSampler(num_boxes=0, heading_noise=0.0, distance=(12.0, 12.0))(1))
    world.step(torch.zeros(1, 2))
    assert (world.scan()[0, 15:] == 4).all()
    for _ in range(14):
        contact = world.step(torch.zeros(1, 2))
    assert not contact.human
    # After 3 s the walker stands straight ahead.
    assert world.cast()[0, 360].item() == pytest.approx(1.7, abs=1e-4)
    list(world.space(0).bodies)[-1].velocity = (-1.0, 0.0)
    for _ in range(8):
        contact = world.step(torch.zeros(1, 2))
    assert contact.human
    assert not contact.box


def test_a_dynamic_body_feels_the_robot_move():
    world = PymunkWorld()
    world.reset(SceneSampler(num_boxes=0, heading_noise=0.0)(1))
    ball = pymunk.Body(mass=1.0, moment=1.0)
    ball.position = (0.4, 0.0)
    world.space(0).add(ball, pymunk.Circle(ball, 0.1))
    for _ in range(4):
        contact = world.step(torch.tensor([[0.5, 0.0]]))
    assert contact.box
    world.space(0).step(0.1)
    assert ball.position.x > 0.4


def test_asking_for_a_space_before_the_first_reset_says_what_to_do():
    with pytest.raises(RuntimeError, match="call reset first"):
        PymunkWorld().space(0)
