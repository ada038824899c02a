"""The reference engine: every scene is a real pymunk space, which users can look into and build on."""

from __future__ import annotations

from enum import IntEnum

import pymunk
import torch
from torch import Tensor

from morlnav.navigation.world.base import Contact, World
from morlnav.navigation.world.scene import Scene

ROBOT_FILTER = pymunk.ShapeFilter(group=1)
"""The robot's own shapes carry this filter: they never meet each other, and the lidar looks through them."""


class Kind(IntEnum):
    """What a shape is; kept in its ``collision_type``. Touching any other kind than ``HUMAN`` counts as a box."""

    ROBOT = 1
    HUMAN = 2
    BOX = 3


class PymunkWorld(World):
    """Drives each robot in a :class:`pymunk.Space` of its own; slower than ``TensorWorld``, and open to other bodies.

    pymunk moves the robot, finds the contacts and casts the rays. The robot is a kinematic body whose velocity points
    along the chord to the next check point of the exact arc, so that pymunk's step ends on the arc and other bodies
    feel the robot move. Override :meth:`build_space` to add bodies and shapes: they move as pymunk says, the lidar sees
    them, and touching them ends a step as touching a box does, unless they are sensors; shapes with ``ROBOT_FILTER``
    are neither seen nor touched. Pickling keeps whole spaces; :meth:`state_dict` holds poses and scenes only, so bodies
    of yours begin anew from it.

    Arguments as for :class:`World`.

    Examples:
        >>> from morlnav.navigation.world.scene import SceneSampler
        >>> class Promenade(PymunkWorld):
        ...     def build_space(self, scene):
        ...         space = super().build_space(scene)
        ...         walker = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        ...         walker.position, walker.velocity = (1.0, -2.0), (0.0, 1.0)
        ...         shape = pymunk.Circle(walker, self.human_radius)
        ...         shape.collision_type = Kind.HUMAN
        ...         space.add(walker, shape)
        ...         return space
        >>> world = Promenade()
        >>> world.reset(SceneSampler(num_boxes=0)(4))
        >>> contact = world.step(torch.zeros(4, 2))
        >>> round(list(world.space(0).bodies)[-1].position.y, 6)
        -1.8
        >>> world.observe().shape
        torch.Size([4, 34])
    """

    def build_space(self, scene: Scene) -> pymunk.Space:
        """A new space for one scene; override it to add bodies and shapes to what this returns.

        Args:
            scene: one scene on the CPU, without batch dimensions: ``start`` ``[3]``, ``goal`` and ``human`` ``[2]``,
                ``boxes`` ``[K, 5]``.

        Returns:
            A space without gravity that holds the kinematic robot, a static circle for the human, and a static polygon
            for each box. The robot is the body of the first shape of ``Kind.ROBOT``; further shapes of that body need
            ``ROBOT_FILTER``.
        """
        space = pymunk.Space()

        def add(shape: pymunk.Shape, kind: Kind) -> None:
            shape.collision_type = kind
            space.add(shape.body, shape)

        robot = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        _place(robot, scene.start.tolist())
        disc = pymunk.Circle(robot, self.robot.radius)
        disc.filter = ROBOT_FILTER
        add(disc, Kind.ROBOT)
        human = pymunk.Body(body_type=pymunk.Body.STATIC)
        _place(human, (*scene.human.tolist(), 0.0))
        add(pymunk.Circle(human, self.human_radius), Kind.HUMAN)
        for x, y, half_length, half_width, angle in scene.boxes.tolist():
            box = pymunk.Body(body_type=pymunk.Body.STATIC)
            _place(box, (x, y, angle))
            add(pymunk.Poly.create_box(box, (2 * half_length, 2 * half_width)), Kind.BOX)
        return space

    def space(self, index: int) -> pymunk.Space:
        """The space of slot ``index``, alive: what you add or move counts from the next step on.

        Raises:
            RuntimeError: before the first :meth:`reset`.

        >>> from morlnav.navigation.world.scene import SceneSampler
        >>> world = PymunkWorld()
        >>> world.reset(SceneSampler(num_boxes=3)(2))
        >>> sorted(shape.collision_type for shape in world.space(1).shapes)
        [1, 2, 3, 3, 3]
        """
        if self.scene is None:
            raise RuntimeError("The world has no spaces yet; call reset first.")
        return self._spaces[index]

    def reset(self, scene: Scene, mask: Tensor | None = None) -> None:
        """See :meth:`World.reset`. Only the slots in ``mask`` get a new space."""
        everywhere = mask is None or self.scene is None
        super().reset(scene, mask)
        if everywhere:
            self._spaces: list[pymunk.Space | None] = [None] * len(self.pose)
            self._robots: list[pymunk.Body | None] = [None] * len(self.pose)
        scenes = self.scene.cpu()
        for i in range(len(self.pose)) if everywhere else mask.nonzero().flatten().tolist():
            space = self.build_space(scenes[i])
            self._spaces[i] = space
            self._robots[i] = next(shape.body for shape in space.shapes if shape.collision_type == Kind.ROBOT)

    def step(self, action: Tensor) -> Contact:
        """See :meth:`World.step`."""
        path = self.path(action)
        reached = (path[..., :2] - self.scene.goal.unsqueeze(1)).norm(dim=-1) <= self.goal_radius
        slots = zip(self._spaces, self._robots, path.tolist(), action[:, 1].tolist(), reached.tolist(), strict=True)
        last, human, box, goal = torch.tensor([self._drive(*slot) for slot in slots], device=self.device).unbind(-1)
        self.pose = path[torch.arange(len(path), device=self.device), last]
        duration = (last + 1) * (self.step_time / self.substeps)
        return Contact(human=human.bool(), box=box.bool(), goal=goal.bool(), duration=duration, batch_size=last.shape)

    def _drive(
        self, space: pymunk.Space, robot: pymunk.Body, path: list[list[float]], turn: float, reached: list[bool]
    ) -> tuple[int, bool, bool, bool]:
        """Drive along ``path`` up to the first event; returns where it was and what was met there."""
        duration = self.step_time / self.substeps
        robot.angular_velocity = turn
        for k, (x, y, _) in enumerate(path):
            robot.velocity = (pymunk.Vec2d(x, y) - robot.position) / duration
            space.step(duration)
            met = {
                hit.shape.collision_type
                for shape in robot.shapes
                for hit in space.shape_query(shape)
                if hit.shape.body is not robot and not hit.shape.sensor
            }
            if met or reached[k]:
                break
        return k, Kind.HUMAN in met, bool(met - {Kind.HUMAN}), reached[k] and not met

    def cast(self) -> Tensor:
        """Distances in metres along every ray, clipped to the range, ``[B, rays]``.

        A ray that begins inside a shape reads 0, as in :meth:`Lidar.cast`.
        """
        reach = self.lidar.max_range
        pose = self.pose.double().cpu()
        angles = pose[:, 2:] + self.lidar.angles().double()
        ends = pose[:, None, :2] + reach * torch.stack([angles.cos(), angles.sin()], -1)
        rows = [
            [space.segment_query_first(start, end, 0, ROBOT_FILTER) for end in row]
            for space, start, row in zip(self._spaces, pose[:, :2].tolist(), ends.tolist(), strict=True)
        ]
        fractions = torch.tensor([[1.0 if hit is None else hit.alpha for hit in row] for row in rows])
        return (reach * fractions).to(self.device)

    def scan(self) -> Tensor:
        """See :meth:`World.scan`."""
        return self.lidar.pool(self.cast())

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """See :meth:`World.load_state_dict`. Spaces are built anew, with the robots where they were."""
        super().load_state_dict(state)
        for space, robot, pose in zip(self._spaces, self._robots, self.pose.tolist(), strict=True):
            _place(robot, pose)
            space.reindex_shapes_for_body(robot)


def _place(body: pymunk.Body, pose: tuple[float, ...] | list[float]) -> None:
    x, y, angle = pose
    body.position, body.angle = (x, y), angle
