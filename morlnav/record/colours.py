"""Colours of objectives, the same in every figure, and their mixtures by preference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import to_rgb

COLOURS = {"demo": "#18a572", "distance": "#2b62d9", "efficiency": "#ff8c1a"}
"""Colours of known objectives; others take those of ``SPARE_COLOURS`` in turn."""

SPARE_COLOURS = ("#b0489d", "#8a6d3b", "#17a2b8", "#c0392b", "#7f7f7f")
INK = "#333333"
SETTINGS = ("#333333", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of a sweep's settings in turn, which a colour-blind eye tells apart (Okabe and Ito)."""
MARKERS = "osD^vPX"
"""Marks of a sweep's settings in turn."""


def setting_style(place: int) -> tuple[str, str, str]:
    """Colour, mark and line of a sweep's settings by their place in it; colours that come again have others beside.

    >>> setting_style(0), setting_style(7)
    (('#333333', 'o', '-'), ('#333333', 's', '--'))
    """
    turn = place // len(SETTINGS)
    return SETTINGS[place % len(SETTINGS)], MARKERS[(place + turn) % len(MARKERS)], ("-", "--", ":")[turn % 3]


def objective_colours(objectives: Sequence[str]) -> list[str]:
    """One colour per objective, the same in every figure.

    >>> objective_colours(["efficiency", "comfort"])
    ['#ff8c1a', '#b0489d']
    """
    spare = [name for name in objectives if name not in COLOURS]
    return [
        COLOURS[name] if name in COLOURS else SPARE_COLOURS[spare.index(name) % len(SPARE_COLOURS)]
        for name in objectives
    ]


def blend(preferences: np.ndarray, colours: Sequence[str]) -> np.ndarray:
    """Colours of the objectives mixed by λ ``[P, n]``, as light mixes, which keeps them clear of grey; ``[P, 3]``.

    >>> blend(np.array([[1.0, 0.0], [0.5, 0.5]]), ["#ff0000", "#0000ff"]).round(2).tolist()
    [[1.0, 0.0, 0.0], [0.71, 0.0, 0.71]]
    """
    light = np.array([to_rgb(colour) for colour in colours]) ** 2
    return np.sqrt(np.clip(preferences @ light, 0, 1))
