"""What holds for whatever numbers: geometry, kinematics, preferences and all that is computed from them."""

import math

import numpy as np
import pandas as pd
import pytest
import shapely
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from morlnav.data import (
    CornerWeightedPreferences,
    DirichletPreferences,
    FixedPreferences,
    GridPreferences,
    SegmentedPreferences,
    UniformPreferences,
)
from morlnav.modules import PreferenceInterpolator
from morlnav.modules.scalarisation import LinearScalarisation
from morlnav.navigation.demonstrations import import_demonstrations
from morlnav.navigation.world import DifferentialDrive, Lidar
from morlnav.navigation.world.geometry import distance_to_box, polar, to_frame, wrap_angle
from morlnav.simplex import preference_edges, simplex_grid
from morlnav.transforms import HindsightPreferenceRelabel

settings.register_profile("ours", deadline=None, derandomize=True, max_examples=25, database=None)
settings.load_profile("ours")


def numbers(low, high):
    return st.floats(low, high, allow_subnormal=False)


def tensors(*strategies):
    return st.tuples(*strategies).map(lambda values: torch.tensor(values, dtype=torch.float64))


places = numbers(-10, 10)
points, angles = tensors(places, places), numbers(-20, 20)
poses = tensors(places, places, numbers(-math.pi, math.pi))
boxes = tensors(places, places, numbers(0.05, 3), numbers(0.05, 3), numbers(-math.pi, math.pi))
weights = st.lists(numbers(0.01, 1), min_size=2, max_size=5).map(lambda values: torch.tensor(values) / sum(values))


def close(ours, theirs, atol=1e-9):
    torch.testing.assert_close(ours, torch.as_tensor(theirs, dtype=ours.dtype), atol=atol, rtol=1e-6)


# Geometry


@given(angles)
def test_a_wrapped_angle_is_the_same_direction_in_one_turn(angle):
    wrapped = wrap_angle(torch.tensor(angle, dtype=torch.float64))
    assert -math.pi <= wrapped <= math.pi
    close(torch.stack([wrapped.cos(), wrapped.sin()]), [math.cos(angle), math.sin(angle)])


@given(points, points, angles)
def test_a_frame_keeps_distances_and_turns_back(point, origin, angle):
    angle = torch.tensor(angle, dtype=torch.float64)
    seen = to_frame(point, origin, angle)
    close(seen.norm(), (point - origin).norm())
    close(to_frame(seen, torch.zeros(2, dtype=torch.float64), -angle) + origin, point)


@given(points, poses)
def test_polar_coordinates_lead_back_to_the_point(point, pose):
    distance, bearing = polar(point, pose)
    course = pose[2] + bearing
    close(pose[:2] + distance * torch.stack([course.cos(), course.sin()]), point)


@given(points, boxes)
def test_the_distance_to_a_box_is_shapelys(point, box):
    x, y, length, width, angle = box.tolist()
    shape = shapely.affinity.rotate(shapely.box(-length, -width, length, width), angle, (0, 0), use_radians=True)
    shape, place = shapely.affinity.translate(shape, x, y), shapely.Point(*point.tolist())
    expected = -shape.exterior.distance(place) if shape.contains(place) else shape.distance(place)
    close(distance_to_box(point, box), expected)


@given(poses, points, st.lists(boxes, min_size=1, max_size=3), st.sampled_from([(720, 30), (90, 9), (36, 36), (12, 1)]))
def test_the_scan_is_the_pooled_cast(pose, human, obstacles, rays):
    lidar, seen = Lidar(*rays), (pose[None], human[None], torch.stack(obstacles)[None], 0.3)
    close(lidar.scan(*seen), lidar.pool(lidar.cast(*seen)))


# Kinematics


@given(poses, numbers(0, 0.5), numbers(-math.pi, math.pi), numbers(0.05, 0.9))
def test_the_action_between_two_poses_is_the_one_that_was_driven(pose, speed, turn, duration):
    robot, action = DifferentialDrive(), torch.tensor([speed, turn], dtype=torch.float64)
    close(robot.action_between(pose, robot.move(pose, action, duration), duration), action, atol=1e-7)


@given(poses, numbers(0, 0.5), numbers(-math.pi, math.pi), numbers(0, 1), numbers(0, 1))
def test_an_arc_may_be_driven_in_two_parts(pose, speed, turn, first, second):
    robot, action = DifferentialDrive(), torch.tensor([speed, turn], dtype=torch.float64)
    whole, parts = (
        robot.move(pose, action, first + second),
        robot.move(robot.move(pose, action, first), action, second),
    )
    close(parts[:2], whole[:2])
    close((parts[2] - whole[2]).cos(), 1)


# Preferences


