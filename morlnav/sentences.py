"""What errors say, in one sentence."""

from __future__ import annotations

import difflib
from collections.abc import Collection


def nearest(name: str, names: Collection[str]) -> str:
    """What may have been meant by a name that is none of ``names``.

    >>> nearest("totl_frames", ["total_frames", "seed"]), nearest("foo", ["a", "b"])
    ('did you mean total_frames?', 'choose from: a, b.')
    """
    close = difflib.get_close_matches(name, names, 1)
    return f"did you mean {close[0]}?" if close else f"choose from: {', '.join(names) or 'nothing'}."


def causes(error: BaseException) -> list[BaseException]:
    """An error and all that it was raised from, the first of them last.

    >>> error = ValueError("actor: no such file")
    >>> error.__cause__ = OSError("no such file")
    >>> causes(error)
    [ValueError('actor: no such file'), OSError('no such file')]
    """
    return [error, *(causes(error.__cause__) if error.__cause__ is not None else [])]


def first_line(error: BaseException) -> str:
    """What an error says, in one line; its kind where it says nothing.

    >>> first_line(ValueError("Too long. \\n See below.")), first_line(KeyError())
    ('Too long.', 'KeyError')
    """
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
