"""Reward models: bounded, ensembled, normalised by hand-checked numbers, and kept on disk without pickled code."""

import json

import pytest
import torch
from torch import nn

from morlnav.modules import NormalisedReward, RewardEnsemble, RewardModel, load_reward, read_facts, save_reward
from morlnav.navigation.modules import NavigationFeatures

SMALL = {"depth": 1, "num_cells": 8}


class Entry(nn.Module):
    """The reward is one entry of the observation."""

    inputs = ("observation",)

    def __init__(self, entry=0):
        super().__init__()
        self.entry = entry

    def forward(self, observation, action=None):
        return observation[..., self.entry]


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.fixture
def model():
    members = [RewardModel(("observation",), **SMALL), RewardModel(("observation", "action"), **SMALL)]
    return NormalisedReward(RewardEnsemble(members, "pessimistic"), low=0.1, high=0.6)


@pytest.mark.parametrize("batch", [(), (7,), (3, 25)])
@pytest.mark.parametrize("inputs", [("observation",), ("observation", "action")])
def test_the_reward_lies_between_zero_and_one(inputs, batch):
    reward = RewardModel(inputs)(torch.rand(*batch, 34) * 4, torch.rand(*batch, 2))
    assert reward.shape == batch
    assert ((reward > 0) & (reward < 1)).all()


def test_the_default_is_the_papers_network():
    layers = [layer for layer in RewardModel().mlp if isinstance(layer, nn.Linear)]
    assert [layer.out_features for layer in layers] == [256, 256, 256, 256, 1]


def test_only_a_state_action_model_sees_the_action():
    observation, slow, fast = torch.rand(5, 34), torch.zeros(5, 2), torch.full((5, 2), 0.5)
    state, both = RewardModel(("observation",), **SMALL), RewardModel(("observation", "action"), **SMALL)
    assert torch.equal(state(observation, slow), state(observation, fast))
    assert torch.equal(state(observation), state(observation, fast))
    assert not torch.equal(both(observation, slow), both(observation, fast))
    with pytest.raises(ValueError, match="give both"):
        both(observation)


def test_the_action_is_normalised():
    model = RewardModel(depth=0, action_low=[0.0, -2.0], action_high=[0.5, 2.0])
    with torch.no_grad():
        model.mlp[0].weight.zero_()[0, -2:] = torch.tensor([1.0, 3.0])
    rewards = model(torch.rand(2, 34), torch.tensor([[0.0, 2.0], [0.5, 0.0]]))
    torch.testing.assert_close(rewards, torch.tensor([-1.0 + 3.0, 1.0]).sigmoid())


def test_an_ensemble_takes_the_mean_or_the_mean_less_the_deviation():
    observation = torch.tensor([[0.2, 0.4, 0.9], [0.0, 0.0, 0.6], [0.5, 0.5, 0.5]])
    members = [Entry(0), Entry(1), Entry(2)]
    torch.testing.assert_close(RewardEnsemble(members)(observation), torch.tensor([0.5, 0.2, 0.5]))
    # deviations √(0.26 / 2) and √(0.24 / 2); the second mean is smaller than its own
    pessimistic = RewardEnsemble(members, "pessimistic")(observation)
    torch.testing.assert_close(pessimistic, torch.tensor([0.5 - 0.13**0.5, 0.0, 0.5]))


def test_an_ensemble_mixes_what_its_members_read(model):
    assert model.inputs == ("observation", "action")
    assert RewardEnsemble([Entry()]).inputs == ("observation",)


def test_normalising_maps_low_to_zero_and_high_to_one_and_clips():
    reward = NormalisedReward(Entry(), low=0.2, high=0.7)(torch.tensor([[0.1], [0.2], [0.45], [0.7], [0.9]]))
    torch.testing.assert_close(reward, torch.tensor([0.0, 0.0, 0.5, 1.0, 1.0]))


@pytest.mark.parametrize("chunk", [7, 1000])
def test_fitting_takes_the_low_quantile_of_all_and_the_median_of_clean_steps(chunk):
    observation = torch.randperm(101).unsqueeze(-1) / 100
    clean = observation[:, 0] >= 0.6  # 0.60, 0.61, ..., 1.00
    model = NormalisedReward(Entry()).fit(observation, None, clean, chunk=chunk)
    torch.testing.assert_close(model.low, torch.tensor(0.05))
    torch.testing.assert_close(model.high, torch.tensor(0.80))
    assert not model(observation).requires_grad


def test_fitting_refuses_a_model_that_does_not_prefer_the_demonstration():
    observation = torch.linspace(0, 1, 101).unsqueeze(-1)
    with pytest.raises(ValueError, match="does not rank the demonstration first"):
        NormalisedReward(Entry()).fit(observation, None, observation[:, 0] < 0.02)
    with pytest.raises(ValueError, match="got none"):
        NormalisedReward(Entry()).fit(observation, None, observation[:, 0] > 2)


