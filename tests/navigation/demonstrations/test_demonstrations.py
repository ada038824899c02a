import json
import shutil

import pytest
import torch
from support import configure
from tensordict import NonTensorData
from torchrl.data import LazyTensorStorage, SliceSampler, TensorDictReplayBuffer

from morlnav.config import build
from morlnav.navigation.demonstrations import (
    Disturbance,
    demonstration_settings,
    load_demonstrations,
    record_demonstrations,
    save_demonstrations,
)
from morlnav.navigation.envs import HumanDistance, Transition
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import Contact, PymunkWorld, Scene, SceneSampler, TensorWorld

NUM = 12


def record(num=NUM, **options):
    return record_demonstrations(CircumnavigationOracle(), SceneSampler(), num, **options)


@pytest.fixture(scope="module")
def recorded():
    return record(disturbance=Disturbance(std=0.7))


@pytest.fixture(scope="module")
def data(recorded):
    return recorded[0]


@pytest.fixture
def folder(data, tmp_path):
    save_demonstrations(data, tmp_path / "demos", settings={"std": 0.7})
    return tmp_path / "demos"


def test_only_successful_episodes_are_kept_and_the_others_counted(recorded):
    data, tries = recorded
    assert tries > NUM
    assert data["episode"].unique().tolist() == list(range(NUM))
    assert not data["next", "outcome", "human"].any()
    assert not data["next", "outcome", "box"].any()
    last = torch.cat([data["episode"].diff() != 0, torch.tensor([True])])
    for key in ("done", "terminated", ("outcome", "goal")):
        assert torch.equal(data["next"][key].squeeze(-1), last)


def test_episodes_are_unbroken_and_in_order(data):
    same = data["episode"].diff() == 0
    assert torch.equal(data["step"].diff()[same], torch.ones(int(same.sum()), dtype=torch.long))
    assert (data["step"][1:][~same] == 0).all()
    for key in ("observation", "pose"):
        assert torch.equal(data["next", key][:-1][same], data[key][1:][same])
    assert torch.equal(data["pose"][data["step"] == 0], data["scene", "start"][data["step"] == 0])


def test_executed_actions_lead_from_pose_to_pose(data):
    going = ~data["next", "done"].squeeze(-1)
    moved = TensorWorld().robot.move(data["pose"], data["executed_action"], 0.2)
    assert torch.allclose(moved[going], data["next", "pose"][going], atol=1e-4)


def test_labels_are_the_clean_actions_of_the_demonstrator(data):
    assert torch.allclose(CircumnavigationOracle()(data["observation"]), data["action"], atol=1e-6)
    share = (data["action"] != data["executed_action"]).any(-1).float().mean()
    assert 0.1 < share < 0.35
    robot = TensorWorld().robot
    assert ((data["executed_action"] >= robot.action_low) & (data["executed_action"] <= robot.action_high)).all()


def test_without_a_disturbance_the_clean_action_is_executed():
    data, _ = record(2)
    assert torch.equal(data["action"], data["executed_action"])


def test_pushes_are_held_for_a_few_steps_at_the_expected_rate():
    pushes = Disturbance(start=0.1, max_hold=5, std=0.5).sample(2000, 20, generator=torch.Generator().manual_seed(0))
    on = (pushes != 0).any(-1)
    assert on.float().mean() == pytest.approx(3 / (3 + 9), abs=0.01)  # 3 held steps, 1 / 0.1 - 1 free ones on average
    assert pushes[on].std() == pytest.approx(0.5, abs=0.02)
    runs = [int((pushes[:, 0] == value).all(-1).sum()) for value in pushes[on[:, 0], 0].unique(dim=0)]
    assert set(runs) == {1, 2, 3, 4, 5}


def test_a_seed_fixes_the_recording_and_leaves_the_global_random_state_alone(data):
    state = torch.get_rng_state()
    again, _ = record(disturbance=Disturbance(std=0.7))
    assert torch.equal(state, torch.get_rng_state())
    assert (again == data).all()
    other, _ = record(disturbance=Disturbance(std=0.7), seed=1)
    assert not torch.equal(other["scene", "goal"][:50], data["scene", "goal"][:50])


def test_an_episode_that_goes_on_to_the_goal_after_a_contact_is_no_success():
    box = torch.tensor([[[2.0, 0.0, 0.05, 0.05, 0.0]]])

    def sampler(n, **_):
        free = torch.arange(n) % 2
        boxes = box + torch.tensor([0.0, 1.0, 0.0, 0.0, 0.0]) * -2 * free[:, None, None]
        goal, human = torch.tensor([6.0, 0.0]).expand(n, 2), torch.tensor([3.0, 2.0]).expand(n, 2)
        return Scene(start=torch.zeros(n, 3), goal=goal, human=human, boxes=boxes, batch_size=[n])

    def straight(observation):
        return torch.tensor([0.5, 0.0]).expand(len(observation), 2)

    data, tries = record_demonstrations(straight, sampler, 4, num_envs=8)
    assert tries == 8
    assert (data["scene", "boxes"][:, 0, 1] == -2).all()


def test_a_hidden_human_leaves_the_observations_but_not_the_demonstrator(data):
    hidden, _ = record(disturbance=Disturbance(std=0.7), observe_human=False)
    for entry, full in ((hidden, data), (hidden["next"], data["next"])):
        assert torch.equal(
            entry["observation"], torch.cat([full["observation"][:, :2], full["observation"][:, 4:]], -1)
        )
    assert torch.equal(hidden["action"], data["action"])


