"""The environment behind Gymnasium's and MO-Gymnasium's interfaces, under their own checks and wrappers."""

import pickle
from functools import partial

import gymnasium
import matplotlib
import mo_gymnasium
import numpy as np
import pytest
import torch
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env, data_equivalence
from mo_gymnasium.wrappers import (
    LinearReward,
    MOClipReward,
    MOMaxAndSkipObservation,
    MONormalizeReward,
    MORecordEpisodeStatistics,
    vector,
)

from morlnav import NavigationEnv
from morlnav.navigation.envs import ENV_ID, Efficiency, SocialNavigation, SocialNavigationVector
from morlnav.navigation.evaluation import evaluation_scenes
from morlnav.navigation.world import PymunkWorld

ONE_OR_MANY = pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])


@pytest.fixture
def env():
    with gymnasium.make(ENV_ID) as env:
        yield env


@pytest.fixture(autouse=True)
def _no_window():
    matplotlib.use("Agg")


class FreshLinearReward(LinearReward):
    """MO-Gymnasium 1.3 puts the same array of weights into every info, which Gymnasium 1.4's checker refuses."""

    def step(self, action):
        *rest, info = super().step(action)
        return *rest, {**info, "reward_weights": info["reward_weights"].copy()}


@pytest.mark.parametrize("weight", [None, [0.5, 0.25, 0.25]])
def test_gymnasiums_checker_has_no_complaint_under_a_linear_reward(weight, recwarn):
    with gymnasium.make(ENV_ID, render_mode="rgb_array") as env:
        check_env(FreshLinearReward(env, None if weight is None else np.array(weight)))  # in every render mode
    # It is wrapped, speaks in SI units, and distances know no bound.
    allowed = ("different from the unwrapped", "symmetric and normalized", "maximum value is infinity")
    complaints = [str(warning.message) for warning in recwarn]
    assert [text for text in complaints if not any(part in text for part in allowed)] == []


@ONE_OR_MANY
def test_one_seed_is_one_episode(make):
    env = make(ENV_ID)

    def episode(seed):
        env.action_space.seed(3)
        return [env.reset(seed=seed), *(env.step(env.action_space.sample()) for _ in range(5))]

    first = episode(1)
    assert data_equivalence(first, episode(1))
    assert not data_equivalence(first, episode(2))


def test_rewards_and_observations_keep_to_their_spaces(env):
    assert env.unwrapped.reward_dim == 3
    assert env.unwrapped.reward_space.low.tolist() == pytest.approx([-1012.5, -10 * (2 / 1.7) ** 2, -10])
    env.action_space.seed(0)
    env.reset(seed=0)
    ends = 0
    for _ in range(600):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert reward in env.unwrapped.reward_space
        assert observation in env.observation_space
        if terminated or truncated:
            ends += 1
            env.reset()
    assert ends >= 2


def test_it_drives_like_the_torchrl_environment(env):
    scene = evaluation_scenes(1)
    other = NavigationEnv(num_envs=1)
    state = other.reset(scene=scene)
    observation, _ = env.reset(options={"scene": scene})
    np.testing.assert_array_equal(observation, state["observation"][0])
    state["action"] = torch.tensor([[0.4, 0.3]])
    state = other.step(state)["next"]
    observation, reward, *_ = env.step(np.array([0.4, 0.3]))
    np.testing.assert_array_equal(observation, state["observation"][0])
    np.testing.assert_array_equal(reward, state["reward"][0])


def test_time_limits_truncate(env):
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, np.float32))[2:4] for _ in range(250)]
    assert ends[-1] == (False, True)
    assert not any(terminated or truncated for terminated, truncated in ends[:-1])


def test_settings_reach_the_environment():
    with gymnasium.make(
        ENV_ID, world=PymunkWorld(), objectives={"efficiency": Efficiency(-1.0)}, observe_human=False
    ) as env:
        assert env.reset(seed=0)[0].shape == (32,)
        assert env.step(np.zeros(2, np.float32))[1].tolist() == [-1.0]
        assert env.unwrapped.objectives == ("efficiency",)


@ONE_OR_MANY
def test_environments_can_be_pickled(make):
    env = make(ENV_ID)
    env.reset(seed=0)
    copy = pickle.loads(pickle.dumps(env))
    action = env.action_space.sample()
    assert data_equivalence(env.step(action), copy.step(action))


def test_it_works_under_mo_gymnasiums_wrappers():
    env = MONormalizeReward(MOMaxAndSkipObservation(mo_gymnasium.make(ENV_ID), skip=5), 1)
    env = MORecordEpisodeStatistics(MOClipReward(env, 0, -1, 0))
    env.reset(seed=0)
    for _ in range(50):
        *_, terminated, truncated, info = env.step(np.zeros(2, np.float32))
    assert truncated
    assert not terminated
    assert info["episode"]["r"][2] == -10 * 250


def test_vectors_of_others_hold_it():
    envs = vector.MOSyncVectorEnv([lambda: mo_gymnasium.make(ENV_ID)] * 2)
    envs.reset(seed=0)
    assert envs.step(np.zeros((2, 2), np.float32))[1].shape == (2, 3)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_gymnasiums_vectors_take_it_under_a_linear_reward(mode):
    envs = gymnasium.make_vec(ENV_ID, 1 if mode == "async" else 2, mode, wrappers=[LinearReward])
    envs.reset(seed=0)
    _, reward, *_, info = envs.step(envs.action_space.sample())
    envs.close()
    np.testing.assert_allclose(reward, info["vector_reward"].sum(1), rtol=1e-5)


