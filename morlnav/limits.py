"""Numbers out of range, refused in one sentence."""

from __future__ import annotations


def check_at_least(least: float, /, **values: float | None) -> None:
    """Refuse numbers below ``least`` by their names; ``None`` passes, NaN does not.

    >>> check_at_least(1, steps=0)
    Traceback (most recent call last):
    ValueError: steps must be at least 1, got 0.
    >>> check_at_least(0, seed=None, plans=-1)
    Traceback (most recent call last):
    ValueError: plans must not be negative, got -1.
    """
    for name, value in values.items():
        if value is not None and not value >= least:
            raise ValueError(f"{name} must {f'be at least {least}' if least else 'not be negative'}, got {value}.")


def check_positive(**values: float | None) -> None:
    """Refuse numbers that are not above 0 by their names; ``None`` passes, NaN does not.

    >>> check_positive(speed=0.5, radius=0.0)
    Traceback (most recent call last):
    ValueError: radius must be positive, got 0.0.
    """
    for name, value in values.items():
        if value is not None and not value > 0:
            raise ValueError(f"{name} must be positive, got {value}.")
