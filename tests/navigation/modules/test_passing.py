import pytest
import torch

from morlnav.navigation.evaluation import Outcome, evaluate_policy, evaluation_scenes, frechet_distance
from morlnav.navigation.evaluation.metrics import winding
from morlnav.navigation.evaluation.paths import shortest_path
from morlnav.navigation.modules import PassingOracle, SlowPassingOracle, WaitingOracle
from morlnav.navigation.world import PymunkWorld, Scene, SceneSampler, TensorWorld

STYLES = [PassingOracle(), PassingOracle(radius=0.8, clockwise=False), SlowPassingOracle(), WaitingOracle()]


def drive(oracle, scenes, **options):
    return evaluate_policy(lambda observation, _: oracle(observation), scenes, torch.zeros(1, 2), **options)[0]


def human_distance(rollouts):
    return (rollouts.pose[..., :2] - rollouts.scene.human.unsqueeze(1)).norm(dim=-1)


def driven(rollouts):
    return torch.arange(rollouts.action.shape[1]) < rollouts.steps.unsqueeze(1)


@pytest.fixture(scope="module")
def scenes():
    return evaluation_scenes(40, sampler=SceneSampler(num_boxes=0))


@pytest.mark.parametrize("oracle", STYLES, ids=lambda oracle: f"{type(oracle).__name__} {oracle.radius}")
def test_every_goal_is_reached_at_the_wanted_distance_and_on_the_wanted_side(oracle, scenes):
    rollouts = drive(oracle, scenes)
    assert (rollouts.outcome == Outcome.GOAL).all()
    assert (human_distance(rollouts).amin(1) - oracle.radius).abs().max() < 0.03
    assert (winding(rollouts.pose, rollouts.scene.human) * (1 if oracle.clockwise else -1) < 0).all()


@pytest.mark.parametrize("oracle", STYLES, ids=lambda oracle: f"{type(oracle).__name__} {oracle.radius}")
def test_both_engines_drive_the_same_path(oracle, scenes):
    slow, fast = drive(oracle, scenes[:1], world=PymunkWorld()), drive(oracle, scenes[:1])
    assert (slow.outcome == Outcome.GOAL).all()
    assert frechet_distance(slow.unsqueeze(0).path[0], fast.unsqueeze(0).path[0]).max() < 0.03


def test_the_path_is_that_of_a_taut_string(scenes):
    # As long as the shortest way around a human of that size, on whichever side: the scenes are symmetric.
    scenes = scenes.clone()
    scenes.start[:, 2] = 0
    oracle = PassingOracle(radius=1.2)
    rollouts = drive(oracle, scenes)
    length = (rollouts.pose[:, 1:, :2] - rollouts.pose[:, :-1, :2]).norm(dim=-1).sum(1)
    string = shortest_path(scenes, robot_radius=0.2, human_radius=1.0, goal_radius=0.35)
    torch.testing.assert_close(length.double(), string.double(), rtol=0.01, atol=0.1)


def test_it_reaches_the_goal_from_anywhere():
    generator = torch.Generator().manual_seed(0)
    start = torch.rand(100, 3, generator=generator) * torch.tensor([12.0, 8.0, 6.28]) + torch.tensor([-2.0, -4.0, 0.0])
    human, goal = torch.tensor([4.0, 0.0]), torch.tensor([8.0, 0.0])
    start = start[((start[:, :2] - human).norm(dim=1) > 0.5) & ((start[:, :2] - goal).norm(dim=1) > 0.4)]
    size = len(start)
    boxes = torch.zeros(size, 0, 5)
    scene = Scene(start=start, goal=goal.expand(size, 2), human=human.expand(size, 2), boxes=boxes, batch_size=[size])
    for oracle in STYLES:
        assert (drive(oracle, scene).outcome == Outcome.GOAL).all()


def test_the_slow_one_is_slow_near_the_human_alone(scenes):
    oracle = SlowPassingOracle(slow=0.15, reach=2.4)
    rollouts = drive(oracle, scenes)
    distance, speed = human_distance(rollouts)[:, :-1], rollouts.action[..., 0]
    assert speed[driven(rollouts) & (distance < 1.7)].max() < 0.151
    away = driven(rollouts) & (distance > 2.4)
    away[:, :4] = False  # still turning from the initial heading
    assert speed[away].quantile(0.05) > 0.49
    assert (rollouts.duration > drive(PassingOracle(radius=1.0), scenes).duration + 5).all()


def test_the_waiting_one_pauses_in_front_of_the_human_and_then_drives_on(scenes):
    oracle = WaitingOracle(pause=4.0, distance=1.8, depth=0.2)
    rollouts = drive(oracle, scenes)
    creeps = (rollouts.action[..., 0] < 0.1) & driven(rollouts) & (human_distance(rollouts)[:, :-1] < 2.1)
    assert ((0.2 * creeps.sum(1) - 4.0).abs() <= 0.6).all()
    place = human_distance(rollouts)[:, :-1][creeps]
    assert place.min() > 1.79
    assert place.max() < 2.02
    goal_is_behind = (rollouts.pose[:, :-1, 0] < rollouts.scene.human[:, None, 0])[creeps]
    assert goal_is_behind.all()  # before the human, not after it
    late = drive(PassingOracle(radius=1.0), scenes).duration
    assert ((rollouts.duration - late - 3.6).abs() <= 0.8).all()


def test_a_batch_acts_as_its_rows():
    world = TensorWorld()
    world.reset(SceneSampler()(12, generator=torch.Generator().manual_seed(0)))
    observation = world.observe()
    for oracle in STYLES:
        batch = oracle(observation.reshape(3, 4, 34)).reshape(12, 2)
        assert torch.allclose(batch, torch.stack([oracle(row) for row in observation]), atol=1e-6)


@pytest.mark.parametrize(
    ("style", "numbers", "words"),
    [
        (PassingOracle, {"radius": 0.0}, "radius must be positive"),
        (SlowPassingOracle, {"reach": 0.5}, "reach > radius"),
        (SlowPassingOracle, {"slow": 0.6}, "slow <= speed"),
        (WaitingOracle, {"distance": 0.9}, "distance must exceed 1.0, got 0.9"),
        (WaitingOracle, {"pause": 0.0}, "pause must be positive"),
    ],
)
def test_impossible_numbers_are_refused(style, numbers, words):
    with pytest.raises(ValueError, match=words):
        style(**numbers)
