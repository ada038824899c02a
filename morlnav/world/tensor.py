"""The batched engine: any number of scenes at once in PyTorch, on any device."""

from __future__ import annotations

import torch
from torch import Tensor

from morlnav.world.base import Contact, World
from morlnav.world.geometry import distance_to_box


class TensorWorld(World):
    """Drives a batch of robots with tensor arithmetic alone; the default for training.

    Examples:
        >>> from morlnav.world import SceneSampler
        >>> world = TensorWorld()
        >>> world.reset(SceneSampler()(16))
        >>> contact = world.step(torch.tensor([0.5, 0.0]).expand(16, 2))
        >>> world.observe().shape, contact.goal.any().item()
        (torch.Size([16, 34]), False)
    """

    def step(self, action: Tensor) -> Contact:
        """See :meth:`World.step`. All check points of the arc are computed at once, then the first contact is taken."""
        scene, path = self.scene, self.path(action)
        point = path[..., :2]
        human = (point - scene.human.unsqueeze(1)).norm(dim=-1) <= self.human_radius + self.robot.radius
        if scene.boxes.shape[-2]:
            gap = distance_to_box(point.unsqueeze(2), scene.boxes.unsqueeze(1)).amin(-1)
            box = gap <= self.robot.radius
        else:
            box = torch.zeros_like(human)
        goal = (point - scene.goal.unsqueeze(1)).norm(dim=-1) <= self.goal_radius
        event = human | box | goal
        first = torch.where(event.any(1), event.to(torch.uint8).argmax(1), self.substeps - 1).unsqueeze(1)
        self.pose = path.gather(1, first.unsqueeze(-1).expand(-1, 1, 3)).squeeze(1)
        human, box, goal = (flag.gather(1, first).squeeze(1) for flag in (human, box, goal))
        duration = (first.squeeze(1) + 1) * (self.step_time / self.substeps)
        return Contact(human=human, box=box, goal=goal & ~human & ~box, duration=duration, batch_size=human.shape)

    def scan(self) -> Tensor:
        """See :meth:`World.scan`."""
        return self.lidar.scan(self.pose, self.scene.human, self.scene.boxes, self.human_radius)
