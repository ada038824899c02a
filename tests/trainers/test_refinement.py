from functools import partial

import pytest
import torch
from torch import nn
from torchrl.envs import TransformedEnv

from morlnav import NavigationEnv
from morlnav.data import FixedPreferences, UniformPreferences
from morlnav.navigation.world import SceneSampler
from morlnav.objectives import LinearScalarisation
from morlnav.trainers import PathwiseRefinement
from morlnav.transforms import DrawPreference

GAMMA = torch.tensor([0.9, 0.95, 1.0])
HALF = torch.tensor([0.25, torch.pi])
STEPS = 6


class Steering(nn.Module):
    """A driver who does ``action`` and turns toward the goal as it sees it."""

    def __init__(self, *action):
        super().__init__()
        self.action = nn.Parameter(torch.tensor(action))

    def forward(self, observation, preference):
        turn = 0.5 * observation[..., 1:2]
        return torch.cat([torch.zeros_like(turn), turn], -1) + self.action


def make_env(num_envs=1, boxes=0, preference=(0.75, 0.25), **settings):
    scenes = SceneSampler(num_boxes=boxes, heading_noise=0.0)  # the goal lies straight ahead
    env = NavigationEnv(num_envs=num_envs, scenes=scenes, seed=0, **settings)
    return TransformedEnv(env, DrawPreference(FixedPreferences(preference)))


def make_refinement(make_env=make_env, **settings):
    settings = {"drives": 3, "num_envs": 8, "horizon": STEPS} | settings
    return PathwiseRefinement(make_env=make_env, scalarisation=LinearScalarisation(), **settings)


def earned(actor, begin, push):
    """What an episode earns, a step after the other."""
    env, weights = make_env(len(begin)), torch.tensor([1.0, 0.75, 0.25])
    now, total = env.reset(begin, set_state=True), torch.zeros(len(begin), 3)
    for step in range(STEPS):
        action = (actor(now["observation"], now["preference"]) + push[step]).clamp(*bounds(env))
        now = env.step(now.set("action", action))["next"]
        total += GAMMA**step * now["reward"]
    return (weights * total).sum(-1)


def bounds(env):
    return env.action_spec_unbatched.space.low, env.action_spec_unbatched.space.high


@pytest.fixture
def begin():
    """Robots that are about to pass the human."""
    begin = make_env(8).reset().select("pose", "scene", "preference")
    begin["pose"][:, :2] = begin["scene", "human"] - torch.tensor([1.2, 0.8])
    return begin


def start_at(refinement, begin):
    reset = refinement.env.reset
    refinement.env.reset = lambda: reset(begin, set_state=True)
    return refinement


@pytest.mark.parametrize("entry", [0, 1])
@pytest.mark.parametrize("step", [0, 3])
def test_it_is_the_derivative_of_what_is_earned(begin, entry, step):
    actor = Steering(0.3, 0.2)
    _, _, gradient, _, gained = start_at(make_refinement(clip=1e9), begin)._drive(actor, GAMMA)
    push = torch.zeros(STEPS, 1, 2)
    assert gained == pytest.approx(earned(actor, begin, push).mean().item())
    push[step, 0, entry] = by = 0.02
    rise = earned(actor, begin, push) - earned(actor, begin, -push)
    assert torch.allclose(gradient[step, :, entry], rise / (2 * by), rtol=0.03, atol=1.0)


def test_the_policy_climbs_it_and_the_average_is_kept():
    refinement, actor = make_refinement(average_decay=0.5), Steering(0.25, 0.0)
    first = refinement._drive(actor, GAMMA)[-1]
    refined = refinement(actor, GAMMA)
    assert actor.action[0] == 0.25
    assert 0.25 < refined.action[0] < 0.4  # faster
    assert refinement._drive(refined, GAMMA)[-1] > first


def test_a_seed_fixes_it_whatever_came_before():
    def make_wishful(num_envs):
        return TransformedEnv(NavigationEnv(num_envs=num_envs, seed=0), DrawPreference(UniformPreferences(2)))

    results = []
    for drawn in (3, 5):
        torch.rand(drawn)
        results.append(make_refinement(make_wishful, seed=1)(Steering(0.25, 0.0)).action.detach())
    assert torch.equal(*results)


def test_no_drives_leave_the_policy_as_it_is():
    actor = Steering(0.25, 0.0)
    assert make_refinement(lambda num_envs: None, drives=0)(actor) is actor


def test_one_wild_episode_does_not_outweigh_the_others(begin):
    _, _, gradient, *_ = start_at(make_refinement(clip=0.5), begin)._drive(Steering(0.3, 0.2), GAMMA)
    reach = 1 - (torch.tensor([0.3, 0.2]) / HALF - torch.tensor([1.0, 0.0])).square()
    norms = (gradient * HALF * reach).square().sum((0, 2)).sqrt()
    assert (norms < 0.55).all()  # turns are a little more than 0.2
    assert (norms > 0.4).any()


def test_what_follows_an_episode_is_no_part_of_it():
    begin = make_env(8).reset().select("pose", "scene", "preference")
    begin["pose"][:4, :2] = begin["scene", "goal"][:4] - torch.tensor([0.4, 0.0])
    _, _, gradient, running, _ = start_at(make_refinement(), begin)._drive(Steering(0.4, 0.0), GAMMA)
    assert running.sum(0).tolist() == [1] * 4 + [STEPS] * 4
    assert (gradient[1:, :4] == 0).all()


def test_contact_repels_before_it_is_made():
    env = make_env(1, boxes=1, objectives=None)
    now = env.reset()
    box = now["scene", "boxes"][:, 0]
    now["scene", "boxes"][:, 0, 4] = 0.0
    side = box[:, :2] - torch.stack([box[:, 2] + 0.18 + 0.13, torch.zeros(1)], -1)
    now["pose"] = torch.cat([side, torch.zeros(1, 1)], -1)
    now = env.reset(now.select("pose", "scene", "preference"), set_state=True)
    speed = torch.tensor([[0.4, 0.0]], requires_grad=True)  # to 5 cm before the box
    reward = env.step(now.set("action", speed))["next", "reward"][0, 0]
    assert reward > -20
    (slope,) = torch.autograd.grad(reward, speed)
    assert slope[0, 0] < -20
    with torch.no_grad():
        now = env.reset(now.select("pose", "scene", "preference"), set_state=True)
        assert env.step(now.set("action", speed))["next", "reward"][0, 0] == reward


def test_an_environment_without_a_gradient_is_refused():
    class Stiff(NavigationEnv):
        @torch.no_grad()
        def _step(self, tensordict):
            return super()._step(tensordict)

    def make_stiff(num_envs):
        return TransformedEnv(Stiff(num_envs=num_envs), DrawPreference(FixedPreferences([0.5, 0.5])))

    with pytest.raises(ValueError, match=r"Stiff has no gradient .* leave it out \(refinement\.drives=0"):
        make_refinement(make_stiff)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"drives": -1}, "drives must not be negative"),
        ({"num_envs": 0}, "num_envs must be at least 1"),
        ({"horizon": 0}, "horizon must be at least 1"),
        ({"clip": 0.0}, "clip must be positive"),
        ({"average_decay": 1.0}, "average_decay must be from 0 to below 1"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        make_refinement(**settings)


def test_divergence_is_named():
    with pytest.raises(ValueError, match=r"diverged after 1 drives; lower refinement\.optimizer\.lr"):
        make_refinement(optimizer=partial(torch.optim.Adam, lr=1e37), schedule=None)(Steering(0.3, 0.0))
