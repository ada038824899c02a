import pytest
import torch
from torchrl.envs import PendulumEnv, TransformedEnv

from morlnav import NavigationEnv
from morlnav.data import UniformPreferences
from morlnav.navigation.world import SceneSampler
from morlnav.objectives import PathwiseGradient
from morlnav.objectives.terms import Acted
from morlnav.transforms import DrawPreference

LOW, HIGH = torch.tensor([0.0, -torch.pi]), torch.tensor([0.5, torch.pi])
HALF = (HIGH - LOW) / 2
GAMMA = torch.tensor([0.9, 0.95, 1.0])


def make_env(num_envs=1, boxes=0, **settings):
    scenes = SceneSampler(num_boxes=boxes, heading_noise=0.0)
    env = NavigationEnv(num_envs=num_envs, scenes=scenes, seed=0, **settings)
    return TransformedEnv(env, DrawPreference(UniformPreferences(2)))


def steering(action):
    """A driver who does ``action`` and turns toward the goal as it sees it."""

    def policy(tensordict):
        turn = 0.5 * tensordict["observation"][..., 1:2]
        return torch.cat([torch.zeros_like(turn), turn], -1) + action

    return policy


def acted(policy, batch, weights, slope=0.0):
    """An actor, and critics that value being near the goal."""

    def values_of(tensordict):
        return (-slope * tensordict["observation"][..., :1]).expand(2, *tensordict.batch_size, 3)

    return Acted(
        batch,
        batch["preference"],
        torch.tensor(weights).expand(len(batch), 3),
        torch.zeros(2, len(batch), 3),
        gamma=GAMMA,
        values_of=values_of,
        action=policy(batch),
        low=LOW,
        high=HIGH,
        value_of=None,
        policy=policy,
    )


def term(**settings):
    return PathwiseGradient(make_env=make_env, **{"states": 8, "horizon": 6, "samples": 32, **settings})


@pytest.fixture
def batch():
    torch.manual_seed(0)
    return make_env(8).reset()  # the goal lies straight ahead, the human beside the way


def worth(batch, policy, weights, push, slope):
    """What an episode of six steps earns, by hand and in double precision as far as the world has it."""
    env = make_env(len(batch))
    now = env.reset(batch.select("pose", "scene", "preference"), set_state=True)
    total, gamma = torch.zeros(len(batch), 3, dtype=torch.float64), torch.ones(3)
    for step in range(6):
        now = env.step(now.set("action", (policy(now) + push[step]).clamp(LOW, HIGH)))["next"]
        total += gamma * now["reward"]
        gamma = gamma * GAMMA
    total += gamma * -slope * now["observation"][:, :1]
    return (torch.tensor(weights) * total).sum(-1)


@pytest.mark.parametrize("entry", [0, 1])
@pytest.mark.parametrize("step", [0, 3])
def test_it_is_the_derivative_of_what_is_earned(batch, entry, step):
    batch["pose"][:, :2] = batch["scene", "human"] - torch.tensor([1.2, 0.8])
    policy, weights = steering(torch.tensor([0.3, 0.2])), [1.0, 2.0, 0.5]
    found = term(clip=1e9)
    found.actor(acted(policy, batch, weights, slope=3.0))
    push = torch.zeros(6, 1, 2)
    push[step, 0, entry] = by = 0.02
    rise = worth(batch, policy, weights, push, 3.0) - worth(batch, policy, weights, -push, 3.0)
    assert torch.allclose(found.gradient[step, :, entry], (rise / (2 * by) * HALF[entry]).float(), rtol=0.03, atol=0.02)


def test_the_actor_climbs_it(batch):
    parameter = torch.tensor([0.25, 0.0], requires_grad=True)
    term().actor(acted(steering(parameter), batch, [1.0, 0.0, 0.0])).mean().backward()
    assert parameter.grad[0] < 0  # a descent makes it faster


def test_one_wild_episode_does_not_outweigh_the_others(batch):
    found = term(clip=0.5)
    found.actor(acted(steering(torch.tensor([0.3, 0.2])), batch, [1.0, 1.0, 1.0]))
    reach = 1 - (torch.tensor([0.3, 0.2]) / HALF - torch.tensor([1.0, 0.0])).square()
    assert ((found.gradient * reach).square().sum((0, 2)).sqrt() < 0.55).all()  # turns are a little more than 0.2


def test_an_episode_that_ends_is_driven_no_further(batch):
    batch["pose"][:4, :2] = batch["scene", "goal"][:4] - torch.tensor([0.4, 0.0])
    found = term(clip=1e9)
    found.actor(acted(steering(torch.tensor([0.4, 0.0])), batch, [1.0, 0.0, 0.0], slope=100.0))
    assert found.driven.sum(0).tolist() == [1] * 4 + [6] * 4
    assert (found.gradient[1:, :4] == 0).all()
    assert (found.gradient[0, :4, 0] < 32).all()  # progress alone, no critic


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


def test_one_drive_serves_several_updates_and_is_kept_with_the_loss(batch):
    found, state = term(interval=2, samples=5000), acted(steering(torch.tensor([0.3, 0.0])), batch, [1.0, 1.0, 1.0])
    first = found.actor(state)
    state.batch["pose"][:, 1] += 0.5
    again = term(interval=2)
    again.load_state_dict(found.state_dict())
    assert torch.equal(again.gradient, found.gradient)
    before = found.gradient.clone()
    assert found.actor(state)[0] == pytest.approx(first[0].item(), rel=0.05)
    assert torch.equal(found.gradient, before)
    found.actor(state)
    assert not torch.equal(found.gradient, before)


def test_it_begins_when_it_is_told(batch):
    found, state = term(after=2), acted(steering(torch.tensor([0.3, 0.0])), batch, [1.0, 1.0, 1.0])
    assert [bool(found.actor(state).any()) for _ in range(3)] == [False, False, True]


def test_environments_without_state_or_gradient_are_refused():
    with pytest.raises(ValueError, match=r"Forgetful cannot be set to a state .* leave it out \(loss"):
        PathwiseGradient(make_env=lambda num_envs: Forgetful())
    with pytest.raises(ValueError, match=r"Stiff has no gradient .* leave it out \(loss"):
        PathwiseGradient(states=2, make_env=lambda num_envs: Stiff(num_envs=num_envs))


class Stiff(NavigationEnv):
    @torch.no_grad()
    def _step(self, tensordict):
        return super()._step(tensordict)


class Forgetful(PendulumEnv):
    _supports_set_state = False


@pytest.mark.parametrize(
    ("name", "value"), [("states", 0), ("horizon", 0), ("interval", 0), ("samples", 0), ("after", -1)]
)
def test_numbers_that_make_no_sense_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} must be at least"):
        term(**{name: value})
