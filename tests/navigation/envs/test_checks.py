"""What is no action or no reward is refused at that step, by name, in training and in evaluation."""

import gymnasium
import numpy as np
import pytest
import torch

from morlnav.navigation.demonstrations import record_demonstrations, rewarded_transitions
from morlnav.navigation.envs import (
    Collision,
    Efficiency,
    GoalProgress,
    HumanDistance,
    NavigationEnv,
    Sum,
)
from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import PymunkWorld, SceneSampler, TensorWorld

COUNT = 4


def zeros(*shape, **settings):
    return lambda transition: torch.zeros(*shape, **settings)


def spoilt(value, row=2):
    def term(transition):
        reward = torch.zeros(COUNT)
        reward[row] = value
        return reward

    return term


class Late:
    """Pays nan in the third step, once."""

    def __init__(self):
        self.steps = 0

    def __call__(self, transition):
        self.steps += 1
        return torch.full((COUNT,), torch.nan if self.steps == 3 else 0.0)


MISBEHAVIOUR = {
    "a column": (zeros(COUNT, 1), rf"got \[{COUNT}, 1\] of float32 on cpu"),
    "a row": (zeros(1, COUNT), rf"got \[1, {COUNT}\] of float32 on cpu"),
    "one for all": (zeros(()), r"got \[\] of float32 on cpu"),
    "one too many": (zeros(COUNT + 1), rf"got \[{COUNT + 1}\] of float32"),
    "a broadcast": (Sum([zeros(COUNT), zeros(COUNT, 1)]), rf"got \[{COUNT}, {COUNT}\] of float32"),
    "a number": (lambda transition: -1.0, "got float"),
    "a list": (lambda transition: [0.0] * COUNT, "got list"),
    "an array": (lambda transition: np.zeros(COUNT, np.float32), "got ndarray"),
    "nothing": (lambda transition: None, "got NoneType"),
    "complex numbers": (zeros(COUNT, dtype=torch.complex64), rf"got \[{COUNT}\] of complex64"),
    "another device": (zeros(COUNT, device="meta"), rf"got \[{COUNT}\] of float32 on meta"),
    "nan": (spoilt(torch.nan), f"must be finite, got nan from odd in environment 2 of {COUNT}"),
    "inf": (spoilt(torch.inf), f"must be finite, got inf from odd in environment 2 of {COUNT}"),
    "-inf": (spoilt(-torch.inf), f"must be finite, got -inf from odd in environment 2 of {COUNT}"),
    "too much for float32": (lambda transition: torch.full((COUNT,), 1e300, dtype=torch.float64), "got inf from odd"),
    "nan later on": (Late, "got nan from odd in environment 0"),
}


def drive(objectives):
    NavigationEnv(objectives=objectives, num_envs=COUNT, seed=0).rollout(3, break_when_any_done=False)


def evaluate(objectives):
    stand = lambda observation, preference: torch.zeros(len(observation), 2)  # noqa: E731
    evaluate_policy(stand, evaluation_scenes(COUNT), torch.eye(2)[:1], objectives=objectives, max_steps=3)


@pytest.mark.parametrize("use", [drive, evaluate], ids=["training", "evaluation"])
@pytest.mark.parametrize("kind", MISBEHAVIOUR)
def test_a_reward_that_is_none_is_refused_by_its_objectives_name(kind, use):
    term, found = MISBEHAVIOUR[kind]
    term = term() if term is Late else term
    with pytest.raises(ValueError, match=found) as error:
        use({"efficiency": Efficiency(), "odd": term})
    assert "odd" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.int64, torch.bool])
def test_other_real_numbers_become_float32(dtype):
    env = NavigationEnv(objectives={"one": lambda t: torch.ones(COUNT, dtype=dtype)}, num_envs=COUNT)
    reward = env.rollout(2)["next", "reward"]
    assert reward.dtype == torch.float32
    assert (reward == 1).all()


def test_rewards_of_demonstrations_are_checked_too():
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 1)
    with pytest.raises(ValueError, match="got nan from odd"):
        rewarded_transitions(data, {"odd": lambda t: torch.full_like(t.pose[:, 0], torch.nan)})


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("engine", [TensorWorld, PymunkWorld])
def test_an_action_that_is_not_finite_moves_nothing(engine, value):
    env = NavigationEnv(engine(), num_envs=3, seed=0)
    state = env.reset()
    before = env.world.pose.clone()
    action = torch.tensor([[0.5, 0.0], [0.5, value], [0.5, 0.0]])
    with pytest.raises(ValueError, match=rf"v = 0\.5 m/s and ω = {value} rad/s for environment 1 of 3"):
        env.step(state.set("action", action))
    assert torch.equal(env.world.pose, before)
    assert env.step(state.set("action", torch.zeros(3, 2)))["next", "pose"].isfinite().all()


def test_gymnasium_refuses_an_action_that_is_not_finite():
    single, many = gymnasium.make("morlnav/SocialNavigation-v0"), gymnasium.make_vec("morlnav/SocialNavigation-v0", 2)
    single.reset(seed=0)
    with pytest.raises(ValueError, match="Actions must be finite, got v = nan m/s"):
        single.step(np.array([np.nan, 0.0], np.float32))
    many.reset(seed=0)
    with pytest.raises(ValueError, match="for environment 1 of 2"):
        many.step(np.array([[0.1, 0.0], [0.1, np.inf]], np.float32))


def test_a_policy_that_answers_nan_is_not_evaluated():
    lost = lambda observation, preference: torch.full((len(observation), 2), torch.nan)  # noqa: E731
    with pytest.raises(ValueError, match="Actions must be finite"):
        evaluate_policy(lost, evaluation_scenes(2), torch.eye(2), max_steps=3)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "abc", None], ids=str)
@pytest.mark.parametrize(
    ("term", "name"),
    [
        (GoalProgress, "scale"),
        (Collision, "penalty"),
        (HumanDistance, "penalty"),
        (HumanDistance, "threshold"),
        (HumanDistance, "minimum"),
        (Efficiency, "penalty"),
    ],
)
def test_reward_terms_need_finite_numbers(term, name, value):
    with pytest.raises(ValueError, match=f"{term.__name__} needs a finite number as {name}, got {value}"):
        term(**{name: value})
