"""TensorBoard and CSV side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torchrl.record.loggers import CSVLogger, Logger
from torchrl.record.loggers.tensorboard import TensorboardLogger


class TensorboardCSVLogger(Logger):
    """Write every scalar to TensorBoard events and to ``scalars/<name>.csv`` (headerless ``step,value``).

    Args:
        exp_name: name of the folder inside ``log_dir``.
        log_dir: where the folder goes.

    Examples:
        >>> import tempfile
        >>> logger = TensorboardCSVLogger("logs", tempfile.mkdtemp())
        >>> logger.log_scalar("train/success", 1.0, step=10)
    """

    def __init__(self, exp_name: str, log_dir: str | Path) -> None:
        super().__init__(exp_name, str(log_dir))

    def _create_experiment(self) -> tuple[Logger, ...]:
        return CSVLogger(self.exp_name, self.log_dir), TensorboardLogger(self.exp_name, self.log_dir)

    def log_scalar(self, name: str, value: float, step: int | None = None) -> None:
        """Write one value."""
        for logger in self.experiment:
            logger.log_scalar(name, value, step=step)

    def log_video(self, name: str, video: Any, step: int | None = None, **kwargs: Any) -> None:
        """Write a video."""
        for logger in self.experiment:
            logger.log_video(name, video, step=step, **kwargs)

    def log_hparams(self, cfg: Any) -> None:
        """Write the configuration."""
        for logger in self.experiment:
            logger.log_hparams(cfg)

    def log_histogram(self, name: str, data: Any, **kwargs: Any) -> None:
        """Write a histogram, where the logger can."""
        self.experiment[1].log_histogram(name, data, **kwargs)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(exp_name={self.exp_name!r}, log_dir={self.log_dir!r})"
