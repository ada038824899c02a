"""The batched engine: any number of scenes at once in PyTorch, on any device."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.linalg import vector_norm

from morlnav.navigation.world.base import Contact, World
from morlnav.navigation.world.geometry import distance_to_box


class TensorWorld(World):
    """Drives a batch of robots with tensor arithmetic alone; the default for training.

    Examples:
        >>> from morlnav.navigation.world.scene import SceneSampler
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
        human = vector_norm(point - scene.human.unsqueeze(1), dim=-1) <= self.human_radius + self.robot.radius
        box = (distance_to_box(point.unsqueeze(2), scene.boxes.unsqueeze(1)) <= self.robot.radius).any(-1)
        goal = vector_norm(point - scene.goal.unsqueeze(1), dim=-1) <= self.goal_radius
        met = torch.stack([human, box, goal])
        event = met.any(0)
        event[:, -1] = True  # the step ends there in any case
        first = event.to(torch.uint8).argmax(1)
        slot = torch.arange(len(first), device=first.device)
        self.pose = path[slot, first]
        human, box, goal = met[:, slot, first]
        duration = (first + 1) * (self.step_time / self.substeps)
        return Contact(human=human, box=box, goal=goal & ~human & ~box, duration=duration, batch_size=human.shape)

    def scan(self) -> Tensor:
        """See :meth:`World.scan`."""
        return self.lidar.scan(self.pose, self.scene.human, self.scene.boxes, self.human_radius)