def test_mo_gymnasium_records_the_returns_of_many_robots():
    envs = vector.MORecordEpisodeStatistics(gymnasium.make_vec(ENV_ID, num_envs=2, max_episode_steps=3))
    envs.reset(seed=0)
    for _ in range(3):
        *_, info = envs.step(np.zeros((2, 2), np.float32))
    assert info["_episode"].all()
    assert info["episode"]["r"][:, 2].tolist() == [-30, -30]


def test_many_robots_share_one_world():
    envs = gymnasium.make_vec(ENV_ID, num_envs=3)
    scenes = evaluation_scenes(3)
    observation, _ = envs.reset(options={"scene": scenes})
    assert observation in envs.observation_space
    singles = [SocialNavigation() for _ in range(3)]
    for i, single in enumerate(singles):
        single.reset(options={"scene": scenes[i : i + 1]})
    actions = np.array([[0.5, 0.0], [0.3, 1.0], [0.0, -2.0]], np.float32)
    batch = envs.step(actions)
    for i, single in enumerate(singles):
        observation, reward, terminated, truncated, info = single.step(actions[i])
        np.testing.assert_allclose(batch[0][i], observation, atol=1e-5)
        np.testing.assert_allclose(batch[1][i], reward, atol=1e-4)
        assert (terminated, truncated) == (batch[2][i], batch[3][i])
        assert info["goal"] == batch[4]["goal"][i]


def test_finished_robots_begin_anew_at_the_next_step():
    envs = gymnasium.make_vec(ENV_ID, num_envs=8, max_episode_steps=20)
    envs.reset(seed=0)
    steps = np.zeros(8, int)
    ended = np.zeros(8, bool)
    for _ in range(60):
        observation, reward, terminated, truncated, _ = envs.step(np.tile(np.float32([0.5, 0.0]), (8, 1)))
        steps = np.where(ended, 0, steps + 1)
        assert (reward[ended] == 0).all()
        assert not (terminated | truncated)[ended].any()
        assert (observation[ended, 0] >= 6 - 1e-4).all()  # at a start, the goal is at least 6 m away
        assert ((steps == 20) <= (terminated | truncated)).all()
        ended = terminated | truncated


def test_a_collision_ends_an_episode_also_while_others_begin_anew():
    envs = gymnasium.make_vec(ENV_ID, num_envs=64)
    envs.reset(seed=0)
    ended, together = np.zeros(64, bool), 0
    for _ in range(150):
        _, reward, terminated, truncated, info = envs.step(np.tile(np.float32([0.5, 0.0]), (64, 1)))
        collided = reward[:, 0] < -900
        assert (collided == (info["human"] | info["box"])).all()
        assert (terminated == (collided | info["goal"])).all()
        assert all(row in envs.reward_space for row in reward[~ended])
        together += ended.any() and collided.sum()
        ended = terminated | truncated
    assert together > 0


@pytest.mark.parametrize("mode", ["rgb_array", "human"])
def test_scenes_are_drawn(mode):
    with gymnasium.make(ENV_ID, render_mode=mode) as env:
        env.reset(seed=0)
        before = env.render()
        env.step(np.array([0.5, 0.0], np.float32))
        after = env.render()
    if mode == "human":
        assert before is None
    else:
        assert before.shape == after.shape == (500, 500, 3)
        assert before.dtype == np.uint8
        assert (before != after).any()


def test_many_robots_are_drawn_each_with_its_path_since_the_last_reset():
    envs = gymnasium.make_vec(ENV_ID, num_envs=2, max_episode_steps=2, render_mode="rgb_array")
    single = SocialNavigation(render_mode="rgb_array")
    actions = np.array([[0.5, 0.0], [0.3, 1.0]], np.float32)
    envs.reset(seed=0)
    for steps in (1, 2, 0):  # since the last reset, which the third step is
        envs.step(actions)
        scenes, frames = envs._env.world.scene, envs.render()
        for i, frame in enumerate(frames):
            single.reset(options={"scene": scenes[i : i + 1]})
            for _ in range(steps):
                single.step(actions[i])
            np.testing.assert_allclose(frame, single.render(), atol=2)
        assert (frames[0] != frames[1]).any()
    assert gymnasium.make_vec(ENV_ID).render() is None


@pytest.mark.parametrize(
    ("make", "record", "size"),
    [
        (gymnasium.make, wrappers.RecordVideo, [500, 500]),
        (partial(gymnasium.make_vec, num_envs=2), wrappers.vector.RecordVideo, [1000, 500]),
    ],
)
def test_gymnasium_records_videos(make, record, size, tmp_path):
    clips = pytest.importorskip("moviepy")
    env = record(make(ENV_ID, render_mode="rgb_array"), str(tmp_path / "videos"))
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
    env.close()
    (file,) = tmp_path.rglob("*.mp4")
    with clips.VideoFileClip(str(file)) as clip:
        assert clip.size == size
        assert clip.duration == pytest.approx(5 / env.metadata["render_fps"])


@pytest.mark.parametrize("environment", [SocialNavigation, SocialNavigationVector])
def test_an_unknown_render_mode_is_refused(environment):
    with pytest.raises(ValueError, match="render_mode must be one of"):
        environment(render_mode="hologram")