@given(st.integers(1, 5), st.integers(1, 8))
def test_a_grid_is_every_preference_of_its_steps_once(n, steps):
    grid = (simplex_grid(n, steps) * steps).double()
    close(grid, grid.round(), atol=1e-6)
    close(grid.sum(-1), torch.full((len(grid),), steps), atol=1e-6)
    assert len({tuple(row) for row in grid.round().tolist()}) == len(grid) == math.comb(steps + n - 1, n - 1)
    edges = (preference_edges(n, steps) * steps).round().tolist()
    on_edges = {tuple(row) for row in grid.round().tolist() if sum(entry > 0 for entry in row) <= 2}
    assert len(edges) == len(on_edges)
    assert {tuple(row) for row in edges} == on_edges


SAMPLERS = {
    "uniform": UniformPreferences,
    "dirichlet": lambda n: DirichletPreferences(n, 0.3),
    "segments": lambda n: SegmentedPreferences(n, segments=3),
    "corners": lambda n: CornerWeightedPreferences(n, 0.4, 0.3),
    "grid": lambda n: GridPreferences(n, steps=4),
    "fixed": lambda n: FixedPreferences([1 / n] * n),
}


@pytest.mark.parametrize("kind", SAMPLERS)
@given(st.integers(1, 6), st.lists(st.integers(1, 5), max_size=3), st.integers(0, 2**31))
@settings(max_examples=8)
def test_what_a_sampler_draws_is_a_preference(kind, n, batch, seed):
    draw = SAMPLERS[kind](n)
    ours, again = (draw(*batch, generator=torch.Generator().manual_seed(seed)) for _ in range(2))
    assert ours.shape == (*batch, n)
    assert (ours >= 0).all()
    close(ours.sum(-1), torch.ones(batch), atol=1e-5)
    assert torch.equal(ours, again)


@given(weights, numbers(0.1, 4), numbers(0, 1), st.integers(0, 2))
def test_a_scalarisation_weighs_static_entries_by_one(preference, scale, tie_break, static):
    value = torch.linspace(-3, 2, len(preference) + static)
    utility = LinearScalarisation(scale, tie_break)(preference, len(value)) @ value
    tuneable = ((scale * preference + tie_break) * value[static:]).sum()
    close(utility, value[:static].sum() + tuneable, atol=1e-4)


@given(st.integers(2, 4), st.integers(1, 4), st.integers(0, 2), st.integers(0, 2**31))
def test_an_interpolator_gives_the_direction_of_every_key(n, steps, static, seed):
    keys = simplex_grid(n, steps)
    values = torch.randn(len(keys), static + n, generator=torch.Generator().manual_seed(seed))
    interpolator = PreferenceInterpolator(n, static, preferences=keys, values=values)
    close(interpolator(keys), torch.nn.functional.normalize(values, dim=-1), atol=1e-3)


@given(st.integers(1, 4), st.integers(1, 20), numbers(0, 1), st.integers(1, 3), st.integers(0, 2**31))
def test_relabelling_changes_the_preference_alone_and_in_both_states(n, rows, share, copies, seed):
    torch.manual_seed(seed)
    own = UniformPreferences(n)(rows)
    batch = TensorDict(preference=own, reward=torch.randn(rows, n), next={"preference": own}, batch_size=[rows])
    relabelled = HindsightPreferenceRelabel(FixedPreferences([1 / n] * n), share, copies)(batch.clone())
    shape = (rows,) if copies == 1 else (rows, copies)
    assert relabelled.batch_size == shape
    reward, kept = (x.reshape(rows, -1, n).expand(rows, copies, n).reshape(*shape, n) for x in (batch["reward"], own))
    assert torch.equal(relabelled["reward"], reward)
    assert torch.equal(relabelled["preference"], relabelled["next", "preference"])
    changed = (relabelled["preference"] != kept).any(-1)
    close(relabelled["preference"][changed], torch.full((int(changed.sum()), n), 1 / n), atol=1e-6)
    if n > 1 and share in (0, 1):
        assert (changed == bool(share)).all()


# Import


@given(poses, numbers(0.15, 0.5), numbers(-0.5, 0.5), st.sampled_from([4.0, 5.0, 7.3, 20.0]))
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_an_arc_in_a_file_is_the_action_that_drove_it(tmp_path, pose, speed, turn, rate):
    robot, action = DifferentialDrive(), torch.tensor([speed, turn], dtype=torch.float64)
    time = torch.arange(0, 5, 1 / rate, dtype=torch.float64)
    driven = robot.move(pose.expand(len(time), 3), action.expand(len(time), 2), time).numpy()
    goal = robot.move(pose, action, float(time[-1]))[:2].numpy()
    aside = goal + 8.0
    frame = pd.DataFrame({"time": time, "x": driven[:, 0], "y": driven[:, 1], "heading": np.unwrap(driven[:, 2])})
    frame = frame.assign(goal_x=goal[0], goal_y=goal[1], human_x=aside[0], human_y=aside[1])
    frame.to_csv(tmp_path / "drive.csv", index=False)
    read = import_demonstrations(tmp_path / "drive.csv")["action"].double()
    assert len(read) > 5
    close(read, action.expand(len(read), 2), atol=5e-3)
