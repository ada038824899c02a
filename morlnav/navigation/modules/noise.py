"""Exploration that leads a robot elsewhere."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from morlnav.modules import EpsilonGreedyNoise
from morlnav.navigation.world.geometry import wrap_angle


class WanderingNoise(EpsilonGreedyNoise):
    """Noise that leads a robot elsewhere: some of the held actions are courses to drive on.

    Uniform actions turn a differential-drive robot on the spot more than they move it, and so leave out most of what a
    policy could do instead of the demonstration. Here a spell of noise is, with probability ``courses``, a drive at
    full speed on a course that differs from the goal's bearing by a Gaussian draw, and a uniform action otherwise.

    Args:
        epsilon: see :class:`EpsilonGreedyNoise`.
        action_low: least ``(v, ω)`` in m/s and rad/s.
        action_high: largest ``(v, ω)``.
        hold: steps that a course or a random action lasts.
        courses: share of the spells that are courses, in [0, 1].
        spread: standard deviation of the course about the goal's bearing in radians.
        step_time: one control step in seconds, within which the robot takes up a course as far as it can.
        generator: source of randomness; torch's global state by default.

    Raises:
        ValueError: if a number is out of range, or at the call without an observation.

    Examples:
        >>> noise = WanderingNoise(1.0, [0.0, -3.14], [0.5, 3.14], hold=10, courses=1.0, spread=0.0)
        >>> observation = torch.zeros(1, 34)
        >>> observation[0, :2] = torch.tensor([8.0, 0.1])  # the goal is slightly to the left
        >>> noise(torch.zeros(1, 2), observation=observation)
        tensor([[0.4950, 0.5000]])
    """

    def __init__(
        self,
        epsilon: float | Tensor,
        action_low: Tensor | list[float],
        action_high: Tensor | list[float],
        hold: int = 10,
        courses: float = 0.5,
        spread: float = 1.5,
        step_time: float = 0.2,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(epsilon, action_low, action_high, hold, generator)
        if not (0 <= courses <= 1 and spread >= 0 and step_time > 0):
            raise ValueError(
                f"Wandering needs courses in [0, 1], spread >= 0 and step_time > 0, got {courses}, {spread} and "
                f"{step_time}."
            )
        self.courses, self.spread, self.step_time = courses, spread, step_time

    def _draw(self, batch: torch.Size) -> Tensor:
        """Uniform action, whether a course is driven instead, and how far it lies off the goal's bearing."""
        kind = (self._rand(*batch, 1) < self.courses).float()
        offset = self.spread * torch.erfinv(2 * self._rand(*batch, 1) - 1) * math.sqrt(2)
        return torch.cat([super()._draw(batch), kind, offset.clamp(-torch.pi, torch.pi)], -1)

    def _act(self, held: Tensor, observation: Tensor | None) -> Tensor:
        if observation is None:
            raise ValueError("Wandering noise steers by the observation; give it beside the action.")
        action, kind, offset = held.split([len(self.low), 1, 1], -1)
        course = wrap_angle(observation[..., 1:2] + offset)
        speed = self.high[0] * course.cos().clamp_min(0).square()
        turn = (course / self.step_time).clamp(self.low[1], self.high[1])
        return torch.where(kind > 0, torch.cat([speed, turn], -1), action)
