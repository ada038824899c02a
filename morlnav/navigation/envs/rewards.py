"""Reward terms: small objects, each turning a transition into one entry of the reward vector (Sec. III-D)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any, Protocol

import torch
from torch import Tensor
from torch.linalg import vector_norm

from morlnav.navigation.world import Contact, Scene


@dataclass(frozen=True)
class Transition:
    """What reward terms may look at; tensors lead with the batch dimension ``[B]``.

    Attributes:
        pose: robot poses before the step ``[B, 3]``.
        next_pose: robot poses after the step ``[B, 3]``.
        action: ``(v, ω)`` in m/s and rad/s ``[B, 2]``.
        observation: before the step ``[B, 34]``.
        next_observation: after the step ``[B, 34]``.
        contact: what was met during the step.
        scene: the scenes driven in.
        clearance: from the robot's edge to the human or the nearest box after the step in metres ``[B]``.

    Examples:
        >>> from morlnav.navigation.envs.navigation import NavigationEnv
        >>> timid = lambda transition: -1.0 * (transition.next_human_distance < 1.0)
        >>> NavigationEnv(objectives={"timid": timid}, num_envs=2).rollout(3)["next", "reward"].shape
        torch.Size([2, 3, 1])
    """

    pose: Tensor
    next_pose: Tensor
    action: Tensor
    observation: Tensor
    next_observation: Tensor
    contact: Contact
    scene: Scene
    clearance: Tensor | None = None

    @property
    def goal_distance(self) -> Tensor:
        """Distance to the goal before the step in metres, ``[B]``."""
        return vector_norm(self.pose[..., :2] - self.scene.goal, dim=-1)

    @property
    def next_goal_distance(self) -> Tensor:
        """Distance to the goal after the step in metres, ``[B]``."""
        return vector_norm(self.next_pose[..., :2] - self.scene.goal, dim=-1)

    @property
    def next_human_distance(self) -> Tensor:
        """Distance to the human's centre after the step in metres, ``[B]``."""
        return vector_norm(self.next_pose[..., :2] - self.scene.human, dim=-1)


class Objective(Protocol):
    """Anything callable on a :class:`Transition`; ``static = True`` fixes its preference weight at 1 (Eq. 2).

    It returns a finite number for every environment, a tensor ``[B]`` on the world's device; whatever else it returns
    is refused at that step, by the objective's name.

    A method ``bounds(reach)`` may give its least and largest reward in a step that leads ``reach`` metres far at most;
    Gymnasium's ``reward_space`` is made of them.
    """

    def __call__(self, transition: Transition) -> Tensor:
        """The reward of every environment, ``[B]``."""


def check_finite(term: Any) -> None:
    """Refuse a term of which a field that should be a number is none, or not finite.

    Args:
        term: a dataclass.

    Raises:
        ValueError: naming the field.

    Examples:
        >>> Efficiency(penalty=math.nan)
        Traceback (most recent call last):
        ValueError: Efficiency needs a finite number as penalty, got nan.
    """
    for field in fields(term):
        value = getattr(term, field.name)
        if field.type in ("float", float) and not (isinstance(value, Real) and math.isfinite(value)):
            raise ValueError(f"{type(term).__name__} needs a finite number as {field.name}, got {value}.")


@dataclass(frozen=True)
class GoalProgress:
    """``scale`` per metre of progress toward the goal, ``c_g·(d_{t-1} - d_t)`` (Sec. III-D.1, sign as intended).

    Args:
        scale: ``c_g``, reward per metre.

    Raises:
        ValueError: unless the scale is a finite number.

    Examples:
        >>> GoalProgress(scale=125.0).bounds(reach=0.1)
        (-12.5, 12.5)
    """

    scale: float = 125.0

    def __post_init__(self) -> None:
        check_finite(self)

    def __call__(self, transition: Transition) -> Tensor:
        """Reward ``[B]``."""
        return self.scale * (transition.goal_distance - transition.next_goal_distance)

    def bounds(self, reach: float) -> tuple[float, float]:
        """Least and largest reward of a step."""
        extent = abs(self.scale) * reach
        return -extent, extent


