"""A preference is drawn at reset, carried through the episode, and can be chosen by the user."""

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, ParallelEnv, PendulumEnv, SerialEnv, StepCounter, TransformedEnv, check_env_specs

from morlnav.data.preferences import SegmentedPreferences, UniformPreferences
from morlnav.transforms.preference import DrawPreference

CORNERS = torch.eye(3)


class Drift(EnvBase):
    """Adds the action to the position; environment i ends its episodes after i + 2 steps."""

    def __init__(self, *batch_size: int) -> None:
        super().__init__(batch_size=batch_size)
        self.observation_spec = Composite(
            position=Unbounded((*batch_size, 2)), age=Unbounded((*batch_size, 1)), shape=batch_size
        )
        self.state_spec = self.observation_spec.clone()
        self.action_spec = Bounded(-1, 1, (*batch_size, 2))
        self.reward_spec = Unbounded((*batch_size, 1))
        self.lifetime = torch.arange(self.numel()).reshape(*batch_size, 1) + 2

    def _reset(self, tensordict=None, **kwargs):
        return self.observation_spec.zero()

    def _step(self, tensordict):
        age = tensordict["age"] + 1
        done = age >= self.lifetime
        position = tensordict["position"] + tensordict["action"]
        step = {"position": position, "age": age, "reward": age, "done": done, "terminated": done.clone()}
        return TensorDict(step, self.batch_size)

    def _set_seed(self, seed):
        pass


def make_env(*batch_size: int) -> TransformedEnv:
    return TransformedEnv(Drift(*batch_size), DrawPreference(UniformPreferences(3)))


def make_batch_of_three() -> TransformedEnv:
    return make_env(3)


def rows_sum_to_one(preferences: Tensor) -> bool:
    return bool(torch.isclose(preferences.sum(-1), torch.ones(())).all())


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.fixture(params=["single", "batched", "two batch dimensions", "serial", "transformed serial"])
def env(request):
    return {
        "single": lambda: make_env(),
        "batched": lambda: make_env(3),
        "two batch dimensions": lambda: make_env(2, 3),
        "serial": lambda: SerialEnv(2, make_batch_of_three),
        "transformed serial": lambda: TransformedEnv(SerialEnv(2, Drift), DrawPreference(UniformPreferences(3))),
    }[request.param]()


def test_the_specs_describe_the_preference(env):
    spec = env.observation_spec["preference"]
    assert isinstance(spec, Bounded)
    assert spec.shape == (*env.batch_size, 3)
    check_env_specs(env)


def test_every_environment_draws_its_own_preference(env):
    preference = env.reset()["preference"]
    assert preference.shape == (*env.batch_size, 3)
    assert rows_sum_to_one(preference)
    assert len(preference.reshape(-1, 3).unique(dim=0)) == env.numel()


def test_a_preference_lasts_exactly_as_long_as_its_episode(env):
    rollout = env.rollout(12, break_when_any_done=False)
    preference = rollout["preference"]
    assert torch.equal(preference, rollout["next", "preference"])
    changed = (preference.diff(dim=-2) != 0).any(-1)
    torch.testing.assert_close(changed, rollout["next", "done"][..., :-1, 0])
    assert changed.any()
    assert rows_sum_to_one(preference)


def test_a_preference_given_to_reset_is_kept_until_the_episode_ends(env):
    chosen = CORNERS[1].expand(*env.batch_size, 3).clone()
    start = env.reset(TensorDict({"preference": chosen}, env.batch_size))
    assert torch.equal(start["preference"], chosen)
    rollout = env.rollout(8, auto_reset=False, tensordict=start, break_when_any_done=False)
    first_episode = rollout["next", "done"].cumsum(-2)[..., 0] - rollout["next", "done"][..., 0].long() == 0
    assert torch.equal((rollout["preference"] == CORNERS[1]).all(-1), first_episode)


