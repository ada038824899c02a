"""The paper's Table I, to set one's own numbers beside."""

from __future__ import annotations

import numpy as np

TABLE_ONE = {
    "SR": ("SR %", 1, ""),
    "CR": ("CR %", 1, ""),
    "TR": ("TR %", 1, ""),
    "min_human_distance": ("min d_h m", 2, "distance"),
    "frechet": ("Fréchet m", 2, "demo"),
    "navigation_time": ("time s", 1, "efficiency"),
}
"""Metrics of Table I: heading, digits, and the objective that has all weight; without one all λ count."""

PAPER = {
    "our": ("OUR", (100, 0, 0, 1.18, 0.41, 17.3)),
    "no_human": ("-NH", (96.8, 2.7, 0.5, 0.52, 0.57, 16.9)),
    "state_reward": ("-RM", (100, 0, 0, 1.16, 0.46, 17.4)),
    "no_human,state_reward": ("-RM-NH", (79.6, 11.4, 9.0, 0.48, 0.49, 19.2)),
    "gamma_099": ("-γ", (96.0, 4.0, 0.0, 1.22, 0.50, 18.3)),
    "baseline": ("baseline agent", (97, np.nan, np.nan, 0.64, np.nan, np.nan)),
}
"""What the paper calls a word of the group ``ablation``, and its numbers (Table I, Sec. IV-C.1)."""


def paper_name(ablation: str) -> str | None:
    """What the paper calls a word of the group ``ablation``; ``None`` for one that it does not have.

    >>> paper_name("state_reward,no_human"), paper_name("no_angle")
    ('-RM-NH', None)
    """
    return next((name for name, _ in published(ablation)), None)


def published(ablation: str) -> list[tuple[str, tuple[float, ...]]]:
    """Name and numbers in the paper of what several words, in any order, leave out together."""
    words = sorted(ablation.split(","))
    return [entry for word, entry in PAPER.items() if sorted(word.split(",")) == words]
