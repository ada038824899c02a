"""Bounds of actions wherever they come in."""

import math

import pytest
import torch
from small_losses import HIGH, LOW, make_loss
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded, Unbounded

from morlnav.modules import Actor, EpsilonGreedyNoise, RewardModel, VectorCritic
from morlnav.objectives import BehaviourCloningLoss
from morlnav.objectives.bounds import action_bounds


def test_the_bounds_of_a_batched_spec_are_those_of_one_action():
    spec = Bounded(LOW.expand(6, 1), HIGH.expand(6, 1))
    loss = make_loss(bounds=None, action_spec=spec)
    assert loss.min_action.tolist() == [-2.0]
    assert loss.max_action.tolist() == [2.0]


@pytest.mark.parametrize(
    ("spec", "bounds", "sentence"),
    [
        (None, None, "exactly one of 'action_spec' and 'bounds'"),
        (Bounded(-1, 1, shape=(1,)), (LOW, HIGH), "exactly one of 'action_spec' and 'bounds'"),
        (Unbounded(1), None, "action_spec must be Bounded, got Unbounded"),
        (None, (HIGH, LOW), "Every lower action bound must be below the upper one"),
        (Bounded(-1.0, math.inf, shape=(1,)), None, r"must be finite, got \[-1.0\] to \[inf\]"),
        (None, (-math.inf, 1.0), "must be finite, got -inf to 1.0"),
        (None, (math.nan, 1.0), "must be finite, got nan to 1.0"),
    ],
)
def test_bounds_that_no_action_can_be_scaled_to_are_named(spec, bounds, sentence):
    with pytest.raises(ValueError, match=sentence):
        action_bounds(spec, bounds)


UNBOUNDED = torch.tensor([0.0, -1.0]), torch.tensor([math.inf, 1.0])
ENTRANCES = {
    "the learner's loss": lambda low, high: make_loss(bounds=(low, high)),
    "the clone's loss": lambda low, high: BehaviourCloningLoss(
        TensorDictModule(nn.Linear(2, 2), ["observation"], ["action"]), bounds=(low, high)
    ),
    "the actor": lambda low, high: Actor(2, low, high, features=3),
    "the critic": lambda low, high: VectorCritic(3, 2, low, high, features=3),
    "the reward model": lambda low, high: RewardModel(["observation"], low, high, features=3),
    "the noise": lambda low, high: EpsilonGreedyNoise(0.5, low, high),
}


@pytest.mark.parametrize("make", ENTRANCES.values(), ids=ENTRANCES)
def test_unbounded_actions_are_refused_wherever_bounds_come_in(make):
    with pytest.raises(ValueError, match=r"Action bounds must be finite, got .*: limit the actions to a range"):
        make(*UNBOUNDED)
