"""Collection by Ray actors."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

from tensordict import TensorDictBase
from torchrl.collectors import distributed


class RayCollector(distributed.RayCollector):
    """TorchRL's ``RayCollector``, for trainers that decide themselves when it is over.

    Weights are synchronised before the first batch, and a dead worker ends the collection with one sentence.

    Args:
        settings: arguments of :class:`torchrl.collectors.distributed.RayCollector`; ``total_frames=-1`` is endless.

    Raises:
        ValueError: if Ray is not installed.
    """

    def __init__(self, *args: Any, total_frames: int = -1, **settings: Any) -> None:
        if find_spec("ray") is None:
            raise ValueError("collector=ray needs Ray: pip install 'morlnav[ray]'.")
        super().__init__(*args, total_frames=sys.maxsize if total_frames < 0 else total_frames, **settings)
        self.update_policy_weights_()

    def iterator(self) -> Iterator[TensorDictBase]:
        """Batches of transitions.

        Raises:
            ChildProcessError: if a worker died.
        """
        try:
            yield from super().iterator()
        except Exception as error:  # Ray's about its actor, or the broken connection that weights went through
            if self.stats()["workers_alive"] == self.num_collectors:
                raise
            message = "A collecting process died; continue from the last checkpoint: resume=RUN_DIR."
            raise ChildProcessError(message) from error
