"""The state of a world as an image, for Gymnasium's render modes."""

from __future__ import annotations

import math

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from torch import Tensor

from morlnav.navigation.record.plots import draw_scene
from morlnav.navigation.world import World

ROBOT = "#2456d6"


def draw_state(figure: Figure, world: World, index: int, track: list[Tensor]) -> None:
    """Draw scene ``index`` of a world from above, with its robot and the positions ``[2]`` it has driven through."""
    axes = figure.add_subplot()
    axes.set_aspect("equal", adjustable="datalim")
    draw_scene(axes, world.scene[index].cpu(), world.human_radius, world.robot.radius)
    path, (x, y, heading) = torch.stack(track), world.pose[index].tolist()
    axes.plot(path[:, 0], path[:, 1], color=ROBOT)
    axes.add_patch(Circle((x, y), world.robot.radius, color=ROBOT))
    tip = (x + 2 * world.robot.radius * math.cos(heading), y + 2 * world.robot.radius * math.sin(heading))
    axes.plot([x, tip[0]], [y, tip[1]], color=ROBOT)


def render_frame(world: World, index: int, track: list[Tensor]) -> np.ndarray:
    """The same as an image ``[H, W, 3]`` of ``uint8``."""
    figure = Figure(figsize=(5, 5))
    draw_state(figure, world, index, track)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
