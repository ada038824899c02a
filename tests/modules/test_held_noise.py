"""Exploration by random actions that last."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from morlnav.modules import HeldNoise


def steps(noise, count, first=True, batch=4):
    """What the noise makes of standing still, ``[count, batch]``."""
    actions = []
    for step in range(count):
        is_init = torch.full((batch, 1), first and step == 0)
        given = TensorDict(action=torch.zeros(batch, 1), is_init=is_init, batch_size=[batch])
        actions.append(noise(given)["action"].squeeze(-1))
    return torch.stack(actions)


def made(**settings):
    torch.manual_seed(0)
    return HeldNoise(**settings, action_low=[-1.0], action_high=[1.0])


def test_a_random_action_lasts_as_long_as_it_is_told_to():
    actions = steps(made(epsilon_init=1.0, hold=5), 200)
    changes = (actions.diff(dim=0) != 0).nonzero()
    for environment in range(4):
        at = changes[changes[:, 1] == environment, 0]
        assert (at.diff() == 5).all()


def test_the_share_of_random_steps_falls_from_the_one_to_the_other():
    noise = made(epsilon_init=0.8, epsilon_end=0.2, annealing_num_steps=10, hold=3)
    early = (steps(noise, 500) != 0).float().mean()
    for _ in range(20):
        noise.step()
    assert float(noise.sigma) == pytest.approx(0.2)
    late = (steps(noise, 500) != 0).float().mean()
    assert early == pytest.approx(0.8, abs=0.05)
    assert late == pytest.approx(0.2, abs=0.05)


def test_an_episode_begins_without_what_was_held_in_the_last_one():
    noise = made(epsilon_init=1.0, hold=100)
    before = steps(noise, 3)[-1]
    is_init = torch.tensor([[True], [False], [False], [True]])
    after = noise(TensorDict(action=torch.zeros(4, 1), is_init=is_init, batch_size=[4]))["action"].squeeze(-1)
    assert (after == before).tolist() == [False, True, True, False]


def test_who_does_not_explore_acts_as_the_policy_does():
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert (steps(made(epsilon_init=1.0), 3) == 0).all()


def test_it_goes_on_holding_what_a_checkpoint_holds():
    noise, other = made(epsilon_init=0.7, hold=8), made(epsilon_init=0.5, hold=8)
    steps(noise, 11)
    other.load_state_dict(noise.state_dict())
    state = torch.get_rng_state()
    ours = steps(noise, 30, first=False)
    torch.set_rng_state(state)
    assert (steps(other, 30, first=False) == ours).all()


@pytest.mark.parametrize("settings", [{"epsilon_init": 1.5}, {"epsilon_end": -0.1}, {"annealing_num_steps": 0}])
def test_shares_are_shares(settings):
    with pytest.raises(ValueError, match="epsilon"):
        made(**settings)
