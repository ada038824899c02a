"""Contenders measured side by side: everyone takes a turn in every round, so that a slow moment hits all alike."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import torch


class NotAvailable(Exception):
    """Raised while a contender is built that cannot run here; its text becomes the row's note."""


@dataclass(frozen=True)
class Effort:
    """How long and where to measure.

    Args:
        rounds: turns of every contender; medians and quartiles are over these.
        seconds: least duration of a turn.
        device: where the contenders work.
        batches: batch sizes of the environments.
        quick: small sizes and no peers, to try the benchmark itself.

    Raises:
        ValueError: for numbers with which nothing would be measured.
    """

    rounds: int = 5
    seconds: float = 0.4
    device: str = "cpu"
    batches: Sequence[int] = (1, 3, 64, 1024, 8192)
    quick: bool = False

    def __post_init__(self) -> None:
        if self.rounds < 1 or not 0 <= self.seconds < math.inf or min(self.batches) < 1:
            raise ValueError(
                "Needed are rounds >= 1, seconds >= 0 and batches >= 1, got "
                f"{self.rounds}, {self.seconds:g} and {', '.join(map(str, self.batches))}."
            )


@dataclass(frozen=True)
class Contender:
    """Something to measure.

    Args:
        name: what the row is called.
        build: prepares everything and returns the function to be timed; raises ``ImportError`` where a package is
            missing, :class:`NotAvailable` where it cannot run.
        work: units of work that one call does, such as environment steps.
        note: what a reader must know to compare.
        ours: morlnav itself.
        peer: of others; a quick try leaves it out.
    """

    name: str
    build: Callable[[], Callable[[], object]]
    work: float = 1.0
    note: str = ""
    ours: bool = True
    peer: bool = False


@dataclass(frozen=True)
class Row:
    """One row of the table: what a contender reached in every round, or, without values, why it did not run.

    Args:
        group: the group of rows.
        case: contenders of one case are compared with its first one.
        name: the contender.
        unit: of the values.
        values: one per round.
        note: for the reader.
        size: the case's size, where a group runs through several.
        less_is_better: for bytes and seconds.
        ours: whether it is morlnav that was measured, and not a peer or a limit.
    """

    group: str
    case: str
    name: str
    unit: str
    values: list[float] = field(default_factory=list)
    note: str = ""
    size: float | None = None
    less_is_better: bool = False
    ours: bool = True


def race(
    group: str, case: str, unit: str, contenders: Iterable[Contender], effort: Effort, size: float | None = None
) -> list[Row]:
    """Build all contenders, then let them take turns; rates are in units of work per second.

    Examples:
        >>> sleeper = Contender("sleeper", lambda: lambda: time.sleep(0.001), work=3)
        >>> row, = race("sleep", "short", "naps/s", [sleeper], Effort(rounds=2, seconds=0.01))
        >>> len(row.values), row.values[0] < 3000
        (2, True)
    """
    runners: list[tuple[Contender, Callable[[], object] | None, int, str]] = []
    for contender in contenders:
        if contender.peer and effort.quick:
            continue
        step, calls, note = None, 0, contender.note
        try:
            step = contender.build()
            calls = _calls(step, effort)
        except ImportError as error:
            note = f"missing: {str(error).splitlines()[0]}"
        except NotAvailable as error:
            note = str(error)
        runners.append((contender, step, calls, note))
    values: list[list[float]] = [[] for _ in runners]
    for _ in range(effort.rounds):
        for (contender, step, calls, _), rates in zip(runners, values, strict=True):
            if step is not None:
                rates.append(calls * contender.work / duration(step, calls, effort.device))
    return [
        Row(group, case, contender.name, unit, rates, note, size, ours=contender.ours and not contender.peer)
        for (contender, _, _, note), rates in zip(runners, values, strict=True)
    ]


def duration(step: Callable[[], object], calls: int, device: str = "cpu") -> float:
    """Seconds that ``calls`` calls take, until the device is done with them."""
    _synchronise(device)
    start = time.perf_counter()
    for _ in range(calls):
        step()
    _synchronise(device)
    return time.perf_counter() - start


def _calls(step: Callable[[], object], effort: Effort) -> int:
    """Warm up, and see how many calls fill a turn."""
    duration(step, 1, effort.device)  # compiles, allocates
    once = duration(step, 1, effort.device)
    if once < effort.seconds / 4:  # one fast call says little
        few = max(1, int(effort.seconds / 4 / once))
        once = duration(step, few, effort.device) / few
    return max(1, round(effort.seconds / once))


def _synchronise(device: str) -> None:
    if torch.device(device).type == "cuda":
        torch.cuda.synchronize(device)