def test_a_saved_model_comes_back_frozen_and_exactly_the_same(model, tmp_path):
    path = tmp_path / "new" / "reward.pt"
    save_reward(model, path, {"audit": {"rank": 1, "margin": 24.0}})
    loaded = load_reward(path)
    observation, action = torch.rand(50, 34), torch.rand(50, 2)
    assert torch.equal(loaded(observation, action), model(observation, action))
    assert not loaded.training
    assert not any(parameter.requires_grad for parameter in loaded.parameters())
    facts = read_facts(path)
    assert facts["inputs"] == ["observation", "action"]
    assert facts["facts"] == {"audit": {"rank": 1, "margin": 24.0}}
    assert facts["model"]["low"] == pytest.approx(0.1)


def test_the_shape_of_observation_and_action_is_kept(tmp_path):
    features = NavigationFeatures(observe_human=False, lidar_range=6.0, sectors=12, octaves=2)
    save_reward(RewardModel(features=features, action_high=[1.0, 2.0], **SMALL), tmp_path / "reward.pt")
    loaded = load_reward(tmp_path / "reward.pt")
    assert loaded.features.config() == features.config()
    assert loaded(torch.rand(3, 14), torch.rand(3, 2)).shape == (3,)


def test_what_is_missing_or_damaged_is_named_in_one_sentence(model, tmp_path):
    path = tmp_path / "reward.pt"
    with pytest.raises(FileNotFoundError, match=r"^There is no .*\.$"):
        load_reward(path)
    save_reward(model, path)
    facts = json.loads(path.with_suffix(".json").read_text())

    def describe(**changes):
        path.with_suffix(".json").write_text(json.dumps({**facts, **changes}))

    describe(model={"class": "os.system", "command": "echo"})
    with pytest.raises(ValueError, match="describes no reward model"):
        load_reward(path)
    describe(model={"class": "RewardModel", "depth": 3})
    with pytest.raises(ValueError, match="does not hold the weights"):
        load_reward(path)
    describe()
    for content in (b"", b"nonsense", b"cos\nsystem\n(S'echo'\ntR."):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="does not hold the weights"):
            load_reward(path)
    torch.save(nn.Linear(2, 2), path)  # pickled code
    with pytest.raises(ValueError, match="does not hold the weights"):
        load_reward(path)
    path.with_suffix(".json").write_text("{")
    with pytest.raises(ValueError, match="does not describe a reward model"):
        load_reward(path)


def test_foreign_parts_are_not_saved(tmp_path):
    with pytest.raises(ValueError, match="made of RewardModel, RewardEnsemble, NormalisedReward, got Entry"):
        save_reward(RewardEnsemble([Entry()]), tmp_path / "reward.pt")
    features = nn.Identity()
    features.out_features = 34
    with pytest.raises(ValueError, match="Only NavigationFeatures"):
        save_reward(RewardModel(features=features, **SMALL), tmp_path / "reward.pt")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    "build",
    [
        lambda: RewardModel(("action",)),
        lambda: RewardEnsemble([]),
        lambda: RewardEnsemble([Entry()], "pessimistic"),
        lambda: RewardEnsemble([Entry()], "median"),
        lambda: NormalisedReward(Entry(), low=0.5, high=0.5),
    ],
)
def test_a_wrong_argument_is_named_in_one_sentence(build):
    with pytest.raises(ValueError, match=r"^[^\n]+$"):
        build()


def test_features_may_leave_the_lidar_out():
    observation = torch.rand(5, 34)
    blind = observation.clone()
    blind[:, 4:] = 4.0
    features = NavigationFeatures(use_lidar=False)
    assert torch.equal(features(observation), features(blind))
    assert not torch.equal(NavigationFeatures()(observation), NavigationFeatures()(blind))


def test_octaves_are_waves_of_the_distances():
    observation = torch.zeros(1, 34)
    observation[:, 0], observation[:, 2] = 8.0, 1.0
    features = NavigationFeatures(use_lidar=False, octaves=4)(observation)[0]
    goal, human = features[4:12], features[16:24]
    wave = torch.pi * torch.tensor([1.0, 2.0, 4.0, 8.0])  # wavelengths 16, 8, 4 and 2 m
    torch.testing.assert_close(goal, torch.cat([wave.sin(), wave.cos()]), atol=1e-5, rtol=0)
    torch.testing.assert_close(human, torch.cat([(wave / 8).sin(), (wave / 8).cos()]), atol=1e-5, rtol=0)
