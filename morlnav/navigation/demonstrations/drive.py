"""Demonstrating by driving the robot in a window."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict
from torch import Tensor

from morlnav.navigation.demonstrations.folder import (
    check_world,
    demonstration_settings,
    join_demonstrations,
    load_demonstrations,
    save_demonstrations,
)
from morlnav.navigation.demonstrations.record import as_episodes
from morlnav.navigation.envs import NavigationEnv
from morlnav.navigation.world import Scene, World
from morlnav.navigation.world.geometry import polar

if TYPE_CHECKING:
    import pygame

    from morlnav.navigation.demonstrations.window import SceneWindow

TURN = 1.2
"""Angular velocity in rad/s while an arrow key is held."""

HELP = (
    "Arrows, or the mouse with its button held, drive; Shift: at half speed.",
    "N: another scene, R: this one again, Esc: save and leave.",
)


class Controls:
    """What keys and mouse ask for, told by pygame's events.

    ``UP`` drives, ``LEFT`` and ``RIGHT`` turn, also on the spot; a held mouse button drives toward the pointer.
    """

    def __init__(self) -> None:
        self.held: set[str] = set()
        self.pointer = (0, 0)

    def hear(self, event: pygame.event.Event) -> str | None:
        """Take note of an event; returns the name of the key that was pressed, ``"quit"`` for a closed window."""
        import pygame

        if event.type == pygame.QUIT:
            return "quit"
        if event.type in (pygame.KEYDOWN, pygame.KEYUP):
            name = pygame.key.name(event.key).removeprefix("left ").removeprefix("right ")
            (self.held.add if event.type == pygame.KEYDOWN else self.held.discard)(name)
            return name if event.type == pygame.KEYDOWN else None
        if event.type in (pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP, pygame.MOUSEMOTION):
            self.pointer = event.pos
        if event.type == pygame.MOUSEBUTTONDOWN:
            self.held.add("mouse")
        if event.type == pygame.MOUSEBUTTONUP:
            self.held.discard("mouse")
        return None

    def action(self, world: World, window: SceneWindow) -> Tensor:
        """The action ``[2]`` (m/s, rad/s) that is asked for now."""
        robot = world.robot
        if "mouse" in self.held:
            distance, bearing = polar(window.to_world(self.pointer), world.pose[0].cpu())
            speed = robot.max_speed * bearing.cos().clamp_min(0) * (distance / 0.5).clamp_max(1)
            action = torch.stack([speed, bearing / (2 * world.step_time)])
        else:
            turn = TURN * (("left" in self.held) - ("right" in self.held))
            action = torch.tensor([robot.max_speed * ("up" in self.held), turn])
        return robot.limit(action * (0.5 if "shift" in self.held else 1.0))


class Recorder:
    """Lets somebody drive in random scenes and keeps the episodes that reach the goal.

    Args:
        world: the engine.
        scenes: called as ``scenes(n, device=..., generator=...)`` for ``n`` new scenes.
        keep: called with the transitions ``[T]`` of every successful episode as soon as it ends.
        window: where it is shown.
        seed: of the scenes.
        frame_rate: pictures per second; ``None`` runs as fast as it can, with one picture per control step.
    """

    def __init__(
        self,
        world: World,
        scenes: Callable[..., Scene],
        keep: Callable[[TensorDict], None],
        window: SceneWindow,
        seed: int = 0,
        frame_rate: int | None = 30,
    ) -> None:
        self.env = NavigationEnv(world, scenes, num_envs=1, seed=seed)
        self.keep, self.window, self.frame_rate = keep, window, frame_rate
        self.controls, self.count, self.news = Controls(), 0, "Drive to the blue goal."
        self.begin()

    def begin(self, again: bool = False) -> None:
        """Begin an episode in a new scene, or in the same one again."""
        self.now = self.env.reset(scene=self.env.world.scene) if again else self.env.reset()
        self.frames: list[TensorDict] = []

    def run(self) -> int:
        """Drive until the window is closed; returns the number of demonstrations."""
        import pygame

        clock = pygame.time.Clock()
        while self.listen():
            before, action = self.env.world.pose[0].clone(), self.controls.action(self.env.world, self.window)
            pictures = 1 if self.frame_rate is None else max(1, round(self.frame_rate * self.env.world.step_time))
            for picture in range(pictures):
                part = self.env.world.step_time * picture / pictures
                self.draw(self.env.world.robot.move(before, action.to(before), part))
                clock.tick(self.frame_rate or 0)
            self.step(action)
        return self.count

    def listen(self) -> bool:
        """Handle waiting events; false if the window is to close."""
        import pygame

        for event in pygame.event.get():
            heard = self.controls.hear(event)
            if heard in ("quit", "escape"):
                return False
            if heard in ("n", "r"):
                self.begin(again=heard == "r")
        return True

    def step(self, action: Tensor) -> None:
        """Drive for one control step; standing still before the first move is not recorded."""
        if not self.frames and not action.any():
            return
        state = self.now.select("observation", "pose").set("action", action.unsqueeze(0).to(self.env.device))
        state = self.env.step(state)
        frame = state.select("observation", "pose", "action", "next").clone()
        self.frames.append(frame.set("executed_action", frame["action"]))
        self.now = state["next"]
        outcome = self.now["outcome"]
        if outcome["goal"].item():
            self.keep(as_episodes(self.frames, self.env.world.scene)[0])
            self.count += 1
            self.news = f"Arrived: {self.count} demonstrations are saved."
            self.begin()
        elif self.now["done"].item():
            self.news = f"You touched {'the human' if outcome['human'].item() else 'a box'}; try this scene again."
            self.begin(again=True)

    def draw(self, pose: Tensor | None = None) -> None:
        """Show the scene with the robot at ``pose`` ``[3]``, by default where it is."""
        world = self.env.world
        pose = (world.pose[0] if pose is None else pose).cpu()
        path = torch.cat([*(frame["pose"].cpu() for frame in self.frames), pose.unsqueeze(0)])
        scan = self.now["observation"][0, 4:].cpu()
        lines = [self.news, f"{len(self.frames) * world.step_time:.1f} s", *HELP]
        self.window.draw(world.scene[0].cpu(), pose, scan, path, lines)


def add_demonstrations(data: TensorDict, path: Path, source: str, world: World | None = None) -> int:
    """Add episodes to a folder of demonstrations, or begin one; at no time the folder is without those it had.

    Args:
        data: transitions ``[N]``, episodes numbered in ascending order.
        path: of the folder.
        source: where they come from, for the folder's settings.
        world: that they were driven in, for the folder's settings; that of those in the folder must be the same.

    Returns:
        The number of episodes in the folder.

    Raises:
        ValueError: if the folder's demonstrations are of another world, or seen by another lidar.
    """
    path = path.resolve()  # a link stays one
    unfinished, replaced = (path.with_name(path.name + end) for end in (".part", ".old"))
    if replaced.exists() and not path.exists():  # interrupted between the last two steps below
        replaced.rename(path)
    parts, settings = [data], {"source": source}
    if path.exists() and any(path.iterdir()):
        if world is not None:
            check_world(path, world)
        parts, before = [load_demonstrations(path), data], demonstration_settings(path)
        sources = [*before.get("source", "").split(", "), source]
        settings = before | {"source": ", ".join(dict.fromkeys(name for name in sources if name))}
    try:
        data = join_demonstrations(parts)
    except ValueError as error:
        raise ValueError(f"The demonstrations in {path} are others: {error}; record into another folder.") from error
    for leftover in (unfinished, replaced):
        shutil.rmtree(leftover, ignore_errors=True)
    try:
        save_demonstrations(data, unfinished, settings, world)
    except OSError:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    if path.exists():
        path.rename(replaced)
    unfinished.rename(path)
    shutil.rmtree(replaced, ignore_errors=True)
    return int(data["episode"].max()) + 1
