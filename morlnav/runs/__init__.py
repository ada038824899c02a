"""Run directories: what they hold, to whom they belong, and how they are continued."""

from morlnav.runs.run import CONFIG_FILE, Run, load_config, make_training

__all__ = ["CONFIG_FILE", "Run", "load_config", "make_training"]
