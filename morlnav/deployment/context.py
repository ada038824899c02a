"""Preferences by context: which navigation style suits the room the robot is in (Fig. 1d)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import torch
import yaml
from torch import Tensor, nn

from morlnav.deployment.policy import Policy


def load_contexts(path: str | Path, objectives: tuple[str, ...]) -> dict[str, Tensor]:
    """Preferences by room from a YAML file, such as ``corridor: {efficiency: 0.8, distance: 0.2}``.

    Args:
        path: of the file: one entry per room, which maps objectives to weights of at least 0; objectives that are not
            named get 0, and the weights are divided by their sum.
        objectives: names of the preference's entries, in order.

    Returns:
        λ ``[n]`` on the simplex for every room, in the file's order.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is no such mapping, or names an unknown objective, a negative weight, or none above 0.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp(), "rooms.yaml")
        >>> _ = file.write_text("corridor: {efficiency: 3, distance: 1}")
        >>> load_contexts(file, ("distance", "efficiency"))
        {'corridor': tensor([0.2500, 0.7500])}
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no file of contexts {path}.")
    try:
        rooms = yaml.safe_load(path.read_text(encoding="utf-8"))  # not by OmegaConf, which resolves
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        raise ValueError(f"{path} is not readable as YAML{where}.") from error
    if not isinstance(rooms, dict) or not all(isinstance(weights, dict) for weights in rooms.values()) or not rooms:
        raise ValueError(f"{path} must map rooms to weights, such as corridor: {{{objectives[-1]}: 1.0}}.")
    return {str(room): _preference(f"{room} in {path}", weights, objectives) for room, weights in rooms.items()}


def _preference(where: str, weights: Mapping[str, object], objectives: tuple[str, ...]) -> Tensor:
    for name, weight in weights.items():
        if name not in objectives:
            raise ValueError(f"{where} names {name}, which is no objective; choose from: {', '.join(objectives)}.")
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 <= weight < math.inf:
            given = weight if isinstance(weight, (int, float)) else f"of type {type(weight).__name__}"
            raise ValueError(f"{where} gives {name} the weight {given}; weights are numbers of at least 0.")
    if sum(weights.values()) == 0:
        raise ValueError(f"{where} needs a weight above 0.")
    preference = torch.tensor([float(weights.get(name, 0)) for name in objectives])
    return preference / preference.sum()


class ContextPolicy(nn.Module):
    """A policy that knows how to behave in which room, and changes its style smoothly when it enters another.

    Once per control step the preference moves a part of the way to that of the current room, so that it never leaves
    the simplex: ``λ ← λ + (1 - exp(-Δt/τ))·(λ_room - λ)``.

    Args:
        policy: maps observations and preferences to actions.
        contexts: λ ``[n]`` by room, as :func:`load_contexts` reads them.
        room: where the robot begins; the first of ``contexts`` by default.
        time_constant: ``τ`` in seconds; 0 changes at once.
        step_time: ``Δt``, one control step in seconds.

    Raises:
        ValueError: for no contexts, preferences that do not fit the policy, an unknown room, or times out of range.

    Examples:
        >>> policy = Policy(lambda observation, preference: preference, ("distance", "efficiency"))
        >>> rooms = {"kitchen": torch.tensor([1.0, 0.0]), "corridor": torch.tensor([0.0, 1.0])}
        >>> robot = ContextPolicy(policy, rooms, time_constant=0.2)
        >>> _ = robot(torch.zeros(34))  # drives in the kitchen
        >>> robot.enter("corridor")
        >>> robot(torch.zeros(34))  # the policy of this example acts as it is told
        tensor([0.3679, 0.6321])
    """

    def __init__(
        self,
        policy: Policy,
        contexts: Mapping[str, Tensor],
        room: str | None = None,
        time_constant: float = 1.0,
        step_time: float = 0.2,
    ) -> None:
        super().__init__()
        if not contexts:
            raise ValueError("A context policy needs at least one room.")
        if time_constant < 0 or step_time <= 0:
            raise ValueError(f"Needed are time_constant >= 0 and step_time > 0, got {time_constant} and {step_time}.")
        for name, preference in contexts.items():
            if preference.shape != (len(policy.objectives),):
                raise ValueError(f"The preference of {name} needs one entry for each of {policy.objectives}.")
        self.policy = policy
        self.rooms = tuple(contexts)
        self.step_time = step_time
        self.rate = -math.expm1(-step_time / time_constant) if time_constant else 1.0
        self.register_buffer("preferences", torch.stack(list(contexts.values())))
        self.enter(room if room is not None else self.rooms[0])
        self.register_buffer("preference", self.preferences[self._room].clone())

    def enter(self, room: str) -> None:
        """From the next step on the robot is in ``room``.

        Raises:
            ValueError: for an unknown room.
        """
        self._room = self._find(room)

    def _find(self, room: str) -> int:
        if room not in self.rooms:
            raise ValueError(f"There is no room {room}; choose from: {', '.join(self.rooms)}.")
        return self.rooms.index(room)

    @torch.no_grad()
    def forward(self, observation: Tensor) -> Tensor:
        """Action ``[..., 2]`` for raw observations ``[..., D]``; one control step passes."""
        self.preference = self.preference.lerp(self.preferences[self._room], self.rate)
        return self.policy(observation, self.preference)

    def schedule(self, route: Mapping[float, str], steps: int) -> Tensor:
        """λ at every control step ``[steps, n]`` of a drive through rooms; the robot itself stays as it is.

        :func:`~morlnav.navigation.evaluation.evaluate_policy` takes a stack of schedules in place of fixed preferences.

        Args:
            route: room by the second in which it is entered; the first at 0, where the robot begins in its style.
            steps: number of control steps.

        Raises:
            ValueError: if the route does not begin at 0, or names an unknown room.
        """
        if not route or min(route) != 0 or not all(map(math.isfinite, route)):
            raise ValueError(f"A route begins at 0 seconds and goes on at finite ones, got {dict(route)}.")
        targets = {time: self.preferences[self._find(room)] for time, room in route.items()}
        rows: list[Tensor] = []
        for step in range(steps):
            target = targets[max(time for time in route if time <= step * self.step_time + 1e-6)]
            rows.append(target if not rows else rows[-1].lerp(target, self.rate))
        return torch.stack(rows)
