import pytest
import torch
from torchrl.envs import PendulumEnv, TransformedEnv

from morlnav import NavigationEnv
from morlnav.data import UniformPreferences
from morlnav.navigation.world import SceneSampler
from morlnav.objectives import RolloutSearch
from morlnav.objectives.terms import Acted
from morlnav.transforms import DrawPreference

LOW, HIGH = torch.tensor([0.0, -torch.pi]), torch.tensor([0.5, torch.pi])


def make_env(num_envs=1, boxes=0):
    env = NavigationEnv(num_envs=num_envs, scenes=SceneSampler(num_boxes=boxes, heading_noise=0.0), seed=0)
    return TransformedEnv(env, DrawPreference(UniformPreferences(2)))


def acted(action, batch, weights, value=0.0):
    """An actor that does the same everywhere, and critics that see the same everywhere."""
    action = torch.tensor(action)

    def policy(tensordict):
        return action.expand(*tensordict.batch_size, 2)

    def values_of(tensordict):
        return torch.full((2, *tensordict.batch_size, 3), value)

    return Acted(
        batch,
        batch["preference"],
        torch.tensor(weights).expand(len(batch), 3),
        torch.zeros(2, len(batch), 3),
        gamma=torch.tensor([0.9, 0.95, 1.0]),
        values_of=values_of,
        action=policy(batch),
        low=LOW,
        high=HIGH,
        value_of=None,
        policy=policy,
    )


def search(**settings):
    return RolloutSearch(make_env=make_env, **{"states": 16, "copies": 8, "horizon": 5, "hold": 5, **settings})


@pytest.fixture
def batch():
    torch.manual_seed(0)
    return make_env(16).reset()  # the goal lies straight ahead


def test_a_slow_actor_is_drawn_to_a_higher_speed(batch):
    term = search()
    term.actor(acted([0.25, 0.0], batch, [1.0, 0.0, 0.0]))  # progress alone
    better = term.better.bool()
    assert better.float().mean() > 0.7  # some draw no higher speed
    assert term.found[better, 0].mean() > 0.27


def test_who_is_best_already_is_left_alone(batch):
    term = search()
    pull = term.actor(acted([0.5, 0.0], batch, [1.0, 0.0, 0.0]))
    assert not term.better.any()
    assert pull.tolist() == [0.0] * 16


def test_what_is_gained_is_what_the_environment_pays_and_the_critics_see_beyond(batch, monkeypatch):
    seen = {}
    term = search(margin=0.0, reward_unit=lambda reward: 0.01 * reward)
    monkeypatch.setattr(term, "_offsets", lambda half_range: (seen.setdefault("offset", offsets(half_range)), hold))
    hold = torch.full((8 * 16, 1), 5)

    def offsets(half_range):
        offset = torch.zeros(8, 16, 2)
        offset[1:, :, 0] = torch.linspace(-0.2, 0.2, 7)[:, None]
        return offset.flatten(0, 1)

    state = acted([0.25, 0.0], batch, [1.0, 0.0, 0.0], value=2.0)
    term.actor(state)
    assert term.found[:, 0] == pytest.approx(0.45)  # the fastest of the copies
    # The same by hand.
    env = make_env(16)
    now = env.reset(batch.select("pose", "scene", "preference"), set_state=True)
    paid, gamma = torch.zeros(16), 0.9
    for step in range(5):
        now = env.step(now.set("action", torch.tensor([0.25, 0.0]).expand(16, 2)))["next"]
        paid += gamma**step * 0.01 * now["reward"][:, 0]
    assert torch.allclose(term.worth[0], paid + gamma**5 * 2.0, atol=1e-4)


def test_a_roll_out_that_ends_earns_nothing_more(batch):
    batch["pose"][:, :2] = batch["scene", "goal"] - torch.tensor([0.4, 0.0])
    term = search(horizon=20)
    term.actor(acted([0.5, 0.0], batch, [1.0, 0.0, 0.0], value=100.0))
    assert (term.worth[0] < 13).all()  # one step of progress; the critics' 100 never comes


def test_answers_serve_several_updates_and_are_kept_with_the_loss(batch):
    term, state = search(interval=3), acted([0.25, 0.0], batch, [1.0, 0.0, 0.0])
    pulls = [term.actor(state) for _ in range(3)]
    assert torch.equal(pulls[0], pulls[2])
    again = search(interval=3)
    again.load_state_dict(term.state_dict())
    found = term.found.clone()
    assert torch.equal(again.found, found)
    term.actor(state)
    assert not torch.equal(term.found, found)


def test_the_pull_has_a_gradient_to_the_actor_alone(batch):
    term = search()
    parameter = torch.tensor([0.25, 0.0], requires_grad=True)
    state = acted([0.25, 0.0], batch, [1.0, 0.0, 0.0])
    state.policy = lambda tensordict: parameter.expand(*tensordict.batch_size, 2)
    term.actor(state).mean().backward()
    assert parameter.grad[0] < 0  # a descent makes it faster


def test_an_environment_that_cannot_be_set_is_refused():
    with pytest.raises(ValueError, match=r"Forgetful cannot be set to a state .* leave it out \(loss"):
        RolloutSearch(make_env=lambda num_envs: Forgetful())


class Forgetful(PendulumEnv):
    _supports_set_state = False


@pytest.mark.parametrize(
    ("name", "value"), [("states", 0), ("copies", 1), ("horizon", 0), ("hold", 0), ("interval", 0), ("spread", -1.0)]
)
def test_numbers_that_make_no_sense_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} must be at least"):
        search(**{name: value})
