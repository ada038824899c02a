"""Reward models: bounded, ensembled, and normalised by hand-checked numbers."""

import pytest
import torch
from torch import nn

from morlnav.modules import NormalisedReward, RewardEnsemble, RewardModel

SIZES = {"action_low": [0.0, -3.14], "action_high": [0.5, 3.14], "features": 34}
SMALL = {**SIZES, "depth": 1, "num_cells": 8}


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
    reward = RewardModel(inputs, **SIZES)(torch.rand(*batch, 34) * 4, torch.rand(*batch, 2))
    assert reward.shape == batch
    assert ((reward > 0) & (reward < 1)).all()


def test_depth_and_width_are_as_told():
    layers = RewardModel(("observation",), **SIZES, depth=4, num_cells=256).mlp.layers
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
    model = RewardModel(("observation", "action"), [0.0, -2.0], [0.5, 2.0], features=34, depth=0)
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


def test_an_ensemble_needs_whatever_one_of_its_members_reads(model):
    with pytest.raises(ValueError, match="reads observation and action; give both"):
        model(torch.rand(7, 34))


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


@pytest.mark.parametrize(
    "build",
    [
        lambda: RewardModel(("action",), **SIZES),
        lambda: RewardEnsemble([]),
        lambda: RewardEnsemble([Entry()], "pessimistic"),
        lambda: RewardEnsemble([Entry()], "median"),
        lambda: NormalisedReward(Entry(), low=0.5, high=0.5),
    ],
)
def test_a_wrong_argument_is_named_in_one_sentence(build):
    with pytest.raises(ValueError, match=r"^[^\n]+$"):
        build()
