"""A project of somebody else: a part of its own for everything that morlnav swaps, each as small as it can be."""

from swapper.marks import USED

__all__ = ["USED"]
