import math

import pytest
import shapely
import torch

from morlnav.navigation.evaluation import evaluation_scenes, shortest_path, shortest_polylines
from morlnav.navigation.evaluation.paths import _inflated
from morlnav.navigation.world import Scene


def scene(goal=(8.0, 0.0), human=(4.0, 9.0), boxes=()):
    return Scene(
        start=torch.zeros(1, 3),
        goal=torch.tensor([goal]),
        human=torch.tensor([human]),
        boxes=torch.tensor(boxes).reshape(1, len(boxes), 5),
        batch_size=[1],
    )


def test_a_free_line_is_straight():
    assert shortest_path(scene(goal=(3.0, 4.0))).item() == pytest.approx(5 - 0.35)


def test_the_human_midway_costs_two_tangents_and_an_arc():
    radius, half = 0.48, 4.0
    tangent = math.sqrt(half**2 - radius**2)
    arc = radius * 2 * math.asin(radius / half)
    found = shortest_path(scene(human=(4.0, 0.0))).item()
    assert found == pytest.approx(2 * tangent + arc - 0.35, rel=2e-4)


def test_a_square_box_costs_two_tangents_and_its_rounded_corners():
    # Corners of the square at (±1, 1) around its centre; the robot's radius rounds them.
    radius, distance = 0.18, math.hypot(3, 1)
    tangent = math.sqrt(distance**2 - radius**2)
    turn = math.atan2(1, 3) + math.asin(radius / distance)
    found = shortest_path(scene(boxes=[[4.0, 0.0, 1.0, 1.0, 0.0]])).item()
    assert found == pytest.approx(2 * tangent + 2 * radius * turn + 2 - 0.35, rel=2e-4)


def test_a_turned_box_blocks_with_its_corner():
    turned = shortest_path(scene(boxes=[[4.0, 0.0, 1.0, 1.0, math.pi / 4]])).item()
    radius, distance = 0.18, 4.0
    reach = math.hypot(distance, math.sqrt(2))
    tangent = math.sqrt(reach**2 - radius**2)
    turn = math.atan2(math.sqrt(2), distance) + math.asin(radius / reach)
    assert turned == pytest.approx(2 * tangent + 2 * radius * turn - 0.35, rel=2e-4)


def test_a_gap_too_narrow_for_the_robot_is_no_way():
    wall = [[4.0, 5.0, 0.2, 4.85, 0.0], [4.0, -5.0, 0.2, 4.85, 0.0]]  # 0.3 m apart
    wide = [[4.0, 5.1, 0.2, 4.85, 0.0], [4.0, -5.1, 0.2, 4.85, 0.0]]  # 0.5 m apart
    assert shortest_path(scene(boxes=wall, human=(4.0, 20.0))).item() > 20
    assert shortest_path(scene(boxes=wide, human=(4.0, 20.0))).item() == pytest.approx(7.65)


def test_an_enclosed_start_has_no_path():
    walls = [[2.0, 0, 0.1, 3, 0], [-2.0, 0, 0.1, 3, 0], [0, 2.0, 3, 0.1, 0], [0, -2.0, 3, 0.1, 0]]
    assert shortest_path(scene(boxes=walls)).item() == math.inf
    assert shortest_polylines(scene(boxes=walls))[0].shape == (0, 2)


def test_start_within_the_goal_disc_is_no_way_to_go():
    assert shortest_path(scene(goal=(0.3, 0.0))).item() == pytest.approx(0, abs=1e-9)


def test_paths_of_random_scenes_are_free_and_hard_to_shorten():
    scenes = evaluation_scenes(30, seed=2)
    lines = shortest_polylines(scenes)
    obstacles = _inflated(scenes, 0.18, 0.3, 16)
    lengths = shortest_path(scenes)
    direct = scenes.goal.norm(dim=-1) - 0.35
    assert (lengths > direct).all()
    assert (lengths < 1.3 * direct).all()
    for line, obstacle, length, goal in zip(lines, obstacles, lengths, scenes.goal, strict=True):
        path = shapely.linestrings(line.numpy())
        assert path.length == pytest.approx(length.item())
        assert path.intersection(obstacle.buffer(-1e-5)).length == 0
        assert torch.allclose((line[-1] - goal).norm(), torch.tensor(0.35, dtype=torch.float64), atol=1e-6)
        # Cutting a corner anywhere would enter an obstacle.
        for k in range(1, len(line) - 1):
            cut = shapely.linestrings([line[k - 1].tolist(), line[k + 1].tolist()])
            assert cut.intersects(obstacle.buffer(-1e-7))


def test_the_result_is_finer_than_its_polygons():
    scenes = evaluation_scenes(5, seed=4)
    assert torch.allclose(shortest_path(scenes), shortest_path(scenes, quad_segs=64), rtol=1e-3)


def test_scenes_need_a_batch():
    with pytest.raises(ValueError, match="one batch dimension"):
        shortest_path(scene()[0])
