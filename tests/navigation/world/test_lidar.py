"""The scan, against distances worked out by hand and against pymunk's own ray cast."""

import math

import pytest
import torch

from morlnav.navigation.world import Lidar, PymunkWorld, SceneSampler
from morlnav.navigation.world.geometry import distance_to_box

FAR = torch.tensor([[100.0, 0.0]])
NO_BOXES = torch.zeros(1, 0, 5)


def cast(pose=(0.0, 0.0, 0.0), human=(100.0, 0.0), boxes=()):
    """All 720 rays from one pose."""
    boxes = torch.tensor(boxes).reshape(1, -1, 5)
    return Lidar().cast(torch.tensor([pose]), torch.tensor([human]), boxes, 0.3)[0]


def ray(degrees):
    """The index of the ray at this robot-frame angle."""
    return round((degrees + 180) * 2)


def test_the_human_is_seen_from_centre_distance_less_radius():
    rays = cast(human=(2.0, 0.0))
    assert rays[ray(0)] == pytest.approx(1.7)
    assert rays[ray(90)] == 4
    # The tangents to a circle of 0.3 m seen from 2 m leave at ±asin(0.15) = ±8.63°.
    assert (rays < 4).nonzero().flatten().tolist() == list(range(ray(-8.5), ray(8.5) + 1))


def test_angles_count_counter_clockwise_from_the_robots_back():
    left, behind = cast(human=(0.0, 2.0)), cast(human=(-2.0, 0.0))
    assert left[ray(90)] == pytest.approx(1.7)
    assert behind[0] == pytest.approx(1.7)


def test_rays_turn_with_the_robot():
    rays = cast(pose=(1.0, 1.0, math.pi / 2), human=(3.0, 1.0))
    assert rays[ray(-90)] == pytest.approx(1.7)


def test_a_box_is_hit_on_its_near_side_or_its_corner():
    assert cast(boxes=[[2.0, 0.2, 0.5, 0.8, 0.0]])[ray(0)] == pytest.approx(1.5)
    assert cast(boxes=[[2.0, 0.0, 0.5, 0.5, math.pi / 4]])[ray(0)] == pytest.approx(2 - math.sqrt(0.5), abs=1e-5)


def test_rays_exactly_along_a_boxs_sides_hit_it_too():
    rays = cast(boxes=[[3.0, 0.0, 0.5, 0.5, 0.0]])
    assert rays[ray(0)] == pytest.approx(2.5)
    rays = cast(pose=(0.0, 0.1, 0.0), boxes=[[3.0, 0.0, 0.5, 0.5, 0.0]])
    assert rays[ray(0)] == pytest.approx(2.5)


def test_nothing_within_range_reads_the_range():
    assert (cast(human=(4.4, 0.0), boxes=[[0.0, 6.0, 1.0, 1.0, 0.5]]) == 4).all()
    assert (cast() == 4).all()


def test_a_ray_that_begins_inside_something_reads_zero():
    assert (cast(human=(0.1, 0.1)) == 0).all()
    assert (cast(boxes=[[0.1, 0.1, 0.5, 0.3, 0.4]]) == 0).all()


def test_sector_i_is_the_minimum_over_the_24_rays_from_minus_pi_plus_12_i_degrees():
    rays = torch.rand(2, 720, generator=torch.Generator().manual_seed(0))
    sectors = Lidar().pool(rays)
    for i in range(30):
        assert sectors[1, i] == min(rays[1, 24 * i + k] for k in range(24))
    angles = Lidar().angles()
    for i, k in [(0, 0), (7, 3), (29, 23)]:
        assert angles[24 * i + k] == pytest.approx(-math.pi + math.radians((24 * i + k) * 0.5), abs=1e-6)


def test_straight_ahead_begins_sector_15():
    # A thin post at +1° lies in sector 15 (0° to 11.5°), one at -1° in sector 14.
    for degrees, sector in [(1.0, 15), (-1.0, 14)]:
        x, y = 2 * math.cos(math.radians(degrees)), 2 * math.sin(math.radians(degrees))
        scan = Lidar().scan(torch.zeros(1, 3), FAR, torch.tensor([[[x, y, 0.01, 0.01, 0.0]]]), 0.3)[0]
        assert (scan < 4).nonzero().flatten().tolist() == [sector]


