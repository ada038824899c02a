"""Scenes: where the robot starts, where it goes, who stands in between, and which boxes are in the way."""

from __future__ import annotations

import torch
from tensordict import tensorclass
from torch import Tensor

from morlnav.limits import check_at_least
from morlnav.navigation.world.geometry import distance_to_box


@tensorclass
class Scene:
    """A batch of static scenes, in metres and radians, in a fixed world frame.

    Attributes:
        start: robot pose at reset ``(x, y, heading)``, shape ``[*B, 3]``.
        goal: goal position, shape ``[*B, 2]``.
        human: centre of the standing human, shape ``[*B, 2]``.
        boxes: rotated boxes ``(x, y, half_length, half_width, angle)``, shape ``[*B, K, 5]``.

    Examples:
        >>> scene = SceneSampler(num_boxes=2)(8)
        >>> scene.boxes.shape
        torch.Size([8, 2, 5])
    """

    start: Tensor
    goal: Tensor
    human: Tensor
    boxes: Tensor

    def check(self, robot_radius: float = 0.18, human_radius: float = 0.3) -> None:
        """Refuse scenes that no robot could drive in.

        Args:
            robot_radius: in metres; the start needs this much room.
            human_radius: in metres.

        Raises:
            ValueError: if a tensor has the wrong width, a number is not finite, a box has no size, or the start or
                goal lies inside a box or the human.
        """
        for name, width in {"start": 3, "goal": 2, "human": 2, "boxes": 5}.items():
            value = getattr(self, name)
            if value.shape[-1] != width:
                raise ValueError(
                    f"A scene's {name} needs {width} numbers in its last dimension, got {value.shape[-1]}."
                )
            if not value.isfinite().all():
                raise ValueError(f"A scene's {name} must be finite; at least one number is NaN or infinite.")
        if (self.boxes[..., 2:4] <= 0).any():
            raise ValueError("Every box needs positive half sides; at least one is zero or negative.")
        for name, point in (("start", self.start[..., :2]), ("goal", self.goal)):
            margin = robot_radius if name == "start" else 0.0
            if self.boxes.shape[-2] and (distance_to_box(point.unsqueeze(-2), self.boxes) <= margin).any():
                raise ValueError(f"The {name} lies inside a box; move the box or the {name}.")
            if ((point - self.human).norm(dim=-1) <= human_radius + margin).any():
                raise ValueError(f"The {name} lies inside the human; move the human or the {name}.")


class SceneSampler:
    """Draw random scenes as in Sec. IV-A: the human stands midway between start and goal, boxes are clear of all three.

    The frame is canonical: the start is the origin and the goal lies on the positive x axis. Observations are
    robot-centric, so a rotated frame would show the agent nothing new.

    Args:
        num_boxes: boxes per scene.
        distance: range of the start-goal distance in metres.
        box_half_side: range of both half sides of a box in metres.
        band: boxes' centres lie within this many metres to either side of the start-goal line.
        clearance: least distance in metres from a box's surface to start and goal.
        human_clearance: least distance in metres from a box's surface to the human's centre.
        heading_noise: the initial heading deviates from the goal by up to this angle in radians.
        max_tries: rounds of rejection sampling, of 16 candidates each, before giving up.

    Raises:
        ValueError: for an empty or negative range, and at the draw if boxes cannot be placed.

    Examples:
        >>> sampler = SceneSampler(num_boxes=3)
        >>> scene = sampler(100, generator=torch.Generator().manual_seed(0))
        >>> bool((scene.goal[:, 0] >= 6).all())
        True
    """

    def __init__(
        self,
        num_boxes: int = 3,
        distance: tuple[float, float] = (6.0, 12.0),
        box_half_side: tuple[float, float] = (0.2, 0.6),
        band: float = 3.0,
        clearance: float = 0.6,
        human_clearance: float = 0.8,
        heading_noise: float = torch.pi / 4,
        max_tries: int = 50,
    ) -> None:
        for name, (low, high) in {"distance": distance, "box_half_side": box_half_side}.items():
            if not 0 < low <= high:
                raise ValueError(f"{name} needs 0 < low <= high in metres, got ({low}, {high}).")
        check_at_least(0, num_boxes=num_boxes, band=band, heading_noise=heading_noise)
        check_at_least(0, clearance=clearance, human_clearance=human_clearance)
        self.num_boxes = num_boxes
        self.distance = tuple(distance)
        self.box_half_side = tuple(box_half_side)
        self.band = band
        self.clearance = clearance
        self.human_clearance = human_clearance
        self.heading_noise = heading_noise
        self.max_tries = max_tries

    def __call__(
        self, batch_size: int, *, device: torch.device | str | None = None, generator: torch.Generator | None = None
    ) -> Scene:
        """Draw ``batch_size`` scenes; the same generator state gives the same scenes."""
        draw_device = generator.device if generator is not None else device

        def uniform(low: float, high: float, *shape: int) -> Tensor:
            return low + (high - low) * torch.rand(shape, device=draw_device, generator=generator)

        length = uniform(*self.distance, batch_size)
        zero = torch.zeros_like(length)
        goal = torch.stack([length, zero], -1)
        human = goal / 2
        start = torch.stack([zero, zero, uniform(-self.heading_noise, self.heading_noise, batch_size)], -1)

        keep_clear = torch.stack([start[:, :2], goal, human], 1)[:, None, None]
        clearance = length.new_tensor([self.clearance, self.clearance, self.human_clearance])
        boxes = torch.zeros(batch_size, self.num_boxes, 5, device=draw_device)
        missing = torch.ones(batch_size, self.num_boxes, dtype=torch.bool, device=draw_device)
        tries = 0
        while missing.any():
            if tries == self.max_tries:
                raise ValueError(
                    f"{self.num_boxes} boxes with half sides {self.box_half_side} m cannot be placed clear of start, "
                    f"goal and human in a band of ±{self.band} m; make them smaller or lower the clearances."
                )
            tries += 1
            shape = (batch_size, self.num_boxes, 16)
            candidate = torch.stack(
                [
                    length[:, None, None] * uniform(0, 1, *shape),
                    uniform(-self.band, self.band, *shape),
                    uniform(*self.box_half_side, *shape),
                    uniform(*self.box_half_side, *shape),
                    uniform(-torch.pi, torch.pi, *shape),
                ],
                -1,
            )
            valid = (distance_to_box(keep_clear, candidate.unsqueeze(-2)) >= clearance).all(-1)
            first = valid.to(torch.uint8).argmax(-1)
            chosen = candidate.gather(2, first[..., None, None].expand(-1, -1, 1, 5)).squeeze(2)
            found = valid.any(-1) & missing
            boxes = torch.where(found[..., None], chosen, boxes)
            missing = missing & ~found
        scene = Scene(start=start, goal=goal, human=human, boxes=boxes, batch_size=[batch_size])
        return scene if device is None else scene.to(device)
