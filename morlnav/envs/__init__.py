"""Environments of other projects, as tasks of ours."""

from morlnav.envs.mo_gymnasium import MOGymnasium

__all__ = ["MOGymnasium"]
