"""What people prefer: files of comparisons between two snippets of roll-outs, and minibatches of them."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, pad_sequence
from torch import Tensor

from morlnav.limits import check_at_least

COLUMNS = ("first", "second", "preferred")
ANSWERS = ("first", "second", "tie")


class Snippet(NamedTuple):
    """Steps ``start`` to before ``stop`` of an episode; to its end where ``stop`` is ``None``."""

    episode: int
    start: int = 0
    stop: int | None = None


class Comparison(NamedTuple):
    """Two snippets, and which of them is preferred: ``"first"``, ``"second"``, or ``"tie"``."""

    first: Snippet
    second: Snippet
    preferred: str


def read_comparisons(path: str | Path) -> list[Comparison]:
    """Read a file of comparisons.

    A row, or a line of JSON, has ``first``, ``second`` and ``preferred``. The first two are snippets: the number of an
    episode, or ``EPISODE:START:STOP`` in steps. The last is ``first``, ``second`` or ``tie``.

    Args:
        path: of a ``.csv`` file with a header, or a ``.jsonl`` file with a JSON object in each line.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the line, for whatever does not follow the schema, or a file without comparisons.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "comparisons.jsonl"
        >>> _ = file.write_text('{"first": 3, "second": "0:10:35", "preferred": "second"}')
        >>> read_comparisons(file)[0].second
        Snippet(episode=0, start=10, stop=35)
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no file of comparisons {path}.")
    if path.suffix.lower() not in (".csv", ".jsonl"):
        raise ValueError(f"Comparisons are .csv or .jsonl files, got {path}.")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text in UTF-8.") from error
    rows = _from_json(path, text) if path.suffix.lower() == ".jsonl" else _from_csv(path, text)
    comparisons = [_comparison(where, row) for where, row in rows]
    if not comparisons:
        raise ValueError(f"{path} holds no comparisons.")
    return comparisons


def _from_json(path: Path, text: str) -> Iterable[tuple[str, Any]]:
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip():
            try:
                yield f"{path}, line {number}", json.loads(line, object_pairs_hook=_entries)
            except (ValueError, RecursionError) as error:
                raise ValueError(f"{path}, line {number} is not readable as JSON.") from error


def _entries(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any] | list[tuple[str, Any]]:
    """An object of JSON; as it is where it names something twice, which no comparison does."""
    return entries if len(entries := dict(pairs)) == len(pairs) else list(pairs)


def _from_csv(path: Path, text: str) -> Iterable[tuple[str, Any]]:
    reader = csv.reader(text.splitlines())
    header = next(reader, [])
    for cells in reader:
        if cells:
            if len(cells) != len(header):
                raise ValueError(f"{path}, line {reader.line_num} has {len(cells)} fields, its header {len(header)}.")
            yield f"{path}, line {reader.line_num}", dict(zip(map(str.strip, header), cells, strict=True))


def _comparison(where: str, row: Any) -> Comparison:
    if not isinstance(row, dict) or set(row) != set(COLUMNS):
        found = ", ".join(map(str, row)) if isinstance(row, dict) else type(row).__name__
        raise ValueError(f"{where} must have {', '.join(COLUMNS)} and nothing else, got {found}.")
    first, second = (_snippet(f"{where}, {name}", row[name]) for name in COLUMNS[:2])
    preferred = str(row["preferred"]).strip()
    if preferred not in ANSWERS:
        raise ValueError(f"{where}, preferred: expected {', '.join(ANSWERS[:2])} or {ANSWERS[2]}, got {preferred!r}.")
    if first == second:
        raise ValueError(f"{where} compares a snippet with itself.")
    return Comparison(first, second, preferred)


def _snippet(where: str, value: Any) -> Snippet:
    match = re.fullmatch(r"\s*(\d+)(?::(\d+):(\d+))?\s*", str(value))
    if isinstance(value, bool) or match is None:
        raise ValueError(f"{where}: expected the number of an episode, or EPISODE:START:STOP in steps, got {value!r}.")
    return Snippet(*(int(part) for part in match.groups() if part is not None))


