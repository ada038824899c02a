"""What a robot measures becomes what its policy was trained to see, and nothing else passes."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import morlnav
from morlnav.deployment import Policy
from morlnav.modules import Actor
from morlnav.navigation.deployment import Observer
from morlnav.navigation.evaluation import Outcome, evaluate_policy, evaluation_scenes
from morlnav.navigation.world import Lidar, TensorWorld

RESULTS = Path(__file__).parents[2] / "results"
NAN, INF = math.nan, math.inf
POSE, GOAL = (0.0, 0.0, 0.0), (5.0, 0.0)


def scan(ranges, first=-math.pi, step=None, near=0.1, far=10.0):
    ranges = np.asarray(ranges, np.float32)  # as in a message
    step = 2 * math.pi / len(ranges) if step is None else step
    return SimpleNamespace(angle_min=first, angle_increment=step, range_min=near, range_max=far, ranges=ranges)


def ring(count=720, **readings):
    """No echo anywhere but at a few rays of a turn from straight behind."""
    ranges = np.full(count, INF)
    for ray, reading in readings.items():
        ranges[int(ray[1:])] = reading
    return ranges


def observe(readings, **settings):
    return Observer(**settings)(readings, POSE, GOAL, [])


def sectors(readings, **settings):
    return observe(readings, **settings)[4:]


@pytest.fixture
def world():
    """Robots on their way, with boxes and a human in sight."""
    world, scene = TensorWorld(), evaluation_scenes(20)
    world.reset(scene)
    world.pose = torch.cat([scene.human - torch.tensor([1.5, 0.4]), torch.linspace(-3, 3, 20)[:, None]], 1)
    return world


def test_an_ideal_scanner_gives_what_training_saw(world):
    scene, lidar = world.scene, world.lidar
    rays = lidar.cast(world.pose, scene.human, scene.boxes, world.human_radius)
    rays[rays == lidar.max_range] = INF
    for i, expected in enumerate(world.observe()):
        seen = Observer()(scan(rays[i]), world.pose[i], scene.goal[i], scene.human[i : i + 1])
        torch.testing.assert_close(seen, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("start", [0, 360, 401])
@pytest.mark.parametrize("turn", [1, -1])
def test_a_scan_may_begin_anywhere_and_turn_either_way(start, turn):
    order = (start + turn * np.arange(720)) % 720
    angles = Lidar().angles().numpy() + math.pi / 720  # not on the borders of sectors
    ranges = 2.5 + np.sin(angles)
    seen = sectors(scan(ranges[order], angles[start], turn * math.pi / 360))
    torch.testing.assert_close(seen, Lidar().pool(torch.from_numpy(ranges)))


@pytest.mark.parametrize("mount", [(0.2, 0.1, 0.0), (-0.15, 0.0, math.pi), (0.0, 0.0, 1.0), (0.3, -0.1, -2.0)])
def test_where_the_scanner_is_mounted_makes_no_difference(mount, world):
    """A scanner elsewhere on the robot sees the same obstacles at the same place."""
    x, y, yaw = mount
    pose, scene = world.pose, world.scene
    cos, sin = pose[:, 2].cos(), pose[:, 2].sin()
    place = torch.stack([pose[:, 0] + x * cos - y * sin, pose[:, 1] + x * sin + y * cos, pose[:, 2] + yaw], 1)
    lidar = Lidar(rays=7200, max_range=8.0)
    rays = lidar.cast(place, scene.human, scene.boxes, world.human_radius)
    true = Lidar(rays=7200).scan(pose, scene.human, scene.boxes, world.human_radius)
    for i in range(len(pose)):
        seen = sectors(scan(rays[i], far=8.0), mount=mount)
        # Each hides from the other what is behind the nearest surface, but not the nearest surface.
        assert seen.min() == pytest.approx(true[i].min().item(), abs=0.02)
        assert abs(int(seen.argmin()) - int(true[i].argmin())) % 29 <= 1


@pytest.mark.parametrize("no_echo", [0.0, INF, 10.5])
def test_no_echo_means_that_nothing_is_there(no_echo):
    assert sectors(scan(ring(r300=no_echo, r301=3.0)))[12] == 3
    assert (sectors(scan(np.full(720, no_echo))) == 4).all()


def test_readings_may_be_masked_or_a_tensor():
    masked = scan(ring(r300=2.0, r301=3.0))
    masked.ranges = np.ma.masked_equal(masked.ranges, 2.0)
    assert sectors(masked)[12] == 3
    masked.ranges = torch.full((720,), 3.0, requires_grad=True)
    assert (sectors(masked) == 3).all()


@pytest.mark.parametrize("no_echo", [65.533, 1000.0])
def test_a_number_far_beyond_the_range_is_no_echo(no_echo):
    assert (sectors(scan(np.full(720, no_echo), far=6.0)) == 4).all()


def test_one_failed_ray_says_nothing_and_its_neighbours_do():
    seen = observe(scan(ring(r360=NAN, r361=2.0)))
    assert seen.isfinite().all()
    assert seen[4 + 15] == 2


@pytest.mark.parametrize("too_near", [-INF, 0.05])
def test_what_is_too_near_to_measure_is_near(too_near):
    assert sectors(scan(ring(r361=too_near)))[15] == pytest.approx(0.1)


def test_a_sector_of_failed_rays_is_refused_ahead_and_free_behind():
    ahead, behind = np.full(720, 3.0), np.full(720, 3.0)
    ahead[360:384] = behind[:24] = NAN
    with pytest.raises(ValueError, match=r"says nothing of 1 sectors within 90° of straight ahead, .* one at 6°"):
        observe(scan(ahead))
    assert sectors(scan(behind)).tolist() == [4.0] + [3.0] * 29
    with pytest.raises(ValueError, match="says nothing of 1 sectors within 180°"):
        observe(scan(behind), field=math.pi)
    with pytest.raises(ValueError, match="says nothing of 16 sectors"):
        observe(scan(np.full(720, NAN)))


def test_a_partial_field_of_view_leaves_the_rest_free():
    half = math.radians(135)
    seen = sectors(scan(np.full(541, 2.0), -half, math.radians(0.5)))
    angles = np.abs((np.arange(30) + 0.5) * 12 - 180)
    assert seen.tolist() == [2.0 if angle < 141 else 4.0 for angle in angles]
    narrow = scan(np.full(87, 2.0), math.radians(-43), math.radians(1))
    with pytest.raises(ValueError, match="nothing of 8 sectors within 90°"):
        observe(narrow)
    assert sectors(narrow, field=math.radians(40))[15] == 2


@pytest.mark.parametrize("count", [24, 30, 31, 90, 333, 361, 5000])
def test_any_number_of_rays_will_do(count):
    assert (sectors(scan(np.full(count, 2.0))) == 2).all()


def test_a_ray_that_is_wider_than_a_sector_stands_for_all_that_it_covers():
    seen = sectors(scan(ring(15, r7=1.0), first=-math.pi + math.radians(12), step=math.radians(24)))
    assert (seen < 4).nonzero().flatten().tolist() == [14, 15]


def test_goal_and_human_are_seen_from_the_robot():
    seen = Observer()(scan(ring()), (1.0, 1.0, math.pi / 2), (1.0, 4.0), [(0.0, 1.0)])
    torch.testing.assert_close(seen[:4], torch.tensor([3.0, 0.0, 1.0, math.pi / 2]))


def test_of_several_humans_the_nearest_counts():
    humans = [(4.0, 0.0), (0.0, -1.5), (NAN, 0.0), (0.5, INF)]
    assert Observer()(scan(ring()), POSE, GOAL, humans)[2:4].tolist() == pytest.approx([1.5, -math.pi / 2])


@pytest.mark.parametrize("humans", [[], [(NAN, NAN)], [(INF, 0.0)], [(3.0, NAN)], [(50.0, 0.0)], np.zeros((0, 2))])
def test_nobody_is_a_human_where_it_never_mattered(humans):
    assert Observer()(scan(ring()), POSE, GOAL, humans)[2:4].tolist() == pytest.approx([6.0, -math.pi])


class Empty(TensorWorld):
    """A world whose human is out of sight, as an observer tells of it."""

    def observe(self):
        observation = super().observe()
        observation[:, 2:4] = Observer()(scan(ring()), POSE, GOAL, [])[2:4]
        return observation


@pytest.mark.parametrize("run", ["default", "two_styles/seed_0"])
def test_a_trained_policy_drives_straight_to_the_goal_when_nobody_is_there(run):
    policy, scenes = morlnav.load(RESULTS / run), evaluation_scenes(40)
    scenes.human = torch.full_like(scenes.human, 1000.0)
    count = len(policy.objectives)
    objectives = dict.fromkeys(policy.objectives, lambda transition: transition.action[:, 0])
    rollouts = evaluate_policy(policy, scenes, torch.eye(count), world=Empty(), objectives=objectives)
    assert (rollouts.outcome == Outcome.GOAL).all()
    length = rollouts.pose[..., :2].diff(dim=2).norm(dim=-1).sum(-1)
    straight = (scenes.goal - scenes.start[:, :2]).norm(dim=-1) - Empty().goal_radius
    assert ((length / straight).mean(1) < 1.06).all()


def test_a_far_goal_is_seen_in_its_direction():
    assert Observer()(scan(ring()), POSE, (0.0, 300.0), [])[:2].tolist() == pytest.approx([12.0, math.pi / 2])


def test_a_policy_tells_what_it_looks_at():
    observer = Observer.of(morlnav.load(RESULTS / "default"))
    assert (observer.lidar.sectors, observer.lidar.max_range, observer.observe_human) == (30, 4.0, True)
    blind = Policy(Actor(2, [0.0, -3.0], [0.5, 3.0], features=34), ("distance", "efficiency"))
    with pytest.raises(ValueError, match=r"Flat for features tells no lidar; give it as Observer\(lidar\)"):
        Observer.of(blind)


def test_a_policy_that_is_not_told_of_the_human_gets_less():
    observer = Observer(Lidar(40, 20, 3.0), observe_human=False)
    assert observer(scan(ring()), POSE, GOAL).tolist() == [5.0, 0.0] + [3.0] * 20
    with pytest.raises(ValueError, match="is told of no humans"):
        observer(scan(ring()), POSE, GOAL, [])
    with pytest.raises(ValueError, match="give humans, \\[\\] for nobody"):
        Observer()(scan(ring()), POSE, GOAL)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"goal": (NAN, 0.0)}, "goal must be 2 finite numbers, got \\[nan, 0.0\\]"),
        ({"goal": (1.0, 2.0, 0.0)}, "goal must be 2 finite numbers"),
        ({"goal": None}, "goal must be 2 finite numbers"),
        ({"goal": "home"}, "goal must be numbers"),
        ({"pose": (0.0, INF, 0.0)}, "pose must be 3 finite numbers"),
        ({"humans": (1.0, 2.0)}, "x and y of each, \\[K, 2\\], got the shape \\[2\\]"),
        ({"humans": [(1.0, 2.0, 0.5)]}, "got the shape \\[1, 3\\]"),
        ({"humans": [(1.0, 2.0), (1.0,)]}, "humans must be numbers, in rows of one length"),
        ({"scan": scan([], step=0.1)}, "one row of distances, got the shape \\[0\\]"),
        ({"scan": scan(np.ones((2, 360)), step=0.01)}, "got the shape \\[2, 360\\]"),
        ({"scan": scan(ring(), step=0.5)}, "by 2π at most, got 0.5; is it in degrees"),
        ({"scan": scan(ring(), step=0.0)}, "angle_increment must turn 720 rays"),
        ({"scan": scan(ring(), first=NAN)}, "angle_min and angle_increment must be 2 finite numbers"),
        ({"scan": scan(ring(), near=2.0, far=1.0)}, "range_min and range_max must ascend from 0, got 2 and 1"),
        ({"scan": scan(ring(), far=NAN)}, "must ascend from 0"),
        ({"scan": scan(ring(), near=None)}, "must ascend from 0, got nan"),
        (
            {"scan": scan(ring()[:8], first=-180.0, step=0.5)},
            "angle_min must be an angle in rad, got -180; is it in",
        ),
        ({"scan": scan(np.linspace(500, 4000, 720))}, "ranges reach 4000, range_max is 10 m; are they in millimetres"),
        ({"scan": SimpleNamespace(ranges=[1.0])}, "A scan needs .*; there is no angle_min"),
        ({"scan": scan(ring(r7=-1.0))}, r"scan.ranges\[7\] must be a distance in metres, got -1"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence(wrong, sentence):
    inputs = {"scan": scan(ring(360)), "pose": POSE, "goal": GOAL, "humans": []} | wrong
    with pytest.raises(ValueError, match=sentence) as error:
        Observer()(**inputs)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"mount": (0.1, 0.0)}, "mount must be 3 finite numbers"),
        ({"mount": (0.1, 0.0, NAN)}, "mount must be 3 finite numbers"),
        ({"mount": (0.1, 0.0, 90.0)}, "x and y on the robot in metres, and a yaw in rad, got .* in other units"),
        ({"mount": (120.0, 0.0, 0.0)}, "x and y on the robot in metres"),
        ({"field": 90.0}, "field must be an angle from 0 to π, got 90"),
        ({"human_reach": 0.0}, "human_reach and goal_reach must be positive"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        Observer(**settings)
