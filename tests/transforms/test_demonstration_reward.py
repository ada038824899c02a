"""The demonstration entry: rewarded at s_t and a_t, in the right place, in environments and replay buffers alike."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, RewardSum, SerialEnv, StepCounter, TransformedEnv, check_env_specs

from morlnav.config import build
from morlnav.modules import RewardModel, save_module
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.evaluation import reward_terms
from morlnav.transforms import DemonstrationReward, RewardVector

SIZES = {"action_low": [0.0, -3.14], "action_high": [0.5, 3.14], "features": 34}


class Slow(nn.Module):
    """Rewards standing still, and goals that are near; the weight only has gradients to be tempted by."""

    def __init__(self):
        super().__init__()
        self.weight = nn.Parameter(torch.tensor(1.0))
        self.dropout = nn.Dropout(0.9)

    def forward(self, observation, action):
        return self.dropout(self.weight * (1 - 2 * action[..., 0]) * (-observation[..., 0] / 12).exp())


def expected(rollout, scale=10.0, offset=-1.0):
    return scale * (Slow().eval()(rollout["observation"], rollout["action"]).detach() + offset)


def make_env(*transforms, num_envs=3):
    return TransformedEnv(NavigationEnv(num_envs=num_envs, seed=0), Compose(*transforms))


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.mark.parametrize("num_envs", [None, 1, 3])
def test_the_environments_reward_grows_by_the_entry(num_envs):
    env = make_env(DemonstrationReward(Slow()), num_envs=num_envs)
    plain = NavigationEnv(num_envs=num_envs, seed=0)
    check_env_specs(env)
    assert env.reward_spec.shape == (*env.batch_size, 4)
    env.set_seed(1)
    plain.set_seed(1)
    rollout = env.rollout(5)
    reward = rollout["next", "reward"]
    torch.testing.assert_close(reward[..., 1], expected(rollout))
    actions = iter(rollout["action"].unbind(-2))
    baseline = plain.rollout(5, lambda tensordict: tensordict.set("action", next(actions)))["next", "reward"]
    torch.testing.assert_close(reward[..., [0, 2, 3]], baseline)


@pytest.mark.parametrize(("insert", "shape"), [(True, 4), (False, 3)])
@pytest.mark.parametrize("entry", [0, 1, 2])
def test_the_entry_stands_where_it_is_told(entry, insert, shape):
    env = make_env(DemonstrationReward(Slow(), entry=entry, insert=insert))
    check_env_specs(env)
    rollout = env.rollout(4)
    assert rollout["next", "reward"].shape == (3, 4, shape)
    torch.testing.assert_close(rollout["next", "reward"][..., entry], expected(rollout))
    data = TensorDict(observation=torch.rand(34), action=torch.rand(2), reward=torch.tensor([11.0, 12.0, 13.0]))
    others = [i for i in range(shape) if i != entry]
    kept = [11.0, 12.0, 13.0] if insert else [(11.0, 12.0, 13.0)[i] for i in others]
    assert DemonstrationReward(Slow(), entry=entry, insert=insert)(data)["reward"][others].tolist() == kept


def test_the_default_offset_only_punishes_and_the_printed_one_only_pays():
    for offset, low in ((-1.0, -10.0), (1.0, 10.0)):
        rollout = make_env(DemonstrationReward(RewardModel(("observation", "action"), **SIZES), offset=offset)).rollout(
            4
        )
        entry = rollout["next", "reward"][..., 1]
        assert ((entry >= low) & (entry <= low + 10)).all()


def test_a_replay_buffer_rewards_what_it_samples_and_keeps_what_it_stored():
    data = NavigationEnv(num_envs=4, seed=0).rollout(5).reshape(-1)
    transform = DemonstrationReward(Slow(), reward_key=("next", "reward"))
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(100), batch_size=16, transform=transform)
    buffer.extend(data)
    batch = buffer.sample()
    assert batch["next", "reward"].shape == (16, 4)
    torch.testing.assert_close(batch["next", "reward"][:, 1], expected(batch))
    assert buffer.storage.get(torch.arange(20))["next", "reward"].shape == (20, 3)


def test_environment_and_buffer_agree():
    env = make_env(DemonstrationReward(Slow()))
    rollout = env.rollout(5)
    bare = rollout.exclude(("next", "reward"))
    bare["next", "reward"] = rollout["next", "reward"][..., [0, 2, 3]]
    rewarded = DemonstrationReward(Slow(), reward_key=("next", "reward"))(bare)
    torch.testing.assert_close(rewarded["next", "reward"], rollout["next", "reward"])


def test_it_tells_an_environment_without_transforms_what_it_pays():
    transformed = make_env(DemonstrationReward(Slow()))
    env = NavigationEnv(objectives=reward_terms(transformed), num_envs=3, seed=0)
    assert env.objectives == RewardVector.of(transformed).objectives == ("demo", "distance", "efficiency")
    torch.testing.assert_close(env.reward_bounds, RewardVector.of(transformed).bounds)
    check_env_specs(env)
    rollout = env.rollout(5)
    torch.testing.assert_close(rollout["next", "reward"][..., 1], expected(rollout))
    assert not rollout["next", "reward"].requires_grad


def test_written_over_an_entry_it_pays_in_its_place():
    transformed = make_env(DemonstrationReward(Slow(), entry=2, insert=False))
    env = NavigationEnv(objectives=reward_terms(transformed), num_envs=3, seed=0)
    assert env.objectives == ("distance", "efficiency")
    rollout = env.rollout(5)
    torch.testing.assert_close(rollout["next", "reward"][..., 2], expected(rollout))


def test_where_the_human_is_hidden_the_reward_does_not_see_it():
    length = lambda observation, action: observation.shape[-1] + 0 * action[..., 0]  # noqa: E731
    for observe_human, entries in ((True, 34), (False, 32)):
        base = NavigationEnv(num_envs=2, observe_human=observe_human)
        env = TransformedEnv(base, DemonstrationReward(length, 1.0, 0.0))
        assert (env.rollout(1)["next", "reward"][..., 1] == entries).all()
        rollout = NavigationEnv(objectives=reward_terms(env), num_envs=2).rollout(1)  # itself with the human
        assert (rollout["next", "reward"][..., 1] == entries).all()


def test_a_saved_reward_is_paid(tmp_path):
    save_module(RewardModel(("observation",), **SIZES, depth=1, num_cells=8), tmp_path / "reward.pt")
    node = {"_target_": "morlnav.modules.load_module", "path": str(tmp_path / "reward.pt")}
    transform = build({"_target_": "morlnav.transforms.DemonstrationReward", "reward_model": node, "offset": 1.0})
    entry = make_env(transform).rollout(1)["next", "reward"][..., 1]
    assert ((entry >= 10) & (entry <= 20)).all()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "abc", None], ids=str)
@pytest.mark.parametrize("name", ["scale", "offset"])
def test_scale_and_offset_must_be_finite_numbers(name, value):
    with pytest.raises(ValueError, match=f"DemonstrationReward needs a finite number as {name}, got {value}"):
        DemonstrationReward(Slow(), **{name: value})


def test_the_reward_model_is_a_frozen_copy():
    original = Slow().train()
    transform = DemonstrationReward(original).train()
    assert original.training
    assert original.weight.requires_grad
    assert not transform.reward_model.training
    assert not any(parameter.requires_grad for parameter in transform.parameters())
    data = TensorDict(observation=torch.rand(5, 34), action=torch.rand(5, 2), reward=torch.zeros(5, 3), batch_size=[5])
    data["observation"].requires_grad_()
    assert transform(data)["reward"].requires_grad  # in what it judges


def test_returns_collectors_and_serial_environments_see_the_new_entry():
    def worker():
        return make_env(DemonstrationReward(Slow()), num_envs=2)

    env = SerialEnv(2, worker)
    check_env_specs(env)
    env = make_env(StepCounter(4), DemonstrationReward(Slow()), RewardSum())
    collector = Collector(env, None, frames_per_batch=12, total_frames=12)
    batch = next(iter(collector))
    collector.shutdown()
    torch.testing.assert_close(batch["next", "episode_reward"][:, -1], batch["next", "reward"].sum(1))
    outer = TransformedEnv(SerialEnv(2, lambda: NavigationEnv(num_envs=2)), DemonstrationReward(Slow()))
    check_env_specs(outer)


def test_keys_can_be_named():
    keys = {"observation_key": ("robot", "view"), "action_key": ("robot", "command"), "reward_key": ("robot", "pay")}
    robot = {"view": torch.rand(5, 34), "command": torch.rand(5, 2), "pay": torch.zeros(5, 1)}
    assert DemonstrationReward(Slow(), **keys)(TensorDict({"robot": robot}, [5]))["robot", "pay"].shape == (5, 2)


def test_an_entry_beyond_the_vector_is_named_in_one_sentence():
    with pytest.raises(ValueError, match=r"entry must not be negative, got -1\."):
        DemonstrationReward(Slow(), entry=-1)
    with pytest.raises(ValueError, match=r"Entry 4 cannot be inserted into a reward vector of 3\."):
        make_env(DemonstrationReward(Slow(), entry=4)).rollout(1)
    with pytest.raises(ValueError, match=r"Entry 3 cannot be written over in a reward vector of 3\."):
        make_env(DemonstrationReward(Slow(), entry=3, insert=False)).rollout(1)
