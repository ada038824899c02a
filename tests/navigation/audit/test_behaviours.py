import math

import pytest
import torch

from morlnav.navigation.audit.behaviours import RADII, PathFollower, alternative_behaviours, paths_around
from morlnav.navigation.evaluation import Outcome, evaluation_scenes, frechet_distance, reference_paths
from morlnav.navigation.evaluation.metrics import path_length
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import SceneSampler
from morlnav.navigation.world.geometry import wrap_angle


@pytest.fixture(scope="module")
def scenes():
    return evaluation_scenes(6, seed=5, sampler=SceneSampler(num_boxes=0, distance=(7.0, 10.0)))


@pytest.fixture(scope="module")
def driven(scenes):
    return {name: behaviour.drive(scenes) for name, behaviour in alternative_behaviours(scenes).items()}


@pytest.fixture(scope="module")
def references(scenes):
    return reference_paths(scenes, CircumnavigationOracle())


def nearest(rollouts):
    return (rollouts.pose[0, ..., :2] - rollouts.scene.human[0].unsqueeze(1)).norm(dim=-1).amin(1)


def test_all_but_idling_and_spinning_arrive(driven):
    stay = {name for name, rollouts in driven.items() if not (rollouts.outcome == Outcome.GOAL).all()}
    assert stay == {"idle", "spin"}
    for name in stay:
        assert (driven[name].outcome == Outcome.TIMEOUT).all()
        assert (driven[name].pose[..., :2] == 0).all()
    assert (driven["spin"].action[..., 1] == math.pi).all()


@pytest.mark.parametrize("radius", RADII)
def test_orbits_keep_their_radius(driven, radius):
    assert nearest(driven[f"radius {radius}"]) == pytest.approx(radius, abs=0.06)


def test_strings_are_taut_around_their_circles(driven, scenes):
    half = scenes.goal[:, 0] / 2
    for radius in (1.0, 1.6):
        rollouts = driven[f"taut {radius}"]
        length = 2 * (half**2 - radius**2).sqrt() + 2 * radius * (radius / half).asin()
        assert nearest(rollouts) == pytest.approx(radius, abs=0.03)
        assert path_length(rollouts.pose[0]) + 0.35 == pytest.approx(length, abs=0.06)


def test_the_swerve_is_straight_until_the_last_metre(driven, scenes):
    rollouts = driven["swerve 0.55"]
    assert nearest(rollouts) == pytest.approx(0.55, abs=0.03)
    before = rollouts.pose[0, ..., 0] < (scenes.goal[:, :1] / 2 - 1.0)
    assert (rollouts.pose[0, ..., 1].abs() * before).max() < 0.05


def test_only_the_wrong_side_passes_with_the_human_on_the_left(driven, scenes):
    for name in driven.keys() - {"idle", "spin"}:
        arm = driven[name].pose[0, ..., :2] - scenes.human.unsqueeze(1)
        swept = wrap_angle(torch.atan2(arm[..., 1], arm[..., 0]).diff(dim=1)).sum(1)
        turns = {"wrong side": 0.5, "extra loop": -1.5}.get(name, -0.5)
        assert swept / (2 * math.pi) == pytest.approx(turns, abs=0.06), name


def test_half_speed_takes_twice_as_long_on_the_same_path(driven, references):
    rollouts = driven["half speed"]
    assert rollouts.action[..., 0].max() == 0.25
    assert frechet_distance(rollouts.path[0], references).max() < 0.1
    steps = torch.tensor([len(path) - 1 for path in references])
    assert (rollouts.steps[0] > 1.8 * steps).all()


def test_the_extra_loop_is_one_circumference_longer(driven, references):
    length = torch.stack([path.diff(dim=0).norm(dim=-1).sum() for path in references])
    assert path_length(driven["extra loop"].pose[0]) - length == pytest.approx(2 * math.pi, abs=0.25)
    assert nearest(driven["extra loop"]) == pytest.approx(1.0, abs=0.05)


def test_distances_to_the_demonstration_are_those_of_the_shapes(driven, references):
    frechet = {name: frechet_distance(driven[name].path[0], references).mean().item() for name in driven}
    expected = {"radius 1.35": 0.40, "radius 0.6": 0.41, "swerve 0.55": 0.48, "taut 1.0": 0.75, "wrong side": 2.01}
    assert {name: frechet[name] for name in expected} == pytest.approx(expected, abs=0.06)


def test_a_follower_starts_again_and_needs_all_its_scenes(scenes):
    follower = PathFollower(scenes, paths_around(scenes, 1.0))
    observation = torch.zeros(len(scenes), 34)
    observation[:, 0], observation[:, 2] = scenes.goal[:, 0], scenes.human[:, 0]
    first = follower(observation)
    follower.next += 20
    assert torch.equal(follower(observation), first)
    with pytest.raises(ValueError, match="drop_finished=False"):
        follower(observation[:2])
    with pytest.raises(ValueError, match="one path for each"):
        PathFollower(scenes, paths_around(scenes[:2], 1.0))
