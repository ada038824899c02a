"""Preferences as a person reads them in a log: ``demo=0,distance=0.25,efficiency=0.75``."""

from __future__ import annotations

from collections.abc import Iterable


def preference_label(names: Iterable[str], weights: Iterable[float]) -> str:
    """One weight per objective, to two digits; fit for a tag of TensorBoard and for the name of a file.

    >>> preference_label(["demo", "distance"], [0.0, 1.0])
    'demo=0,distance=1'
    """
    return ",".join(f"{name}={round(weight, 2):g}" for name, weight in zip(names, weights, strict=True))


def read_preference_label(metric: str) -> dict[str, float]:
    """The weights that a logged metric stands for, by objective; none if it stands for no preference.

    >>> read_preference_label("evaluation/frechet/demo=0.25,distance=0.75")
    {'demo': 0.25, 'distance': 0.75}
    >>> read_preference_label("evaluation/success")
    {}
    """
    label = metric.rsplit("/", 1)[-1]
    if "=" not in label:
        return {}
    return {name: float(weight) for name, _, weight in (part.partition("=") for part in label.split(","))}
