"""The learners written for the comparison do the work that they claim."""

import copy
from itertools import pairwise

import pytest
import torch
from torch import nn

from benchmarks.learner import random_rows
from benchmarks.limit import update_flops
from benchmarks.peers.libraries import torchrl_td3
from benchmarks.peers.minimal_td3 import MinimalTD3
from benchmarks.peers.pd_morl import PDMORL
from benchmarks.peers.stacked_td3 import StackedTD3
from morlnav.modules import Actor, VectorCritic
from morlnav.navigation.modules import NavigationFeatures

LOW, HIGH = torch.tensor([0.0, -3.0]), torch.tensor([0.5, 3.0])


def networks(num_preferences, cells=32, depth=2):
    torch.manual_seed(0)
    settings = {"features": NavigationFeatures(), "depth": depth, "num_cells": cells}
    actor = Actor(num_preferences, LOW, HIGH, **settings)
    return actor, [VectorCritic(4, num_preferences, LOW, HIGH, **settings) for _ in range(2)]


def moved(before, module):
    return [not torch.equal(old, new) for old, new in zip(before.parameters(), module.parameters(), strict=True)]


@pytest.mark.parametrize(("learner", "preferences", "delay"), [(MinimalTD3, 3, 2), (PDMORL, 4, 10)])
def test_critics_move_at_every_step_actor_and_targets_after_the_delay(learner, preferences, delay):
    settings = {"num_preferences": 3} if learner is MinimalTD3 else {}
    it = learner(*networks(preferences), random_rows(64), LOW, HIGH, batch_size=16, **settings)
    parts = {name: getattr(it, name) for name in ("actor", "critics", "target_actor", "target_critics")}
    before = copy.deepcopy(parts)
    for _ in range(delay - 1):
        it.step()
    assert all(moved(before["critics"], it.critics))
    assert not any(any(moved(before[name], parts[name])) for name in parts if name != "critics")
    it.step()
    assert all(any(moved(before[name], parts[name])) for name in parts)


def test_the_minimal_learner_learns():
    rows = random_rows(512) | {"terminated": torch.ones(512, 1, dtype=torch.bool)}  # values are the rewards themselves
    rows["reward"] = rows["action"][:, :1].expand(-1, 4).contiguous()
    learner = MinimalTD3(*networks(3), rows, LOW, HIGH, num_preferences=3, batch_size=128)
    preference = torch.full((512, 3), 1 / 3)

    def error():
        with torch.no_grad():
            return (
                (learner.critics[0](rows["observation"], preference, rows["action"]) - rows["reward"]).square().mean()
            )

    before = error()
    for _ in range(150):
        learner.step()
    assert error() < before / 4


def test_stacked_seeds_learn_as_one_seed_does():
    rows, settings = random_rows(64), {"num_preferences": 3, "batch_size": 16}
    single = MinimalTD3(*networks(3), rows, LOW, HIGH, **settings)
    (actor, critics), (other, others) = networks(3), networks(3)
    stacked = StackedTD3([actor], [critics], rows, LOW, HIGH, **settings)
    for learner in (single, stacked):
        torch.manual_seed(1)
        for _ in range(4):
            learner.step()
    for name, value in single.actor.named_parameters():
        torch.testing.assert_close(stacked.actor[name][0], value, atol=1e-6, rtol=1e-4)
    for index, critic in enumerate(single.target_critics):
        for name, value in critic.named_parameters():
            torch.testing.assert_close(stacked.target_critics[name][0, index], value, atol=1e-6, rtol=1e-4)

    torch.manual_seed(1)
    both = StackedTD3([actor, other], [critics, others], rows, LOW, HIGH, **settings)
    both.step()
    both.step()
    assert all((value[0] != value[1]).any() for value in both.actor.values())  # each draws batches of its own


def test_pd_morl_keeps_every_transition_four_times():
    learner = PDMORL(*networks(4), random_rows(32), LOW, HIGH, batch_size=16)
    assert len(learner.replay) == 4 * 32
    learner.step()
    assert len(learner.replay) == 4 * 33
    preferences = torch.tensor([entry[-1].sum() for entry in learner.replay])
    torch.testing.assert_close(preferences, torch.ones(len(learner.replay)))


def test_torchrls_own_step_runs_on_the_shapes():
    step = torchrl_td3(random_rows(64), LOW, HIGH, [32, 32], batch_size=16)
    step()
    step()


def test_the_fewest_operations_of_an_update_are_those_of_the_papers_networks():
    class Shape(nn.Module):
        def __init__(self, inputs, outputs):
            super().__init__()
            sizes = [inputs, 256, 256, 256, 256, outputs]
            self.layers = nn.Sequential(*(nn.Linear(*pair) for pair in pairwise(sizes)))

    # 34 observed numbers, 3 preferences, 2 actions and 4 objectives
    flops = update_flops(Shape(37, 2), Shape(39, 4), batch_size=256, policy_update_delay=2)
    assert flops == pytest.approx(1.21e9, rel=0.01)
