"""Noise that leads a robot elsewhere, on courses about the goal's bearing."""

import pytest
import torch

from morlnav.navigation.modules import WanderingNoise

LOW, HIGH = [0.0, -3.14], [0.5, 3.14]


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


def wander(observation, steps=1, **settings):
    """Actions ``[steps, B, 2]`` of wandering noise that replaces every action."""
    noise = WanderingNoise(1.0, LOW, HIGH, **settings)
    return torch.stack([noise(torch.zeros(len(observation), 2), observation=observation) for _ in range(steps)])


def test_wandering_robots_drive_on_courses_about_the_goal():
    observation = torch.zeros(20000, 34)
    observation[:, 0], observation[:, 1] = 8.0, 1.0
    (action,) = wander(observation, courses=1.0, spread=0.2)
    course = action[:, 1] * 0.2  # taken up within one step, as no turn here exceeds the robot's
    torch.testing.assert_close(course.clamp_max(0.628).median(), torch.tensor(0.628), atol=1e-3, rtol=0)
    observation[:, 1] = 0.0
    (action,) = wander(observation, courses=1.0, spread=0.1)
    course = action[:, 1] * 0.2
    torch.testing.assert_close(course.std(), torch.tensor(0.1), atol=0.005, rtol=0)
    torch.testing.assert_close(action[:, 0], 0.5 * course.cos().square())


def test_a_course_is_held_relative_to_the_goal():
    observation = torch.zeros(50, 34)
    actions = wander(observation, steps=10, courses=1.0, spread=0.1, hold=10)
    noise = WanderingNoise(1.0, LOW, HIGH, hold=10, courses=1.0, spread=0.1)
    first = noise(torch.zeros(50, 2), observation=observation)
    observation[:, 1] = 0.1
    still = noise.remaining > 0
    then = noise(torch.zeros(50, 2), observation=observation)
    torch.testing.assert_close((then - first)[still, 1], torch.full((int(still.sum()),), 0.5))
    assert (actions[..., 0] > 0.4).all()


def test_spells_of_wandering_are_courses_as_often_as_told():
    observation = torch.zeros(20000, 34)
    (action,) = wander(observation, courses=0.3, spread=0.0)
    straight = (action == torch.tensor([0.5, 0.0])).all(-1)
    torch.testing.assert_close(straight.float().mean(), torch.tensor(0.3), atol=0.01, rtol=0)


def test_wandering_needs_an_observation_and_sensible_numbers():
    with pytest.raises(ValueError, match="give it beside the action"):
        WanderingNoise(1.0, LOW, HIGH)(torch.zeros(3, 2))
    for wrong in ({"courses": 1.1}, {"spread": -1.0}, {"step_time": 0.0}):
        with pytest.raises(ValueError, match=r"^Wandering needs"):
            WanderingNoise(1.0, LOW, HIGH, **wrong)
