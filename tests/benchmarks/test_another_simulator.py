import numpy as np
import pytest
import torch
from torch import nn

import morlnav
from benchmarks.another_simulator import EULER, Simulator, compare
from morlnav.deployment import Policy
from morlnav.modules import Actor
from morlnav.navigation.evaluation import evaluation_scenes, exact_front
from morlnav.navigation.world import TensorWorld


class Straight(nn.Module):
    """Full speed toward the goal, whatever is in the way."""

    def forward(self, observation, preference):
        return torch.stack([torch.full_like(observation[:, 0], 0.5), observation[:, 1].clamp(-1, 1)], -1)


def test_it_sees_what_morlnavs_world_shows():
    scenes = evaluation_scenes(50, seed=1)
    world = TensorWorld()
    world.reset(scenes)
    ours, theirs = world.observe(), torch.from_numpy(Simulator(scenes).observe()).float()
    torch.testing.assert_close(ours[:, :4], theirs[:, :4], atol=1e-5, rtol=0)
    assert ((ours[:, 4:] - theirs[:, 4:]).abs() > 1e-3).float().mean() < 5e-3  # rays that graze an edge


def test_an_episode_ends_at_the_goal_or_in_contact():
    scenes = evaluation_scenes(20, seed=2)
    scenes.start[:, 2] = 0.0  # toward the goal, and the human
    clear = scenes.clone()
    clear.human[:, 1] += 50.0
    clear.boxes[:, :, 1] += 50.0
    met, free = (Simulator(each).drive(Straight(), torch.eye(3)[[1]].expand(20, 3)) for each in (scenes, clear))
    assert free["success"].all()
    assert not met["success"].any()
    np.testing.assert_allclose(free["time"], (clear.goal[:, 0].numpy() - 0.35) / 0.5, atol=EULER + 1e-6)
    hit = met["min_human_distance"] <= 0.48
    assert hit.any()
    assert (met["min_human_distance"][hit] > 0.48 - 0.5 * EULER - 1e-6).all()


def test_the_kept_policy_drives_there_as_it_does_here():
    scenes = evaluation_scenes(4, seed=12345)
    table = compare(morlnav.load("results/default"), scenes, exact_front(scenes), steps=2)
    assert (table["success"] == 1).all()
    assert abs(table["front_share"].diff().iloc[1]) < 0.02
    assert abs(table["min_human_distance"].diff().iloc[1]) < 0.02


def test_a_policy_of_other_styles_is_refused():
    policy = Policy(Actor(2, [0.0, -3.14], [0.5, 3.14], features=34), ("demo", "efficiency"))
    with pytest.raises(ValueError, match="weighs demo, efficiency, but no distance"):
        compare(policy, evaluation_scenes(1), None)
