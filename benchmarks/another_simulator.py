"""Kept policies in a simulator that shares no code with morlnav's worlds: NumPy, Euler steps of 10 ms, 720 cast rays.

``python -m benchmarks.another_simulator results/default results/three_styles/seed_*`` drives the 100 evaluation scenes
under the weights between distance and efficiency, and prints each policy's share of the exact front here and there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn

import morlnav
from morlnav.deployment import Policy
from morlnav.navigation.envs.rewards import Efficiency
from morlnav.navigation.evaluation import (
    ExactFront,
    episode_metrics,
    evaluate_policy,
    evaluation_scenes,
    exact_front,
    possible_table,
)
from morlnav.navigation.evaluation.possible import EDGE
from morlnav.navigation.world import Scene, TensorWorld
from morlnav.record.markdown import markdown_table
from morlnav.simplex import simplex_grid

ROBOT, HUMAN, GOAL, RANGE = 0.18, 0.3, 0.35, 4.0  # m
TIME_LIMIT, STEP, EULER = 50.0, 0.2, 0.01  # s
RAYS = -np.pi + np.radians(0.5) * np.arange(720)


class Simulator:
    """A scene ``[E]`` times, and a robot in each.

    Args:
        scenes: of all episodes.
    """

    def __init__(self, scenes: Scene) -> None:
        start, self.goal, self.human, boxes = (
            getattr(scenes, name).double().numpy() for name in ("start", "goal", "human", "boxes")
        )
        self.place, self.heading = start[:, :2].copy(), start[:, 2].copy()
        along = np.stack([np.cos(boxes[..., 4]), np.sin(boxes[..., 4])], -1)
        across = np.stack([-along[..., 1], along[..., 0]], -1)
        signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        half = boxes[..., None, 2:4] * signs
        corners = boxes[..., None, :2] + half[..., :1] * along[..., None, :] + half[..., 1:] * across[..., None, :]
        self.first = corners.reshape(len(start), -1, 2)  # of every side, [E, 4 K, 2]
        self.side = np.roll(corners, -1, axis=-2).reshape(self.first.shape) - self.first

    def observe(self) -> np.ndarray:
        """What the robots see, ``[E, 34]``."""
        seen = []
        for point in (self.goal, self.human):
            to = point - self.place
            bearing = np.arctan2(to[:, 1], to[:, 0]) - self.heading
            seen += [np.linalg.norm(to, axis=-1), np.arctan2(np.sin(bearing), np.cos(bearing))]
        return np.concatenate([np.stack(seen, -1), self.scan().reshape(-1, 30, 24).min(-1)], -1)

    def scan(self) -> np.ndarray:
        """Ranges ``[E, 720]`` of all rays in metres."""
        angle = self.heading[:, None] + RAYS
        ray = np.stack([np.cos(angle), np.sin(angle)], -1)[:, :, None]  # [E, 720, 1, 2]
        to, side = (self.first - self.place[:, None])[:, None], self.side[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = _cross(ray, side)
            reach, along = _cross(to, side) / turn, _cross(to, ray) / turn
            reach = np.where((reach >= 0) & (along >= 0) & (along <= 1), reach, RANGE).min(-1)
            to = (self.human - self.place)[:, None]
            ahead, aside = (to * ray[:, :, 0]).sum(-1), _cross(to, ray[:, :, 0])
            circle = ahead - np.sqrt(HUMAN**2 - aside**2)
        return np.minimum(np.minimum(reach, RANGE), np.where(circle >= 0, circle, RANGE))

    def clearance(self) -> np.ndarray:
        """Distance ``[E]`` of the robots' centres to the nearest side of a box."""
        to = self.place[:, None] - self.first
        share = ((to * self.side).sum(-1) / (self.side**2).sum(-1)).clip(0, 1)
        return np.linalg.norm(to - share[..., None] * self.side, axis=-1).min(-1)

    def drive(self, policy: nn.Module, preference: Tensor) -> pd.DataFrame:
        """Episodes of a policy under preferences ``[E, n]``: ``success``, ``min_human_distance`` and ``time``."""
        nearest, time = np.full(len(self.place), np.inf), np.full(len(self.place), np.nan)
        driving = np.ones(len(self.place), bool)
        for step in range(round(TIME_LIMIT / STEP)):
            with torch.no_grad():
                speed, turn = policy(torch.from_numpy(self.observe()).float(), preference).double().numpy().T
            for euler in range(round(STEP / EULER)):
                self.place += EULER * (driving * speed * np.array([np.cos(self.heading), np.sin(self.heading)])).T
                self.heading += EULER * driving * turn
                human = np.linalg.norm(self.human - self.place, axis=-1)
                nearest = np.where(driving, np.minimum(nearest, human), nearest)
                arrived = driving & (np.linalg.norm(self.goal - self.place, axis=-1) <= GOAL)
                time[arrived] = step * STEP + (euler + 1) * EULER
                driving &= ~arrived & (human > ROBOT + HUMAN) & (self.clearance() > ROBOT)
            if not driving.any():
                break
        return pd.DataFrame({"success": ~np.isnan(time), "min_human_distance": nearest, "time": time})


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def compare(policy: Policy, scenes: Scene, front: ExactFront, steps: int = 10) -> pd.DataFrame:
    """A policy between distance and efficiency, a row for each simulator.

    Args:
        policy: for these two styles, among others.
        scenes: to drive in, ``[S]``.
        front: of these scenes.
        steps: of the weights between both.

    Returns:
        Columns ``success`` and ``front_share``, from 0 to 1, and ``min_human_distance`` in metres at λ = distance.

    Raises:
        ValueError: if the policy lacks one of the styles.
    """
    if lacking := set(EDGE) - set(policy.objectives):
        raise ValueError(
            f"The policy weighs {', '.join(policy.objectives)}, but no {' and no '.join(sorted(lacking))}."
        )
    names = policy.objectives
    preferences = torch.zeros(steps + 1, len(names))
    preferences[:, [names.index(name) for name in EDGE]] = simplex_grid(len(EDGE), steps)

    paid = dict.fromkeys(names, Efficiency())  # which is no matter here
    rollouts = evaluate_policy(policy, scenes, preferences, world=TensorWorld(check_interval=EULER), objectives=paid)
    here = episode_metrics(rollouts, names, shortest=front.length[:, 0])
    shared = [*(f"lambda_{name}" for name in names), "success", "min_human_distance"]
    here = here[shared].assign(time_ratio=here["time_ratio"].where(here["success"]))

    every = preferences.repeat_interleave(len(scenes), 0)
    there = Simulator(torch.cat([scenes] * len(preferences))).drive(policy, every)
    there["time_ratio"] = 0.5 * there["time"] / front.length[:, 0].repeat(len(preferences)).numpy()
    there = there.assign(**{f"lambda_{name}": every[:, i].numpy() for i, name in enumerate(names)})
    rows = []
    for episodes in (here, there[list(here)]):
        means = episodes.groupby(np.arange(len(episodes)) // len(scenes)).mean()
        share = possible_table(front, means)["front_share"].iloc[0]
        rows.append([episodes["success"].mean(), means["min_human_distance"].iloc[-1], share])
    return pd.DataFrame(rows, ["morlnav", "another"], ["success", "min_human_distance", "front_share"])


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.another_simulator", description=__doc__.split("\n", 1)[0]
    )
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--scenes", type=int, default=100)
    arguments = parser.parse_args()
    scenes = evaluation_scenes(arguments.scenes, seed=12345)
    front, rows = exact_front(scenes), []
    for run in arguments.runs:
        table = compare(morlnav.load(run), scenes, front)
        metres = table.pop("min_human_distance").map("{:.2f} m".format)
        success, share = (table[name].map("{:.1%}".format) for name in ("success", "front_share"))
        rows.append([f"`{run}`", *(" / ".join(values) for values in (success, metres, share))])
    names = ("success", "distance to human", "of the front")
    print(markdown_table(["run", *(f"{name}, here / there" for name in names)], rows, (":--", "--:")))


if __name__ == "__main__":
    main()
