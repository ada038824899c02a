"""The foreign package is found, and its marks are read after a run."""

from pathlib import Path

import pytest

FOLDER = str(Path(__file__).parent)


@pytest.fixture
def used(monkeypatch):
    """What left a mark; empty at first."""
    monkeypatch.syspath_prepend(FOLDER)
    from swapper import USED

    USED.clear()
    return USED