class ComparedPairs:
    """Draws pairs of snippets, the better one as somebody preferred it.

    A tie is drawn in either order, which teaches what a label of one half would.

    Args:
        comparisons: as :func:`read_comparisons` gives them.
        transitions: ``[N]`` with ``observation``, ``action`` and ``episode``, ordered by step within an episode.
        share: of a reward's updates that learn from these pairs and not from others, above 0 and up to 1.
        batch_size: pairs of an update.
        held_out: share of the decided comparisons that is never trained on; at least one is.

    Attributes:
        held_out: pairs ``[H]``.

    Raises:
        ValueError: for a snippet that is not there, fewer than two decided comparisons, or numbers out of range.

    Examples:
        >>> rows = TensorDict(observation=torch.rand(9, 3), action=torch.rand(9, 1), batch_size=[9])
        >>> rows["episode"] = torch.tensor([0] * 4 + [1] * 5)
        >>> pairs = ComparedPairs([Comparison(Snippet(0), Snippet(1), "second")] * 3, rows, batch_size=8)
        >>> pairs.sample()["better", "mask"].sum(-1)  # of real steps: all of episode 1
        tensor([5, 5, 5, 5, 5, 5, 5, 5])
    """

    key: str = ""
    """What they depend on beyond their config, such as a hash of files."""

    def __init__(
        self,
        comparisons: Sequence[Comparison],
        transitions: TensorDict,
        share: float = 0.5,
        batch_size: int = 16,
        held_out: float = 0.1,
    ) -> None:
        if not 0 < share <= 1:
            raise ValueError(f"share must be above 0 and at most 1, got {share}.")
        check_at_least(1, batch_size=batch_size)
        if not 0 <= held_out < 1:
            raise ValueError(f"held_out must be from 0 to below 1, got {held_out}.")
        self.share, self.batch_size = share, batch_size
        snippets = list(dict.fromkeys(snippet for row in comparisons for snippet in (row.first, row.second)))
        cuts = [_cut(snippet, transitions) for snippet in snippets]
        for cut in cuts:
            cut["mask"] = torch.ones(len(cut), dtype=torch.bool)
        self.snippets = pad_sequence([cut.select("observation", "action", "mask") for cut in cuts])
        self.snippets.batch_size = [len(cuts)]
        index = {snippet: number for number, snippet in enumerate(snippets)}
        for row in comparisons:
            first, second = (cuts[index[snippet]] for snippet in (row.first, row.second))
            if row.first[:2] == row.second[:2] and len(first) == len(second):
                raise ValueError(f"Episode {row.first.episode} from step {row.first.start} on is compared with itself.")
        rows = [
            (row.second, row.first) if row.preferred == "second" else (row.first, row.second) for row in comparisons
        ]
        better_worse = torch.tensor([[index[better], index[worse]] for better, worse in rows])
        tie = torch.tensor([row.preferred == "tie" for row in comparisons])
        decided, ties = better_worse[~tie], better_worse[tie]
        if len(decided) < 2:
            raise ValueError(f"At least two comparisons must be decided, got {len(decided)} and {len(ties)} ties.")
        decided = decided[torch.randperm(len(decided), generator=torch.Generator().manual_seed(0))]
        count = min(max(1, round(held_out * len(decided))), len(decided) - 1)
        self.held_out = self._pairs(decided[:count])
        self.rows = torch.cat([*[decided[count:]] * 2, ties, ties.flip(1)])

    def sample(self) -> TensorDict:
        """``better`` and ``worse``, each with ``observation``, ``action`` and ``mask`` ``[batch_size, L, ...]``."""
        return self._pairs(self.rows[torch.randint(len(self.rows), (self.batch_size,))])

    def _pairs(self, rows: Tensor) -> TensorDict:
        better, worse = rows.unbind(1)
        return TensorDict(better=self.snippets[better], worse=self.snippets[worse], batch_size=[len(rows)])

    def join(self, others: TensorDict) -> TensorDict:
        """Held-out pairs of another source with those held out here, which make up their ``share``.

        Args:
            others: ``[B]`` with ``better`` and ``worse``, each with ``observation``, ``action`` and ``mask``.
        """
        if self.share == 1:
            return self.held_out
        times = -(-round(len(others) * self.share / (1 - self.share)) // len(self.held_out))
        pairs = [others, torch.cat([self.held_out] * max(1, times))]
        longest = max(each["better", "mask"].shape[1] for each in pairs)

        def pad(entry: Tensor) -> Tensor:
            return torch.cat([entry, entry.new_zeros(len(entry), longest - entry.shape[1], *entry.shape[2:])], 1)

        return torch.cat([each.apply(pad) for each in pairs])


def _cut(snippet: Snippet, transitions: TensorDict) -> TensorDict:
    numbers = transitions["episode"]
    if snippet.episode not in numbers.unique().tolist():
        raise ValueError(f"There is no episode {snippet.episode}; they count from {numbers.min()} to {numbers.max()}.")
    episode = transitions[numbers == snippet.episode]
    stop = len(episode) if snippet.stop is None else snippet.stop
    if not snippet.start < stop <= len(episode):
        raise ValueError(
            f"There is no snippet {snippet.episode}:{snippet.start}:{stop}; episode {snippet.episode} has "
            f"{len(episode)} steps."
        )
    return episode[snippet.start : stop]