@dataclass(frozen=True)
class Collision:
    """``penalty`` on contact with the human or a box (Sec. III-D.1).

    A jump has no derivative. Who differentiates through the world is kept off by that of a potential which is none of
    the reward: it rises over the last ``margin`` metres to ``pressure`` of the penalty.

    Args:
        penalty: reward of the step that ends in contact.
        margin: in metres.
        pressure: share of the penalty.

    Raises:
        ValueError: unless all are finite numbers and ``margin > 0``.

    Examples:
        >>> Collision().penalty
        -1000.0
    """

    penalty: float = -1000.0
    margin: float = 0.08
    pressure: float = 0.3

    def __post_init__(self) -> None:
        check_finite(self)
        if self.margin <= 0:
            raise ValueError(f"Collision needs a positive margin, got {self.margin}.")

    def __call__(self, transition: Transition) -> Tensor:
        """Reward ``[B]``."""
        contact, clearance = transition.contact, transition.clearance
        reward = self.penalty * (contact.human | contact.box).to(transition.pose.dtype)
        if clearance is None or not clearance.requires_grad:
            return reward
        potential = self.pressure * self.penalty * (1 - clearance / self.margin).clamp_min(0).square()
        return reward + (potential - potential.detach())

    def bounds(self, reach: float) -> tuple[float, float]:
        """Least and largest reward of a step."""
        return min(self.penalty, 0.0), max(self.penalty, 0.0)


@dataclass(frozen=True)
class HumanDistance:
    """Quadratic penalty for closeness to the human (Eq. 3): 0 beyond ``threshold`` m, ``penalty`` at ``minimum`` m.

    Args:
        penalty: ``p_max``, reward at ``minimum``.
        threshold: ``d_thresh`` in metres.
        minimum: ``d_min`` in metres.

    Raises:
        ValueError: unless all are finite numbers and ``0 <= minimum < threshold``.

    Examples:
        >>> HumanDistance().threshold
        2.0
    """

    penalty: float = -10.0
    threshold: float = 2.0
    minimum: float = 0.3

    def __post_init__(self) -> None:
        check_finite(self)
        if not 0 <= self.minimum < self.threshold:
            raise ValueError(f"HumanDistance needs 0 <= minimum < threshold, got {self.minimum} and {self.threshold}.")

    def __call__(self, transition: Transition) -> Tensor:
        """Reward ``[B]``."""
        intrusion = (self.threshold - transition.next_human_distance).clamp_min(0)
        return self.penalty * (intrusion / (self.threshold - self.minimum)).square()

    def bounds(self, reach: float) -> tuple[float, float]:
        """Least and largest reward of a step."""
        extreme = self.penalty * (self.threshold / (self.threshold - self.minimum)) ** 2
        return min(extreme, 0.0), max(extreme, 0.0)


@dataclass(frozen=True)
class Efficiency:
    """A constant ``penalty`` per step (Sec. III-D.2).

    Args:
        penalty: reward of every step.

    Raises:
        ValueError: unless the penalty is a finite number.

    Examples:
        >>> Efficiency().penalty
        -10.0
    """

    penalty: float = -10.0

    def __post_init__(self) -> None:
        check_finite(self)

    def __call__(self, transition: Transition) -> Tensor:
        """Reward ``[B]``."""
        return torch.full_like(transition.pose[..., 0], self.penalty)

    def bounds(self, reach: float) -> tuple[float, float]:
        """The reward of every step, twice."""
        return self.penalty, self.penalty


class Sum:
    """Several terms that share one entry of the reward vector.

    Args:
        terms: the terms to add.
        static: whether the entry's preference weight is fixed at 1, as the baseline's is (Eq. 2).

    Raises:
        ValueError: if there is no term.

    Examples:
        >>> baseline = Sum([GoalProgress(), Collision()], static=True)
        >>> baseline.static
        True
    """

    def __init__(self, terms: Sequence[Objective], static: bool = False) -> None:
        if not terms:
            raise ValueError("Sum needs at least one reward term.")
        self.terms = list(terms)
        self.static = static

    def __call__(self, transition: Transition) -> Tensor:
        """Reward ``[B]``."""
        return sum(term(transition) for term in self.terms)

    def bounds(self, reach: float) -> tuple[float, float]:
        """Least and largest reward of a step; infinite where a term does not tell."""
        lows, highs = zip(*(reward_bounds(term, reach) for term in self.terms), strict=True)
        return sum(lows), sum(highs)


def reward_bounds(objective: Objective, reach: float) -> tuple[float, float]:
    """Least and largest reward in a step of at most ``reach`` metres; infinite for an objective without ``bounds``.

    >>> reward_bounds(GoalProgress(scale=100.0), 0.1), reward_bounds(lambda transition: 0, 0.1)
    ((-10.0, 10.0), (-inf, inf))
    """
    return objective.bounds(reach) if hasattr(objective, "bounds") else (-math.inf, math.inf)


def default_objectives() -> dict[str, Objective]:
    """The paper's analytical objectives: the static baseline, then human distance and efficiency.

    >>> list(default_objectives())
    ['baseline', 'distance', 'efficiency']
    """
    return {
        "baseline": Sum([GoalProgress(), Collision()], static=True),
        "distance": HumanDistance(),
        "efficiency": Efficiency(),
    }
