"""Who stands in the way, as scans see it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

PERSON = (0.1, 0.9)
"""Least and largest extent of somebody who stands, in metres."""


def things(points: np.ndarray, gap: float = 0.15, cell: float = 0.03) -> Iterator[tuple[np.ndarray, bool]]:
    """Centres ``[2]`` of clusters of a person's size, and whether they are round.

    Args:
        points: x, y and the number of the scan, ``[N, 3]``; a person is seen in several scans.
        gap: between points of one cluster, in metres.
        cell: side of the cells that points are gathered in first, in metres.

    Examples:
        >>> angle = np.linspace(0, 6, 50)
        >>> circle = np.column_stack([3 + 0.3 * np.cos(angle), 1 + 0.3 * np.sin(angle), np.arange(50) // 10])
        >>> [(centre.round(2).tolist(), bool(is_round)) for centre, is_round in things(circle)]
        [([3.0, 1.0], True)]
    """
    if not len(points):
        return
    cells, where = np.unique(np.round(points[:, :2] / cell).astype(int), axis=0, return_inverse=True)
    pairs = cKDTree(cells * cell).query_pairs(gap, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    count, label = connected_components(graph, directed=False)
    label = label[where.reshape(-1)]
    order = np.argsort(label, kind="stable")
    for cluster in np.split(points[order], np.searchsorted(label[order], np.arange(1, count))):
        size = np.ptp(cluster[:, :2], axis=0).max()
        if PERSON[0] <= size <= PERSON[1] and len(cluster) >= 20 and len(np.unique(cluster[:, 2])) >= 5:
            yield _circle(cluster[:, :2])


def _circle(points: np.ndarray) -> tuple[np.ndarray, bool]:
    """The centre ``[2]`` of a circle through points ``[N, 2]``, or of their extent where they lie on none."""
    matrix = np.column_stack([2 * points, np.ones(len(points))])
    x, y, rest = np.linalg.lstsq(matrix, (points**2).sum(1), rcond=None)[0]
    radius = np.sqrt(max(rest + x * x + y * y, 0.0))
    off = np.std(np.hypot(points[:, 0] - x, points[:, 1] - y))
    if 0.08 <= radius <= 0.6 and off < 0.1 * radius:
        return np.array([x, y]), True
    return (points.max(0) + points.min(0)) / 2, False
