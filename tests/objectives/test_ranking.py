"""The ranking loss against a slow loop, and that it finds the reward behind a ranking."""

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from morlnav.modules import RewardModel
from morlnav.objectives import RankingLoss


class First(nn.Module):
    """The reward is the first entry of the observation, times a weight."""

    def __init__(self, weight=1.0):
        super().__init__()
        self.weight = nn.Parameter(torch.tensor(weight))

    def forward(self, observation):
        return self.weight * observation[..., 0]


def network(module, in_keys=("observation",)):
    return TensorDictModule(module, list(in_keys), ["reward"])


def snippets(*batch, length=5, masked=False):
    out = TensorDict(
        observation=torch.rand(*batch, length, 34), action=torch.rand(*batch, length, 2), batch_size=list(batch)
    )
    if masked:
        lengths = torch.randint(1, length + 1, batch)
        out["mask"] = torch.arange(length) < lengths.unsqueeze(-1)
    return out


def pairs(*batch, **kwargs):
    return TensorDict(better=snippets(*batch, **kwargs), worse=snippets(*batch, **kwargs), batch_size=list(batch))


def slow_loss(batch, aggregate, temperature):
    losses, right = [], 0
    for pair in batch.unbind(0):
        score = {}
        for name in ("better", "worse"):
            rewards = pair[name]["observation"][:, 0].tolist()
            if "mask" in pair[name]:
                rewards = [r for r, real in zip(rewards, pair[name]["mask"].tolist(), strict=True) if real]
            score[name] = sum(rewards) / (len(rewards) if aggregate == "mean" else 1)
        logit = temperature * (score["better"] - score["worse"])
        losses.append(-math.log(1 / (1 + math.exp(-logit))))
        right += logit > 0
    return sum(losses) / len(losses), right / len(losses)


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(("aggregate", "temperature"), [("mean", 10.0), ("sum", 1.0)])
def test_the_loss_equals_a_slow_loop(aggregate, temperature, masked):
    batch = pairs(16, masked=masked)
    out = RankingLoss(network(First()), aggregate=aggregate, temperature=temperature)(batch)
    loss, accuracy = slow_loss(batch, aggregate, temperature)
    assert out["loss_ranking"].item() == pytest.approx(loss, rel=1e-5)
    assert out["accuracy"].item() == pytest.approx(accuracy)


def test_the_gradient_is_that_of_a_logistic_regression():
    module, batch = First(), pairs(16)
    RankingLoss(network(module))(batch)["loss_ranking"].backward()
    slope = 10 * (batch["better", "observation"] - batch["worse", "observation"])[..., 0].mean(-1)
    torch.testing.assert_close(module.weight.grad, (-slope * (-slope).sigmoid()).mean())


@pytest.mark.parametrize("padding", [1e6, torch.nan, torch.inf])
def test_padding_changes_neither_loss_nor_gradient(padding):
    batch = pairs(4, masked=True)
    loss = RankingLoss(network(First()))
    (gradient,) = torch.autograd.grad(loss(batch)["loss_ranking"], loss.parameters())
    for name in ("better", "worse"):
        batch[name]["observation"][~batch[name]["mask"]] = padding
    padded = loss(batch)["loss_ranking"]
    assert padded.item() == pytest.approx(slow_loss(batch, "mean", 10.0)[0], rel=1e-5)
    torch.testing.assert_close(torch.autograd.grad(padded, loss.parameters()), (gradient,))


def test_snippets_may_differ_in_length_and_rewards_end_in_a_singleton():
    batch = TensorDict(better=snippets(6, length=3), worse=snippets(6, length=7), batch_size=[6])
    batch["worse", "mask"] = torch.ones(6, 7, 1, dtype=torch.bool)
    flat = RankingLoss(network(First()))(batch)["loss_ranking"]
    trailing = TensorDictModule(lambda o: o[..., :1], ["observation"], ["reward"])
    torch.testing.assert_close(RankingLoss(trailing)(batch)["loss_ranking"], flat)


