"""Reward terms against values worked out by hand (Sec. III-D), and the same from both engines."""

import math

import pytest
import torch

from morlnav.navigation.envs import Collision, Efficiency, GoalProgress, HumanDistance, NavigationEnv, Sum
from morlnav.navigation.envs.rewards import Transition
from morlnav.navigation.world import Contact, PymunkWorld, Scene, SceneSampler, TensorWorld


def transition(before=(0.0, 0.0), after=(0.0, 0.0), human=(50.0, 0.0), goal=(10.0, 0.0), met=None):
    flag = {name: torch.tensor([name == met]) for name in ("human", "box", "goal")}
    pose = torch.tensor([[*before, 0.0]])
    return Transition(
        pose=pose,
        next_pose=torch.tensor([[*after, 0.0]]),
        action=torch.zeros(1, 2),
        observation=torch.zeros(1, 34),
        next_observation=torch.zeros(1, 34),
        contact=Contact(**flag, batch_size=[1]),
        scene=Scene(
            start=pose,
            goal=torch.tensor([goal]),
            human=torch.tensor([human]),
            boxes=torch.zeros(1, 0, 5),
            batch_size=[1],
        ),
    )


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ((0.1, 0.0), 12.5),  # 125 per metre, 0.1 m nearer
        ((-0.1, 0.0), -12.5),
        ((0.0, 0.0), 0.0),
        ((0.0, 0.1), 125 * (10 - math.hypot(10, 0.1))),
    ],
)
def test_progress_toward_the_goal_is_paid_by_the_metre(after, expected):
    assert GoalProgress()(transition(after=after)).item() == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(("met", "expected"), [("human", -1000.0), ("box", -1000.0), ("goal", 0.0), (None, 0.0)])
def test_contact_with_human_or_box_costs_a_thousand(met, expected):
    assert Collision()(transition(met=met)).item() == expected


@pytest.mark.parametrize(
    ("distance", "expected"),
    [
        (0.3, -10.0),  # Eq. 3 at its minimum ...
        (1.15, -2.5),  # ... half way, a quarter of it ...
        (2.0, 0.0),  # ... nothing from the threshold on
        (2.5, 0.0),
        (0.48, -10 * (1.52 / 1.7) ** 2),  # contact
    ],
)
def test_closeness_to_the_human_costs_quadratically(distance, expected):
    reward = HumanDistance()(transition(human=(distance, 0.0)))
    assert reward.item() == pytest.approx(expected, abs=1e-5)


def test_closeness_is_measured_after_the_step():
    reward = HumanDistance()(transition(before=(9.0, 0.0), after=(0.0, 0.0), human=(0.3, 0.0)))
    assert reward.item() == pytest.approx(-10, abs=1e-5)


def test_every_step_costs_the_same():
    assert Efficiency()(transition()).tolist() == [-10.0]


def test_a_sum_adds_its_terms():
    baseline = Sum([GoalProgress(), Collision()], static=True)
    assert baseline(transition(after=(0.1, 0.0), met="human")).item() == pytest.approx(-987.5, abs=1e-3)
    assert baseline.static
    assert not Sum([Efficiency()]).static


def test_impossible_terms_are_refused():
    with pytest.raises(ValueError, match="at least one reward term"):
        Sum([])
    with pytest.raises(ValueError, match="0 <= minimum < threshold"):
        HumanDistance(threshold=0.2, minimum=0.3)


@pytest.mark.parametrize("engine", [TensorWorld, PymunkWorld])
def test_one_step_of_the_environment_by_hand(engine):
    env = NavigationEnv(engine())
    scene = Scene(
        start=torch.tensor([0.0, 0.0, 0.0]),
        goal=torch.tensor([8.0, 0.0]),
        human=torch.tensor([1.0, 0.9]),
        boxes=torch.zeros(0, 5),
    )
    td = env.reset(scene=scene)
    reward = env.step(td.set("action", torch.tensor([0.5, 0.0])))["next", "reward"]
    # 0.5 m/s for 0.2 s: 0.1 m nearer to the goal, at (0.1, 0), so hypot(0.9, 0.9) from the human.
    distance = -10 * ((2 - math.hypot(0.9, 0.9)) / 1.7) ** 2
    torch.testing.assert_close(reward, torch.tensor([12.5, distance, -10.0]), atol=1e-3, rtol=0)


def test_both_engines_pay_the_same():
    generator = torch.Generator().manual_seed(2)
    scenes = SceneSampler(distance=(3.0, 4.0))(8, generator=generator)
    envs = [NavigationEnv(engine(), num_envs=8) for engine in (TensorWorld, PymunkWorld)]
    states = [env.reset(scene=scenes) for env in envs]
    running = torch.ones(8, dtype=torch.bool)
    collisions = 0
    for _ in range(40):
        action = torch.rand(8, 2, generator=generator) * torch.tensor([0.2, 1.0]) + torch.tensor([0.3, -0.5])
        steps = [env.step(td.set("action", action))["next"] for env, td in zip(envs, states, strict=True)]
        ours, theirs = (step["reward"][running] for step in steps)
        torch.testing.assert_close(ours, theirs, atol=0.02, rtol=0)
        assert torch.equal(steps[0]["done"][running], steps[1]["done"][running])
        collisions += int((ours[:, 0] < -900).sum())
        running = running & ~steps[0]["done"].squeeze(-1)
        states = [step.exclude("reward") for step in steps]
    assert collisions > 0
