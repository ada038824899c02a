"""A window onto a robot's scene: boxes, human, goal, lidar and the driven path, drawn with pygame."""

from __future__ import annotations

import math

import pygame
import torch
from torch import Tensor

from morlnav.navigation.record.plots import BOX, GOAL, HUMAN
from morlnav.navigation.world import Scene, World
from morlnav.navigation.world.geometry import to_frame
from morlnav.record.colours import COLOURS, INK

SMALLEST = 100  # pixels


class SceneWindow:
    """Shows one scene from above, as large as fits, with y upward.

    Args:
        world: its radii and its lidar are drawn.
        size: width and height in pixels.
        margin: around start, goal and human, in metres.

    Raises:
        ValueError: for a size in which nothing could be seen.

    Examples:
        >>> import os
        >>> os.environ.setdefault("SDL_VIDEODRIVER", "dummy") and None
        >>> from morlnav.navigation.world import SceneSampler, TensorWorld
        >>> world, scene = TensorWorld(), SceneSampler()(1)
        >>> world.reset(scene)
        >>> window = SceneWindow(world, size=(400, 300))
        >>> window.draw(scene[0], world.pose[0], world.scan()[0], scene.start, ["any text"])
        >>> window.to_world(window.to_screen(torch.tensor([2.0, 1.0]))).round()
        tensor([2., 1.])
        >>> window.close()
    """

    def __init__(self, world: World, size: tuple[int, int] = (1000, 700), margin: float = 1.6) -> None:
        if min(size) < SMALLEST:
            raise ValueError(
                f"The window needs at least {SMALLEST} pixels in width and height, got {size[0]} by {size[1]}."
            )
        pygame.display.init()  # and not all of pygame, which would look for a sound card
        pygame.font.init()
        pygame.display.set_caption("morlnav-record")
        self.world, self.size, self.margin = world, size, margin
        self.surface = pygame.display.set_mode(size)
        self.font = pygame.font.Font(None, 24)
        self._centre, self._scale = torch.zeros(2), 1.0

    def to_screen(self, point: Tensor) -> tuple[float, float]:
        """The pixel of a point ``[2]`` in metres."""
        x, y = ((point - self._centre) * self._scale).tolist()
        return self.size[0] / 2 + x, self.size[1] / 2 - y

    def to_world(self, pixel: tuple[float, float]) -> Tensor:
        """The point ``[2]`` in metres of a pixel."""
        x, y = pixel[0] - self.size[0] / 2, self.size[1] / 2 - pixel[1]
        return torch.tensor([x, y]) / self._scale + self._centre

    def draw(self, scene: Scene, pose: Tensor, scan: Tensor, path: Tensor, lines: list[str]) -> None:
        """Draw and show everything.

        Args:
            scene: without a batch dimension.
            pose: of the robot, ``[3]``.
            scan: the lidar's sectors in metres, ``[sectors]``.
            path: positions driven so far, ``[L, 2+]``.
            lines: of text.
        """
        self._fit(scene)
        self.surface.fill("white")
        for x, y, length, width, angle in scene.boxes.tolist():
            corners = torch.tensor([[length, width], [-length, width], [-length, -width], [length, -width]])
            corners = torch.tensor([x, y]) + to_frame(corners, torch.zeros(2), torch.tensor(-angle))
            pygame.draw.polygon(self.surface, BOX, [self.to_screen(corner) for corner in corners])
        self._draw_scan(pose, scan)
        self._disc(scene.goal, self.world.goal_radius, "#dbe4fb")
        self._disc(scene.goal, 0.08, GOAL)
        self._disc(scene.human, self.world.human_radius, HUMAN)
        if len(path) > 1:
            points = [self.to_screen(point) for point in path[:, :2]]
            pygame.draw.lines(self.surface, COLOURS["demo"], False, points, 3)
        self._disc(pose[:2], self.world.robot.radius, INK)
        nose = pose[:2] + 1.5 * self.world.robot.radius * torch.stack([pose[2].cos(), pose[2].sin()])
        pygame.draw.line(self.surface, INK, self.to_screen(pose[:2]), self.to_screen(nose), 4)
        for i, line in enumerate(lines):
            self.surface.blit(self.font.render(line, True, INK), (12, 10 + 22 * i))
        pygame.display.flip()

    def _fit(self, scene: Scene) -> None:
        points = torch.stack([scene.start[:2], scene.goal, scene.human])
        low, high = points.amin(0) - self.margin, points.amax(0) + self.margin
        self._centre = (low + high) / 2
        self._scale = float((torch.tensor(self.size) / (high - low)).min())

    def _draw_scan(self, pose: Tensor, scan: Tensor) -> None:
        """A sector is an arc at its reading, and an empty one nothing."""
        width = 2 * math.pi / len(scan)
        for i, distance in enumerate(scan.tolist()):
            if distance < self.world.lidar.max_range:
                angle = pose[2] - math.pi + width * (i + torch.linspace(0, 1, 4))
                arc = pose[:2] + distance * torch.stack([angle.cos(), angle.sin()], -1)
                points = [self.to_screen(point) for point in arc]
                pygame.draw.polygon(self.surface, "#f4eee4", [self.to_screen(pose[:2]), *points])
                pygame.draw.lines(self.surface, "#d9a441", False, points, 2)

    def _disc(self, centre: Tensor, radius: float, colour: str) -> None:
        pygame.draw.circle(self.surface, colour, self.to_screen(centre), max(2.0, radius * self._scale))

    def close(self) -> None:
        """Close the window."""
        pygame.display.quit()
