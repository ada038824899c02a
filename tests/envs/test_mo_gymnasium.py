"""Tasks of MO-Gymnasium are what Gymnasium makes of them, several side by side."""

import sys

import mo_gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from morlnav.data import UniformPreferences
from morlnav.envs import MOGymnasium
from morlnav.transforms import DrawPreference, RewardVector

CAR, HOPPER = "mo-mountaincarcontinuous-v0", "mo-hopper-2obj-v5"


@pytest.mark.parametrize("task", [CAR, HOPPER, "mo-halfcheetah-v5"])
def test_each_of_several_goes_as_one_alone_with_its_seed(task):
    torch.manual_seed(0)  # random actions under which nobody falls
    env = MOGymnasium(task, num_envs=3)
    env.set_seed(7)
    rollout = env.rollout(12, auto_reset=True, break_when_any_done=False)
    for i in range(3):
        alone = mo_gymnasium.make(task)
        alone.reset(seed=7 + i)
        observation, _ = alone.reset()  # as a roll-out resets what was seeded
        for step in rollout[i]:
            np.testing.assert_allclose(step["observation"], observation, rtol=1e-5, atol=1e-6)
            observation, reward, *_ = alone.step(step["action"].numpy())
            np.testing.assert_allclose(step["next", "reward"], reward, rtol=1e-5, atol=1e-6)


def test_its_specs_hold_and_numbers_are_float32():
    env = MOGymnasium("mo-hopper-v5", num_envs=2)
    check_env_specs(env)
    assert env.rollout(2)["observation"].dtype == torch.float32
    assert (env.batch_size, env.reward_spec.shape) == ((2,), (2, 3))


def test_the_tasks_own_time_limit_truncates_and_does_not_terminate():
    env = MOGymnasium(CAR, num_envs=2)
    still = TensorDict(action=torch.zeros(2, 1), batch_size=[2])
    step = env.reset()
    for _ in range(env.max_steps):
        step = env.step_mdp(env.step(step.update(still)))
    assert step["truncated"].all()
    assert step["done"].all()
    assert not step["terminated"].any()


def test_an_episode_that_ended_begins_anew_and_the_others_go_on():
    env = MOGymnasium(HOPPER, num_envs=3)
    env.set_seed(0)
    step = env.rollout(5, break_when_any_done=False)[:, -1]["next"]
    mask = torch.tensor([[False], [True], [False]])
    after = env.reset(step.clone().set("_reset", mask))
    unchanged = (after["observation"] == step["observation"]).all(-1)
    assert unchanged.tolist() == [True, False, True]


def test_a_roll_out_waits_for_the_last_of_its_episodes():
    env = MOGymnasium(HOPPER, num_envs=4)
    env.set_seed(0)
    done = env.rollout(200, break_when_any_done=False, break_when_all_done=True)["next", "done"].squeeze(-1)
    ends = [row.nonzero()[0].item() for row in done]
    assert done.shape[1] - 1 == max(ends) > min(ends)


def test_a_preference_handed_to_reset_is_kept():
    env = TransformedEnv(MOGymnasium(CAR, num_envs=2), DrawPreference(UniformPreferences(2)))
    preference = torch.tensor([[0.25, 0.75], [1.0, 0.0]])
    start = env.reset(TensorDict(preference=preference, batch_size=[2]))
    assert (start["preference"] == preference).all()


def test_the_reward_is_named_and_bounded_as_the_task_tells():
    car, hopper = (RewardVector.of(MOGymnasium(task)) for task in (CAR, HOPPER))
    assert car.names == hopper.names == ("objective_0", "objective_1")
    assert car.bounds.tolist() == [[-1.0, -1.0], [0.0, 0.0]]
    assert hopper.bounds.isinf().all()


@pytest.mark.parametrize(
    ("task", "sentence"),
    [
        ("mo-hoper-2obj-v5", "no task mo-hoper-2obj-v5; did you mean mo-hopper-2obj-v5"),
        ("Pendulum-v1", "no task Pendulum-v1"),
        ("os:mo-hopper-v5", "no task os:mo-hopper-v5"),
        ("deep-sea-treasure-v0", "must be continuous, but those of deep-sea-treasure-v0 are Discrete"),
        ("water-reservoir-v0", "bounds must be finite, but those of water-reservoir-v0"),
        ("mo-supermario-v0", "mo-supermario-v0 needs a package that is not installed"),
    ],
)
def test_a_task_that_is_none_for_us_is_refused_in_a_sentence(task, sentence):
    with pytest.raises(ValueError, match=sentence):
        MOGymnasium(task)


def test_without_mo_gymnasium_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mo_gymnasium", None)  # as Python marks what cannot be imported
    with pytest.raises(ValueError, match=r"pip install 'morlnav\[mo\]'"):
        MOGymnasium(CAR)


def test_no_notes_to_the_authors_of_a_model_come_on_the_screen(capfd, recwarn):
    MOGymnasium("mo-halfcheetah-v5", num_envs=2)
    assert capfd.readouterr() == ("", "")
    assert not recwarn.list
