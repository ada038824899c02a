"""When the environments of a Gymnasium vector begin anew, from which seeds, and what TorchRL's wrapper makes of it."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from torchrl.envs import GymWrapper, check_env_specs

from morlnav.navigation.envs import ENV_ID, SocialNavigation, SocialNavigationVector
from morlnav.navigation.evaluation import evaluation_scenes

FORWARD = np.tile(np.float32([0.5, 0.0]), (3, 1))


def make(mode, **settings):
    return gymnasium.make_vec(ENV_ID, num_envs=3, autoreset_mode=mode, **settings)


def drive(envs, steps):
    return [envs.step(FORWARD) for _ in range(steps)][-1]


@pytest.mark.parametrize("mode", AutoresetMode)
def test_the_mode_is_told_as_gymnasium_wants_it(mode):
    for envs in (make(mode), make(mode.value)):
        assert envs.metadata["autoreset_mode"] is envs.autoreset_mode is mode
    assert SocialNavigationVector.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


def test_an_unknown_mode_is_refused():
    with pytest.raises(ValueError, match="'Never' is not a valid AutoresetMode"):
        make("Never")


def test_in_the_same_step_the_last_observation_is_kept_as_gymnasium_keeps_it():
    scenes = evaluation_scenes(3)
    envs = make("SameStep", max_episode_steps=4)
    envs.reset(options={"scene": scenes})
    observation, reward, terminated, truncated, info = drive(envs, 4)
    singles = [SocialNavigation() for _ in range(3)]
    for index, single in enumerate(singles):
        single.reset(options={"scene": scenes[index : index + 1]})
        for action in FORWARD[[0, 0, 0, 0]]:
            last, last_reward, *_, last_info = single.step(action)
        np.testing.assert_allclose(info["final_obs"][index], last, atol=1e-5)
        np.testing.assert_allclose(reward[index], last_reward, atol=1e-4)
        np.testing.assert_allclose(info["final_info"]["pose"][index], last_info["pose"], atol=1e-5)
    assert truncated.all()
    assert not terminated.any()
    assert info["_final_obs"].all()
    assert (info["pose"][:, :2] == 0).all()  # where the next episodes begin
    assert (observation[:, 0] >= 6 - 1e-4).all()
    *_, truncated, info = drive(envs, 1)
    assert not truncated.any()
    assert "final_obs" not in info


def test_in_the_same_step_the_others_drive_on():
    scenes = evaluation_scenes(3)
    scenes.goal[1] = torch.tensor([0.5, 0.0])  # reached in the first steps
    envs, others = make("SameStep"), make("Disabled")
    for vector in (envs, others):
        vector.reset(options={"scene": scenes})
    observation, reward, terminated, _, info = envs.step(FORWARD)
    while not terminated.any():
        others.step(FORWARD)
        observation, reward, terminated, _, info = envs.step(FORWARD)
    expected = others.step(FORWARD)
    assert terminated.tolist() == info["_final_obs"].tolist() == [False, True, False]
    assert info["final_obs"][0] is None
    np.testing.assert_array_equal(observation[[0, 2]], expected[0][[0, 2]])
    np.testing.assert_array_equal(info["final_obs"][1], expected[0][1])
    np.testing.assert_array_equal(reward, expected[1])
    assert observation[1, 0] >= 6 - 1e-4


def test_without_autoreset_ended_environments_wait_for_a_reset_of_their_own():
    envs = make("Disabled", max_episode_steps=4)
    envs.reset(seed=0)
    drive(envs, 2)
    pose = envs.reset(options={"reset_mask": np.array([True, False, False])})[1]["pose"]
    assert (pose[0, :2] == 0).all()
    assert (pose[1:, 0] > 0.1).all()
    assert drive(envs, 2)[3].tolist() == [False, True, True]
    with pytest.raises(ResetNeeded, match=r"Reset the environments \[1, 2\] first"):
        envs.step(FORWARD)
    envs.reset(options={"reset_mask": np.array([False, True, True])})
    assert drive(envs, 2)[3].tolist() == [True, False, False]


@pytest.mark.parametrize("mask", [np.zeros(3, bool), np.ones(2, bool)])
def test_a_mask_that_fits_nothing_is_refused(mask):
    envs = make("Disabled")
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="reset_mask needs 3 flags, at least one of them true"):
        envs.reset(options={"reset_mask": mask})


def test_every_environment_may_have_a_seed_of_its_own():
    envs = make("NextStep")
    observation, _ = envs.reset(seed=[5, 9, 5])
    of_others, _ = SyncVectorEnv([SocialNavigation] * 3).reset(seed=[5, 9, 5])
    np.testing.assert_allclose(observation, of_others, atol=1e-5)
    following = envs.reset()[0]
    envs.reset(seed=[5, 9, 5])
    np.testing.assert_array_equal(envs.reset()[0], following)
    envs.reset(seed=[5, 9, 6])
    assert not np.array_equal(envs.reset()[0], following)
    fresh = [envs.reset(seed=[5, None, 5])[0] for _ in range(2)]
    np.testing.assert_array_equal(fresh[0][[0, 2]], fresh[1][[0, 2]])
    assert not np.array_equal(fresh[0][1], fresh[1][1])


def test_as_many_seeds_as_environments_are_needed():
    with pytest.raises(ValueError, match="Got 2 seeds for 3 environments"):
        make("NextStep").reset(seed=[1, 2])


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_torchrls_wrapper_drives_it(mode):
    env = GymWrapper(make(mode, max_episode_steps=4))
    check_env_specs(env)
    env.set_seed(0)
    rollout = env.rollout(10, break_when_any_done=False)
    assert rollout["next", "reward"].shape == (3, 10, 3)
    assert rollout["next", "done"].squeeze(-1)[:, [3, 7]].all()
    assert rollout["next", "done"].sum() == 6
    distance, following = rollout["observation"][..., 0], rollout["next", "observation"][..., 0]
    assert ((following - distance).abs() <= 0.1 + 1e-4).all()  # no step leads into the next episode
    assert not torch.isclose(distance[:, 4], following[:, 3]).any()


def test_the_specification_can_be_kept_as_json():
    spec = gymnasium.envs.registration.EnvSpec.from_json(gymnasium.spec(ENV_ID).to_json())
    assert isinstance(gymnasium.make(spec).unwrapped, SocialNavigation)
    assert isinstance(gymnasium.make_vec(spec, num_envs=2), SocialNavigationVector)