def test_a_preference_changed_in_the_middle_of_an_episode_is_carried_on(env):
    step, tensordict = env.step_and_maybe_reset(env.rand_action(env.reset()))
    chosen = CORNERS[2].expand(*env.batch_size, 3).clone()
    tensordict["preference"] = chosen
    step = env.step(env.rand_action(tensordict))
    assert torch.equal(step["next", "preference"], chosen)


def test_a_changed_preference_wins_over_the_last_steps_entry(env):
    tensordict = env.rand_step(env.reset())
    chosen = CORNERS[2].expand(*env.batch_size, 3).clone()
    tensordict["preference"] = chosen
    assert torch.equal(env.rand_step(tensordict)["next", "preference"], chosen)


def test_a_partial_reset_redraws_only_the_environments_that_are_reset():
    env = make_env(3)
    running = env.rand_step(env.reset())["next"]
    before = running["preference"].clone()
    mask = torch.tensor([[True], [False], [True]])
    after = env.reset(running.set("_reset", mask).exclude("reward"))["preference"]
    assert torch.equal((after == before).all(-1), ~mask[:, 0])


def test_an_environment_without_a_fixed_batch_size_draws_for_its_tensordict():
    env = TransformedEnv(PendulumEnv(), DrawPreference(UniformPreferences(3)))
    rollout = env.rollout(5, auto_reset=False, tensordict=env.reset(PendulumEnv.gen_params(batch_size=[4])))
    assert rollout["preference"].shape == (4, 5, 3)
    assert torch.equal(rollout["preference"], rollout["next", "preference"])


def test_each_environment_stays_in_its_segment():
    env = TransformedEnv(Drift(3), DrawPreference(SegmentedPreferences(2, 3)))
    segment = (env.rollout(60, break_when_any_done=False)["preference"][..., 0] * 3).floor()
    assert torch.equal(segment, torch.arange(3.0)[:, None].expand(3, 60))


def test_the_key_can_be_chosen_and_nested():
    env = TransformedEnv(Drift(3), DrawPreference(UniformPreferences(3), ("user", "weights")))
    check_env_specs(env)
    rollout = env.rollout(6, break_when_any_done=False)
    assert torch.equal(rollout["user", "weights"], rollout["next", "user", "weights"])


def test_a_collector_carries_preferences_from_batch_to_batch():
    env = TransformedEnv(Drift(4), DrawPreference(UniformPreferences(3))).append_transform(StepCounter())
    collector = Collector(env, frames_per_batch=12, total_frames=36)
    batches = torch.cat(list(collector), -1)
    changed = (batches["preference"].diff(dim=-2) != 0).any(-1)
    assert torch.equal(batches["preference"], batches["next", "preference"])
    assert torch.equal(changed, batches["next", "done"][..., :-1, 0])
    collector.shutdown()


def test_worker_processes_draw_keep_and_carry_preferences():
    env = ParallelEnv(2, make_batch_of_three, mp_start_method="fork")
    try:
        env.set_seed(0)
        drawn = env.reset()["preference"]
        assert len(drawn.flatten(0, 1).unique(dim=0)) == 6
        rollout = env.rollout(12, break_when_any_done=False)
        changed = (rollout["preference"].diff(dim=-2) != 0).any(-1)
        assert torch.equal(rollout["preference"], rollout["next", "preference"])
        assert torch.equal(changed, rollout["next", "done"][..., :-1, 0])
        chosen = CORNERS.expand(2, 3, 3).clone()
        tensordict = env.reset(TensorDict({"preference": chosen}, [2, 3]))
        assert torch.equal(tensordict["preference"], chosen)
        assert torch.equal(env.rand_step(tensordict)["next", "preference"], chosen)
        assert not torch.equal(env.reset()["preference"], chosen)
    finally:
        env.close()


def test_a_clone_works_in_another_environment():
    transform = make_env(3).transform.clone()
    assert TransformedEnv(Drift(3), transform).rollout(3)["preference"].shape == (3, 2, 3)
