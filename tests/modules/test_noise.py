"""The noise replaces the promised share of actions, holds them as long as promised, and starts anew with episodes."""

from itertools import groupby

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import Bounded
from torchrl.envs import Compose, InitTracker, StepCounter, TransformedEnv, set_exploration_type
from torchrl.envs.utils import ExplorationType

from morlnav.modules import Actor, EpsilonGreedyNoise, PartlyGreedyNoise
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes

LOW, HIGH = [0.0, -3.14], [0.5, 3.14]


def drive(noise, environments, steps, is_init=None):
    """Which actions were replaced, and the actions, ``[steps, environments, ...]``; the policy always does -1."""
    clean = torch.full((environments, 2), -1.0)
    actions = torch.stack([noise(clean, None if is_init is None else is_init[t]) for t in range(steps)])
    return (actions != -1).any(-1), actions


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.mark.parametrize("hold", [1, 10])
@pytest.mark.parametrize("epsilon", [0.1, 0.5])
def test_the_share_of_noisy_steps_is_epsilon_at_every_step(epsilon, hold):
    noisy, _ = drive(EpsilonGreedyNoise(epsilon, LOW, HIGH, hold), 8000, 30)
    torch.testing.assert_close(noisy.float().mean(1), torch.full((30,), epsilon), atol=0.025, rtol=0)
    torch.testing.assert_close(noisy.float().mean(), torch.tensor(epsilon), atol=0.01, rtol=0)


def test_a_random_action_is_held_for_exactly_as_long_as_told():
    _, actions = drive(EpsilonGreedyNoise(0.4, LOW, HIGH, hold=7), 20, 300)
    lengths = []
    for environment in range(20):
        runs = [(speed, len(list(run))) for speed, run in groupby(actions[:, environment, 0].tolist())]
        assert all(length <= 7 for speed, length in runs if speed != -1)
        lengths += [length for speed, length in runs[1:-1] if speed != -1]  # the ends may be cut by the episode's
    assert len(lengths) > 200
    assert set(lengths) == {7}


def test_without_holding_every_noisy_step_is_drawn_anew_and_independent():
    noisy, actions = drive(EpsilonGreedyNoise(0.5, LOW, HIGH), 2000, 40)
    both = noisy[1:] & noisy[:-1]
    torch.testing.assert_close(both.float().mean(), torch.tensor(0.25), atol=0.01, rtol=0)
    assert (actions[1:] != actions[:-1]).all(-1)[both].all()


def test_random_actions_fill_the_whole_action_range():
    _, actions = drive(EpsilonGreedyNoise(1.0, LOW, HIGH), 4000, 1)
    low, high = torch.tensor(LOW), torch.tensor(HIGH)
    assert ((actions >= low) & (actions <= high)).all()
    unit = (actions[0] - low) / (high - low)
    torch.testing.assert_close(unit.mean(0), torch.full((2,), 1 / 2), atol=0.02, rtol=0)
    torch.testing.assert_close(unit.var(0), torch.full((2,), 1 / 12), atol=0.01, rtol=0)


def test_every_environment_has_its_own_noise_level():
    epsilon = torch.tensor([0.0, 0.25, 1.0]).repeat_interleave(400)
    noise = EpsilonGreedyNoise(epsilon, LOW, HIGH, hold=5)
    share = drive(noise, 1200, 50)[0].float().mean(0).reshape(3, 400).mean(1)
    assert share[0] == 0
    assert share[2] == 1
    assert share[1].item() == pytest.approx(0.25, abs=0.02)


def test_a_held_action_does_not_outlive_its_episode():
    noise = EpsilonGreedyNoise(0.5, LOW, HIGH, hold=1000)
    start = torch.zeros(40, 2000, 1, dtype=torch.bool)
    start[20, :1000] = True
    noisy, _ = drive(noise, 2000, 40, start)
    changed = noisy[19] != noisy[20]
    assert changed[:1000].float().mean().item() == pytest.approx(0.5, abs=0.05)  # drawn afresh
    assert changed[1000:].float().mean() < 0.02


def test_a_generator_makes_the_noise_repeatable():
    def drawn():
        return drive(EpsilonGreedyNoise(0.5, LOW, HIGH, 3, torch.Generator().manual_seed(7)), 5, 20)[1]

    first = drawn()
    torch.rand(3)
    assert torch.equal(drawn(), first)