def test_members_learn_from_the_same_snippets_as_if_alone():
    batch, weights = pairs(8), (0.5, 1.0, 2.0)
    members = [First(weight) for weight in weights]
    out = RankingLoss([network(member) for member in members])(batch)
    out["loss_ranking"].backward()
    alone = [First(weight) for weight in weights]
    losses = [RankingLoss(network(member))(batch)["loss_ranking"] for member in alone]
    sum(losses).backward()
    torch.testing.assert_close(out["loss_ranking"], sum(losses))
    assert out["accuracy"].shape == (3,)
    for member, single in zip(members, alone, strict=True):
        torch.testing.assert_close(member.weight.grad, single.weight.grad)


def test_members_learn_from_snippets_of_their_own():
    batch, members = pairs(2, 8), [First(), First()]
    loss = RankingLoss([network(member) for member in members])
    expected = sum(RankingLoss(network(First()))(row)["loss_ranking"] for row in batch.unbind(0))
    torch.testing.assert_close(loss(batch)["loss_ranking"], expected)
    with pytest.raises(ValueError, match="one row for each of the 2 members, got 3"):
        loss(pairs(3, 8))


def test_state_only_and_state_action_members_train_together_and_find_the_reward():
    small = {"action_low": [0.0, -3.14], "action_high": [0.5, 3.14], "features": 34, "depth": 1, "num_cells": 32}
    models = [RewardModel(("observation",), **small), RewardModel(("observation", "action"), **small)]
    loss = RankingLoss([network(models[0]), network(models[1], ("observation", "action"))])
    assert len(list(loss.parameters())) == sum(len(list(model.parameters())) for model in models)
    optimizer = torch.optim.AdamW(loss.parameters(), 3e-3)
    batch = pairs(256)
    better = batch["better", "observation"][..., 2].mean(-1) > batch["worse", "observation"][..., 2].mean(-1)
    keep = better[:, None, None]
    first, second = batch["better", "observation"], batch["worse", "observation"]
    batch["better", "observation"] = torch.where(keep, first, second)
    batch["worse", "observation"] = torch.where(keep, second, first)
    for _ in range(100):
        optimizer.zero_grad()
        out = loss(batch)
        out["loss_ranking"].backward()
        optimizer.step()
    assert (out["accuracy"] > 0.9).all()
    near, far = torch.full((1, 34), 0.5), torch.full((1, 34), 0.5)
    near[:, 2], far[:, 2] = 0.1, 0.9
    for model in models:  # the models given are the ones that were trained
        assert model(far, torch.zeros(1, 2)) > model(near, torch.zeros(1, 2))


def test_keys_can_be_chosen_and_nested():
    loss = RankingLoss(network(First(), [("robot", "view")]), reduction="none")
    loss.set_keys(better=("pair", "a"), worse=("pair", "b"))
    assert loss.in_keys == [("pair", "a", "robot", "view"), ("pair", "b", "robot", "view")]
    sides = {name: {"robot": {"view": torch.rand(4, 5, 34)}} for name in "ab"}
    assert loss(TensorDict({"pair": sides}, [4]))["loss_ranking"].shape == (4,)


def test_the_loss_takes_keyword_arguments_instead_of_a_tensordict():
    loss = RankingLoss(network(First()))
    batch = pairs(4)
    value, _ = loss(better_observation=batch["better", "observation"], worse_observation=batch["worse", "observation"])
    torch.testing.assert_close(value, loss(batch)["loss_ranking"])


@pytest.mark.parametrize(
    ("networks", "wrong"),
    [(None, {"aggregate": "max"}), (None, {"temperature": 0.0}), ([], {})],
)
def test_a_wrong_argument_is_named_in_one_sentence(networks, wrong):
    with pytest.raises(ValueError, match=r"^[^\n]*\.?\d*\.$"):
        RankingLoss(network(First()) if networks is None else networks, **wrong)
