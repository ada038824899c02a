import pytest
import torch

from morlnav.navigation.demonstrations import (
    Disturbance,
    demonstrations_digest,
    record_demonstrations,
    recorded_demonstrations,
    replay_demonstrations,
    save_demonstrations,
)
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import Lidar, PymunkWorld, SceneSampler, TensorWorld
from morlnav.navigation.world.geometry import distance_to_box


@pytest.fixture(scope="module")
def data():
    return record_demonstrations(CircumnavigationOracle(), SceneSampler(), 3, disturbance=Disturbance(), num_envs=8)[0]


@pytest.fixture
def folder(data, tmp_path):
    save_demonstrations(data, tmp_path / "demos")
    return tmp_path / "demos"


def episode(data, number):
    return data[data["episode"] == number]


def test_a_folder_is_taken_as_it_is(data, folder):
    again, tries = recorded_demonstrations(folder)
    assert (again == data).all()
    assert tries == 3


def test_the_digest_notices_another_recording(data, folder, tmp_path):
    digest = demonstrations_digest(folder)
    assert recorded_demonstrations(folder, digest=digest)[1] == 3
    changed = data.clone()
    changed["action"][0] += 0.1
    save_demonstrations(changed, tmp_path / "other")
    assert demonstrations_digest(tmp_path / "other") != digest
    with pytest.raises(ValueError, match="have changed"):
        recorded_demonstrations(tmp_path / "other", digest=digest)


def test_replays_drive_the_same_path_among_other_boxes(data):
    many, tries = replay_demonstrations(data, SceneSampler(num_boxes=4), 5)
    assert tries >= 5
    assert many["episode"].unique().tolist() == list(range(5))
    layouts = set()
    for number in range(5):
        replay = episode(many, number)
        source = min(range(3), key=lambda n: (episode(data, n)["scene", "goal"][0] - replay["scene", "goal"][0]).norm())
        original = episode(data, source)
        for key in ("pose", "action", "executed_action"):
            torch.testing.assert_close(replay[key], original[key], atol=1e-5, rtol=0)
        assert torch.equal(replay["observation"][:, :4], original["observation"][:, :4])
        assert replay["scene", "boxes"].shape[1:] == (4, 5)
        gap = distance_to_box(replay["pose"][:, None, :2], replay["scene", "boxes"])
        assert gap.min() > TensorWorld().robot.radius
        layouts.add(replay["scene", "boxes"][0].sum().item())
        assert replay["next", "outcome", "goal"][-1]
    assert len(layouts) == 5


def test_boxes_lie_between_start_and_goal_wherever_these_are(data):
    turned = data.clone()
    angle, shift = torch.tensor(2.0), torch.tensor([5.0, -3.0])
    rotation = torch.tensor([[angle.cos(), angle.sin()], [-angle.sin(), angle.cos()]])
    for entry in (turned["scene", "start"], turned["pose"], turned["next", "pose"]):
        entry[:, :2] = entry[:, :2] @ rotation + shift
        entry[:, 2] += angle
    for name in ("goal", "human"):
        turned["scene", name] = turned["scene", name] @ rotation + shift
    here, there = (replay_demonstrations(part, SceneSampler(), 3)[0] for part in (data, turned))
    torch.testing.assert_close(there["observation"], here["observation"], atol=1e-3, rtol=1e-3)


def test_replays_run_on_the_reference_engine_and_a_seed_fixes_them(data):
    first, again = (replay_demonstrations(data, SceneSampler(), 2, seed=1)[0] for _ in range(2))
    assert (first == again).all()
    assert replay_demonstrations(data, SceneSampler(), 1, world=PymunkWorld())[0]["next", "outcome", "goal"][-1]


def test_replays_without_a_way_through_end_in_a_sentence(data):
    crowded = SceneSampler(num_boxes=15, box_half_side=(0.5, 0.5), band=1.0)
    with pytest.raises(ValueError, match="replays touched no box, 2 are wanted"):
        replay_demonstrations(data, crowded, 2)


def test_the_human_may_be_hidden_and_another_lidar_is_noticed(data, folder):
    hidden, _ = recorded_demonstrations(folder, observe_human=False)
    assert torch.equal(hidden["observation"], torch.cat([data["observation"][:, :2], data["observation"][:, 4:]], -1))
    with pytest.raises(ValueError, match="hold observations of 34 numbers, the world has 24"):
        recorded_demonstrations(folder, world=TensorWorld(lidar=Lidar(sectors=20)))
