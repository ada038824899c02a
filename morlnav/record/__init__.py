"""Logging, tables in a terminal, and figures of fronts."""

from morlnav.record.loggers import TensorboardCSVLogger

__all__ = ["TensorboardCSVLogger"]
