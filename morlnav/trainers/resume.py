"""Checkpoints that continue bit for bit, and that run no code when they are loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.data import TensorDictReplayBuffer
from torchrl.trainers.trainers import Trainer


class PickleFreeReplayBuffer(TensorDictReplayBuffer):
    """A replay buffer that saves no pickles: no prefetched batches, and tensors only in its storage.

    Arguments as for :class:`torchrl.data.TensorDictReplayBuffer`.
    """

    def _dump_prefetch_state(self, path: Path, prefetch_state: dict[str, Any]) -> None:
        pass

    def _load_prefetch_state(self, path: Path) -> None:
        pass


def load_checkpoint(trainer: Trainer, path: str | Path) -> None:
    """Put a trainer where a checkpoint left off.

    Raises:
        ValueError: if the checkpoint holds a pickle, which TorchRL or tensordict might run.
    """
    if pickled := next((file for file in Path(path).rglob("*") if file.suffix in (".pickle", ".pkl")), None):
        raise ValueError(f"{pickled} is a pickle, which no checkpoint of morlnav holds; nothing was loaded.")
    trainer.load_from_file(path)


class RolloutState:
    """Checkpoint component that holds a collector's unfinished episodes, so that a resumed run equals an unbroken one.

    TorchRL's collector starts new episodes after loading, because environments cannot be saved in general; ours can.

    Args:
        collector: a single-process collector of a :class:`~morlnav.navigation.envs.NavigationEnv`.
    """

    def __init__(self, collector: Collector) -> None:
        self.collector = collector

    def state_dict(self) -> dict[str, Any]:
        """Poses, scenes, the scene generator, and the tensordict that the next step starts from."""
        return {"env": self.collector.env.base_env.get_state(), "carrier": self.collector._carrier.clone().to_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Put the robots back where they were."""
        self.collector.env.base_env.set_state(state["env"])
        carrier = self.collector._carrier
        carrier.update(TensorDict(state["carrier"], batch_size=carrier.batch_size))
