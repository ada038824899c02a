"""Episodes that move: robots under several preferences, side by side in one scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from morlnav.navigation.record.plots import draw_scene, scene_bounds
from morlnav.record.colours import blend, objective_colours

if TYPE_CHECKING:
    from morlnav.navigation.evaluation.rollout import Rollouts


def animate_rollouts(
    rollouts: Rollouts,
    objectives: Sequence[str] = ("distance", "efficiency"),
    scene: int = 0,
    *,
    stride: int = 2,
    step_time: float = 0.2,
    human_radius: float = 0.3,
    robot_radius: float = 0.18,
) -> FuncAnimation:
    """All preferences of the roll-outs driving through one scene at the same time, coloured by λ, at true speed.

    Args:
        rollouts: batched ``[P, S]``.
        objectives: names of the ``n`` tuneable objectives.
        scene: index of the scene to show.
        stride: control steps between two frames.
        step_time: one control step in seconds.
        human_radius: in metres.
        robot_radius: in metres.

    Returns:
        An animation; save it with ``animation.save("drive.gif", writer="pillow")``. Up to nine preferences are named.

    Raises:
        ValueError: if the names do not fit the preferences, or the scene is out of range.

    Examples:
        >>> import tempfile, torch
        >>> from morlnav.navigation.evaluation import evaluate_policy, evaluation_scenes
        >>> straight = lambda observation, preference: torch.tensor([0.5, 0.0]).expand(len(observation), 2)
        >>> rollouts = evaluate_policy(straight, evaluation_scenes(1), torch.eye(2), max_steps=8)
        >>> animate_rollouts(rollouts).save(f"{tempfile.mkdtemp()}/drive.gif", writer="pillow")
    """
    rollouts = rollouts.cpu()
    if len(objectives) != rollouts.preference.shape[-1]:
        raise ValueError(f"Preferences have {rollouts.preference.shape[-1]} entries, but got names {list(objectives)}.")
    if not 0 <= scene < rollouts.batch_size[1]:
        raise ValueError(f"The scene must be an index below {rollouts.batch_size[1]}, got {scene}.")
    low, high = scene_bounds(rollouts, scene)
    width, height = high - low
    figure = Figure(figsize=(7.0, 7.0 * height / width + 0.5), layout="constrained", facecolor="w")
    axes = figure.subplots()
    draw_scene(axes, rollouts.scene[0, scene], human_radius, robot_radius)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    corners = objective_colours(objectives)
    preferences = rollouts.preference[:, scene].numpy()
    colours = blend(preferences, corners)
    named = zip(objectives, corners, strict=True)
    if len(preferences) <= 9:
        named = zip((_words(weights, objectives) for weights in preferences), colours, strict=True)
    handles = [Line2D([], [], color=colour, lw=3, label=name) for name, colour in named]
    figure.legend(handles=handles, loc="outside upper center", ncols=min(3, len(handles)), frameon=False, fontsize=9)

    pose = rollouts.pose[:, scene].numpy()
    robots = [axes.add_patch(Circle((0, 0), robot_radius, color=colour, alpha=0.9, zorder=7)) for colour in colours]
    trails = [axes.plot([], [], color=colour, lw=1.7, alpha=0.7, zorder=3)[0] for colour in colours]

    def draw(step: int) -> list:
        for robot, trail, poses in zip(robots, trails, pose, strict=True):
            robot.center = poses[step, :2]
            trail.set_data(*poses[: step + 1, :2].T)
        return robots + trails

    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once, not for every frame
    last = pose.shape[1] - 1
    return FuncAnimation(figure, draw, [*range(0, last, stride), last], interval=1000 * stride * step_time)


def _words(weights: np.ndarray, objectives: Sequence[str]) -> str:
    """A preference in words, without the objectives that have no weight."""
    parts = [(name, weight) for name, weight in zip(objectives, weights, strict=True) if weight > 0.005]
    return parts[0][0] if len(parts) == 1 else ", ".join(f"{name} {weight:.2g}" for name, weight in parts)
