"""Run directories: what they hold, to whom they belong, and how they are continued."""

from morlnav.runs.config import CONFIG_FILE, load_config
from morlnav.runs.run import Run, make_training

__all__ = ["CONFIG_FILE", "Run", "load_config", "make_training"]
