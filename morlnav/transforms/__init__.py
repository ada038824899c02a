"""Transforms of environments and replay buffers."""

from morlnav.transforms.preference import DrawPreference
from morlnav.transforms.relabel import HindsightPreferenceRelabel

__all__ = ["DrawPreference", "HindsightPreferenceRelabel"]
