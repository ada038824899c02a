"""Trained policies on a robot: loading, preferences by context, export."""

from morlnav.deployment.policy import Policy, load, save

__all__ = ["Policy", "load", "save"]