def test_it_wraps_a_plain_policy_for_the_evaluation():
    clone = Actor(0, LOW, HIGH, 34, depth=1, num_cells=8)
    noise = EpsilonGreedyNoise(torch.tensor([0.0, 1.0]).repeat_interleave(3), LOW, HIGH, hold=4)
    scenes, levels = evaluation_scenes(3), torch.eye(2)
    rollouts = evaluate_policy(noise.around(clone), scenes, levels, max_steps=8, drop_finished=False)
    expected = evaluate_policy(clone, scenes, levels, max_steps=8)
    assert torch.equal(rollouts.action[0], expected.action[0])
    assert not torch.equal(rollouts.action[1], expected.action[1])


def test_it_follows_the_episodes_of_a_collector():
    env = TransformedEnv(NavigationEnv(num_envs=50, seed=0), Compose(StepCounter(5), InitTracker()))
    clone = TensorDictModule(Actor(0, LOW, HIGH, 34, depth=1, num_cells=8), ["observation"], ["action"])
    noise = EpsilonGreedyNoise(0.5, LOW, HIGH, hold=1000)
    policy = TensorDictSequential(clone, TensorDictModule(noise, ["action", "is_init"], ["action"]))
    collector = Collector(env, policy, frames_per_batch=1000, total_frames=1000)
    data = next(iter(collector))
    collector.shutdown()
    held = data["action"][:, 1:] == data["action"][:, :-1]
    noisy = held.all(-1).reshape(-1)
    started = data["is_init"][:, 1:].reshape(-1)
    assert 0.3 < noisy[~started].float().mean() < 0.7  # half of the episodes are driven by one random action
    assert not noisy[started].any()


def test_it_acts_in_a_deterministic_rollout_of_a_single_environment():
    env = TransformedEnv(NavigationEnv(seed=0), InitTracker())
    noise = TensorDictModule(EpsilonGreedyNoise(1.0, LOW, HIGH), ["action", "is_init"], ["action"])
    clone = TensorDictModule(lambda o: torch.zeros(2), ["observation"], ["action"])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert (env.rollout(3, TensorDictSequential(clone, noise))["action"] != 0).all()


def test_mistakes_are_named_in_one_sentence():
    with pytest.raises(ValueError, match=r"between 0 and 1, got 1\.5"):
        EpsilonGreedyNoise(1.5, LOW, HIGH)
    with pytest.raises(ValueError, match="at least 1, got 0"):
        EpsilonGreedyNoise(0.5, LOW, HIGH, hold=0)
    with pytest.raises(ValueError, match=r"Got \[2\] values of epsilon for actions of \[3\]"):
        EpsilonGreedyNoise(torch.rand(2), LOW, HIGH)(torch.zeros(3, 2))
    noise = EpsilonGreedyNoise(0.5, LOW, HIGH)
    noise(torch.zeros(3, 2))
    with pytest.raises(ValueError, match=r"drop_finished=False"):
        noise(torch.zeros(2, 2))
    noise.reset()
    assert noise(torch.zeros(2, 2)).shape == (2, 2)


@pytest.mark.parametrize(("greedy", "quiet"), [(0.0, 0), (0.25, 2), (0.5, 4), (1.0, 8)])
def test_the_greedy_share_of_environments_acts_without_noise(greedy, quiet):
    noise = PartlyGreedyNoise(greedy, spec=Bounded(-1.0, 1.0, shape=(2,)))
    action = noise(TensorDict(action=torch.zeros(3, 8, 2), batch_size=[3, 8]))["action"]
    still = (action == 0).all(-1)
    assert (still == still[0]).all()  # the same environments whenever it is asked
    assert still[0].sum() == quiet
    single = noise(TensorDict(action=torch.zeros(2)))["action"]
    assert (single != 0).all()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert (noise(TensorDict(action=torch.zeros(8, 2), batch_size=[8]))["action"] == 0).all()


def test_a_greedy_share_above_one_is_refused():
    with pytest.raises(ValueError, match=r"between 0 and 1, got 1\.5"):
        PartlyGreedyNoise(1.5)