def test_the_reference_engine_records_too():
    data, _ = record(1, world=PymunkWorld())
    assert data["next", "outcome", "goal"][-1]


def test_other_objectives_can_be_computed_later(data):
    outcome = data["next", "outcome"]
    transition = Transition(
        data["pose"],
        data["next", "pose"],
        data["executed_action"],
        data["observation"],
        data["next", "observation"],
        contact=Contact(**{key: value.squeeze(-1) for key, value in outcome.items()}, batch_size=data.batch_size),
        scene=Scene(**data["scene"], batch_size=data.batch_size),
    )
    assert torch.allclose(HumanDistance()(transition), data["next", "reward"][:, 1], atol=1e-5)


def test_replay_draws_snippets_of_single_episodes(data):
    sampler = SliceSampler(traj_key="episode", slice_len=25)
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(len(data)), sampler=sampler, batch_size=100)
    replay.extend(data)
    snippets = replay.sample().reshape(4, 25)
    assert (snippets["episode"] == snippets["episode"][:, :1]).all()
    assert (snippets["step"].diff(dim=1) == 1).all()


def test_what_was_saved_is_loaded(data, folder):
    loaded = load_demonstrations(folder)
    assert (loaded == data).all()
    assert not loaded.is_memmap()
    loaded["action"] += 1
    assert (load_demonstrations(folder) == data).all()
    assert demonstration_settings(folder) == {"std": 0.7}
    header = json.loads((folder / "demonstrations.json").read_text())
    assert (header["schema"], header["version"], header["episodes"]) == ("morlnav.demonstrations", 1, NUM)


@pytest.mark.parametrize(("key", "value"), [("version", 2), ("schema", "other.data")])
def test_another_schema_or_version_is_refused(folder, key, value):
    file = folder / "demonstrations.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {key: value}))
    with pytest.raises(ValueError, match=r"this release reads 'morlnav.demonstrations' version 1"):
        load_demonstrations(folder)


def test_missing_cut_and_foreign_files_are_refused(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no demonstrations"):
        load_demonstrations(tmp_path)
    damages = {
        "missing": lambda copy: (copy / "data" / "action.memmap").unlink(),
        "cut": lambda copy: (copy / "data" / "pose.memmap").write_bytes(b"123"),
        "foreign": lambda copy: (copy / "data" / "other.pickle").write_bytes(b"x"),
        "header": lambda copy: (copy / "demonstrations.json").write_text("{"),
    }
    for name, damage in damages.items():
        copy = tmp_path / name
        shutil.copytree(folder, copy)
        damage(copy)
        with pytest.raises(ValueError, match="damaged"):
            load_demonstrations(copy)


@pytest.mark.parametrize("name", ["observation.memmap", "action.memmap", "next/pose.memmap"])
def test_other_content_of_the_same_size_is_refused(folder, tmp_path, name):
    copy = shutil.copytree(folder, tmp_path / "copy")
    content = bytearray((copy / "data" / name).read_bytes())
    end = min(4096, len(content))
    content[:end] = bytes(255 - byte for byte in content[:end])
    (copy / "data" / name).write_bytes(content)
    with pytest.raises(ValueError, match="are damaged: their files hold other content than was saved"):
        load_demonstrations(copy)


def test_pickles_are_neither_saved_nor_loaded(data, folder, tmp_path):
    mixed = data.clone().set("note", NonTensorData(object(), batch_size=data.batch_size))
    with pytest.raises(ValueError, match="no demonstrations that can be saved"):
        save_demonstrations(mixed, tmp_path / "mixed")
    forged = tmp_path / "forged"
    mixed.memmap(forged / "data")
    header = json.loads((folder / "demonstrations.json").read_text())
    files = (file for file in (forged / "data").rglob("*") if file.is_file())
    header["files"] = {file.relative_to(forged / "data").as_posix(): file.stat().st_size for file in files}
    (forged / "demonstrations.json").write_text(json.dumps(header))
    with pytest.raises(ValueError, match="damaged"):
        load_demonstrations(forged)


def test_a_full_folder_is_not_overwritten(data, folder):
    with pytest.raises(FileExistsError, match="new folder"):
        save_demonstrations(data, folder)


def test_a_hopeless_policy_ends_in_a_sentence():
    with pytest.raises(ValueError, match="Only 0 of 40 episodes reached the goal"):
        record_demonstrations(lambda observation: torch.zeros(len(observation), 2), SceneSampler(), 2, max_steps=3)


@pytest.mark.parametrize("options", [{"num": 0}, {"max_steps": 0}, {"num_envs": 0}])
def test_impossible_numbers_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        record(**options)
    with pytest.raises(ValueError, match="disturbance"):
        Disturbance(start=1.5)


def test_the_config_records_with_the_same_defaults():
    cfg = configure("objectives=[baseline,demo]")
    live = {"world": TensorWorld(), "scenes": SceneSampler(), "max_turn": torch.pi, "step_time": 0.2, "sectors": 30}
    source = build(cfg.rewards.demonstrations.demo, "demo", **live)
    assert source.disturbance == Disturbance()
    assert source.num_envs == 256
    default, oracle = CircumnavigationOracle(), source.policy
    assert vars(oracle).keys() == vars(default).keys()
    for name in ("radius", "clockwise", "speed", "band", "sector", "max_turn", "step_time", "sectors"):
        assert getattr(oracle, name) == getattr(default, name)
    assert source.collect(2)["episode"].max() == 1