def test_every_ray_agrees_with_pymunks_own_ray_cast():
    scene = SceneSampler(num_boxes=5)(40, generator=torch.Generator().manual_seed(3))
    world = PymunkWorld()
    world.reset(scene)
    generator = torch.Generator().manual_seed(4)
    world.pose = torch.cat(
        [scene.goal * torch.rand(40, 1, generator=generator), torch.randn(40, 1, generator=generator)], -1
    )
    # The formulas are compared in double precision, where no grazing ray is lost to rounding.
    ours = world.lidar.cast(world.pose.double(), scene.human.double(), scene.boxes.double(), 0.3)
    theirs = world.cast()
    assert (theirs < 4).float().mean() > 0.1
    torch.testing.assert_close(ours.float(), theirs, atol=1e-5, rtol=0)
    # In single precision only rays that graze an edge may differ.
    single = world.lidar.cast(world.pose, scene.human, scene.boxes, 0.3)
    assert ((single - theirs).abs() > 1e-3).float().mean() < 1e-3


def random_views(count, num_boxes, seed, spread=1.5):
    """Robots among, beside and inside random obstacles, and some exactly at a corner, on a side or in line with one."""
    generator = torch.Generator().manual_seed(seed)
    uniform = lambda *shape: 2 * torch.rand(shape, generator=generator) - 1  # noqa: E731
    pose, human = torch.cat([spread * uniform(count, 2), 3 * uniform(count, 1)], -1), 3 * uniform(count, 2)
    boxes = torch.cat([3 * uniform(count, num_boxes, 2), 0.05 + uniform(count, num_boxes, 2).abs()], -1)
    boxes = torch.cat([boxes, 3 * uniform(count, num_boxes, 1)], -1)
    if num_boxes:
        straight = count // 2
        boxes[:straight, 0, 4] = 0
        corner = boxes[:straight, 0, :2] + boxes[:straight, 0, 2:4]
        pose[: straight // 3, :2] = corner[: straight // 3]
        pose[straight // 3 : straight, 0] = corner[straight // 3 :, 0]
        pose[:straight:2, 2] = 0
    return pose, human, boxes


@pytest.mark.parametrize("num_boxes", [0, 1, 4])
@pytest.mark.parametrize(("rays", "sectors"), [(720, 30), (360, 360), (90, 2), (45, 3), (36, 1), (4, 4), (1, 1)])
def test_the_scan_is_the_pooled_cast(rays, sectors, num_boxes):
    lidar = Lidar(rays, sectors)
    pose, _, boxes = view = random_views(300, num_boxes, seed=rays + num_boxes)
    double = [part.double() for part in view]
    torch.testing.assert_close(lidar.scan(*double, 0.3), lidar.pool(lidar.cast(*double, 0.3)))
    # In single precision it is rounding alone that decides what a robot reads whose very centre is on a surface.
    off = (distance_to_box(pose[:, None, :2], boxes).abs() > 1e-6).all(1)
    scan, reference = lidar.scan(*view, 0.3)[off], lidar.pool(lidar.cast(*view, 0.3))[off]
    assert (reference < 4).any()
    torch.testing.assert_close(scan, reference, atol=1e-5, rtol=0)


def test_a_hundred_boxes_are_scanned_alike():
    view = [part.double() for part in random_views(10, 100, seed=9, spread=4.0)]
    torch.testing.assert_close(Lidar().scan(*view, 0.3), Lidar().pool(Lidar().cast(*view, 0.3)), atol=1e-5, rtol=0)


def test_posts_thinner_than_the_gap_between_rays_are_hit_or_missed_alike():
    pose, human, boxes = (part.double() for part in random_views(500, 3, seed=1))
    boxes[..., 2:4] *= 0.01
    scan, reference = Lidar().scan(pose, human, boxes, 0.002), Lidar().pool(Lidar().cast(pose, human, boxes, 0.002))
    torch.testing.assert_close(scan, reference, atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"sectors": 7}, "7 sectors must divide 720 rays"), ({"max_range": 0.0}, "max_range must be positive")],
)
def test_senseless_scanners_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Lidar(**arguments)
