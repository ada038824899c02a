import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import DoubleToFloat, GymWrapper, TransformedEnv

from morlnav.data import SnippetPairs, roll_out_ranked
from morlnav.modules import EpsilonGreedyNoise
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.modules import CircumnavigationOracle


def rollouts(lengths: list[list[int]], horizon: int = 40) -> TensorDict:
    """Roll-outs whose observation is (level, episode, time)."""
    steps = torch.tensor(lengths)
    level, episode, time = torch.meshgrid(
        torch.arange(steps.shape[0]), torch.arange(steps.shape[1]), torch.arange(horizon), indexing="ij"
    )
    return TensorDict(
        observation=torch.stack([level, episode, time], -1).float(),
        action=torch.zeros(*steps.shape, horizon, 2),
        mask=time < steps.unsqueeze(-1),
        batch_size=[*steps.shape, horizon],
    )


def test_the_better_snippet_always_has_less_noise():
    pairs = SnippetPairs(rollouts([[30, 40], [30, 40], [35, 25]]), length=20).sample(500)
    better, worse = pairs["better", "observation"], pairs["worse", "observation"]
    assert (better[..., 0] < worse[..., 0]).all()


def test_snippets_are_runs_of_real_steps():
    pairs = SnippetPairs(rollouts([[30, 22], [21, 40]]), length=20).sample(500)
    for side in ("better", "worse"):
        snippet = pairs[side]
        assert snippet["mask"].all()
        assert (snippet["observation"][..., 2].diff(dim=1) == 1).all()


def test_episodes_shorter_than_a_snippet_are_passed_over():
    pairs = SnippetPairs(rollouts([[30, 5], [30, 5]]), length=20).sample(200)
    assert (pairs["better", "observation"][..., 1] == 0).all()


def test_a_worse_snippet_begins_after_the_burn_in_as_far_as_its_rollout_goes():
    pairs = SnippetPairs(rollouts([[30, 30], [40, 24]]), length=20, burn_in=8).sample(500)
    begins = pairs["worse", "observation"][:, 0]
    long, short = (begins[begins[:, 1] == episode][:, 2] for episode in (0, 1))
    assert (long.min(), long.max()) == (8, 20)
    assert (short == 4).all()
    assert pairs["better", "observation"][:, 0, 2].min() == 0


@pytest.mark.parametrize("settings", [{"burn_in": -1}, {"length": None, "burn_in": 1}])
def test_a_burn_in_that_means_nothing_is_refused(settings):
    with pytest.raises(ValueError, match="burn_in must be 0 or more, and 0 for whole roll-outs"):
        SnippetPairs(rollouts([[30], [30]]), **settings)


def test_whole_rollouts_are_padded_and_masked():
    pairs = SnippetPairs(rollouts([[30, 30], [12, 12]]), length=None).sample(50)
    assert (pairs["better", "mask"].sum(1) == 30).all()
    assert (pairs["worse", "mask"].sum(1) == 12).all()


def test_levels_without_long_enough_rollouts_are_refused():
    with pytest.raises(ValueError, match="no roll-out of 20 steps"):
        SnippetPairs(rollouts([[30, 30], [5, 5]]), length=20)
    with pytest.raises(ValueError, match="two noise levels"):
        SnippetPairs(rollouts([[30, 30]]), length=20)


def test_more_noise_earns_less_and_masks_end_with_the_episode():
    torch.manual_seed(0)
    out = roll_out_ranked(
        CircumnavigationOracle(),
        lambda count: NavigationEnv(num_envs=count, seed=0),
        lambda levels: EpsilonGreedyNoise(levels, [0.0, -3.14], [0.5, 3.14], hold=10),
        [0.0, 0.8],
        episodes=12,
        max_steps=120,
    )
    assert out.batch_size[:2] == (2, 12)
    returns = (out["reward"][..., 0] * out["mask"]).sum(-1).mean(1)
    assert returns[0] > returns[1]
    steps = out["mask"].sum(-1)
    assert (out["mask"] == (torch.arange(out.shape[-1]) < steps.unsqueeze(-1))).all()


def test_ended_episodes_of_another_simulator_wait_for_the_others():
    gymnasium.register("Count-v0", entry_point=Counter)

    def count(number):
        env = gymnasium.make_vec("Count-v0", number, "sync", vector_kwargs={"autoreset_mode": "Disabled"})
        return TransformedEnv(GymWrapper(env), DoubleToFloat())

    low, high = torch.tensor([0.0]), torch.tensor([1.0])
    out = roll_out_ranked(
        lambda observation: torch.ones(len(observation), 1),
        count,
        lambda levels: EpsilonGreedyNoise(levels, low, high),
        [0.0, 1.0],
        episodes=3,
        max_steps=12,
    )
    steps = out["mask"].sum(-1)
    assert steps[0].tolist() == [4, 4, 4]
    assert (steps[1] > 4).all()
    for side in range(2):
        for episode, length in zip(out[side], steps[side].tolist(), strict=True):
            real = episode[:length]
            torch.testing.assert_close(real["observation"][1:], real["observation"][:-1] + real["action"][:-1])
            assert (real["reward"] == 1).all()


class Counter(gymnasium.Env):
    """Adds up its actions, and ends at 4."""

    observation_space = gymnasium.spaces.Box(0, 10, (1,))
    action_space = gymnasium.spaces.Box(0, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.sum = np.zeros(1, np.float32)
        return self.sum, {}

    def step(self, action):
        self.sum = self.sum + action
        return self.sum, 1.0, bool(self.sum >= 4), False, {}


def test_noise_levels_must_ascend():
    with pytest.raises(ValueError, match="ascend"):
        roll_out_ranked(CircumnavigationOracle(), None, None, [0.5, 0.1], episodes=1)
