"""What a checkpoint holds so that a run continues bit for bit: of the replay buffer, and of unfinished episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tensordict import TensorDict
from torchrl.checkpoint import StateDictCheckpointAdapter
from torchrl.collectors import Collector
from torchrl.data import TensorDictReplayBuffer, TensorStorage
from torchrl.data.replay_buffers import TensorStorageCheckpointer


class FilledRows(TensorStorageCheckpointer):
    """Write the rows that a storage holds, where TorchRL writes its whole capacity.

    Examples:
        >>> import tempfile
        >>> from torchrl.data import LazyTensorStorage
        >>> written, read = LazyTensorStorage(1000), LazyTensorStorage(1000)
        >>> written.checkpointer = read.checkpointer = FilledRows()
        >>> written.set(range(3), TensorDict(reward=[1.0, 2.0, 3.0], batch_size=3))
        >>> folder = Path(tempfile.mkdtemp())
        >>> written.dumps(folder)
        >>> (folder / "reward.memmap").stat().st_size  # bytes
        12
        >>> read.loads(folder)
        >>> read[:]["reward"]
        tensor([1., 2., 3.])
    """

    def dumps(self, storage: TensorStorage, path: str | Path) -> None:
        """Write the rows ``[0, len(storage))``."""
        storage[:].memmap(path, copy_existing=True)

    def loads(self, storage: TensorStorage, path: str | Path) -> None:
        """Put the rows back where they were.

        Raises:
            ValueError: if there are more of them than the storage can hold.
        """
        rows = TensorDict.load_memmap(path)
        if len(rows) > storage.max_size:
            raise ValueError(f"it holds {len(rows)} transitions; expected a replay.capacity of at least as many")
        storage.set(slice(0, len(rows)), rows, set_cursor=False)
        storage._len = len(rows)


class PickleFreeReplayBuffer(TensorDictReplayBuffer):
    """A replay buffer that saves no pickles: no prefetched batches, and no ``torch.save`` of its transforms.

    Arguments as for :class:`torchrl.data.TensorDictReplayBuffer`.
    """

    def dumps(self, path: str | Path) -> None:
        """Write rows, counters, random state and transforms into a folder."""
        super().dumps(path)
        (Path(path) / "transform.t").unlink(missing_ok=True)
        StateDictCheckpointAdapter().save(self.transform, Path(path) / "transform", args=(), kwargs={})

    def loads(self, path: str | Path) -> None:
        """Continue where :meth:`dumps` left off."""
        super().loads(path)
        StateDictCheckpointAdapter().load(
            self.transform, Path(path) / "transform", map_location="cpu", tensor_load_kwargs={}, args=(), kwargs={}
        )

    def _dump_prefetch_state(self, path: Path, prefetch_state: dict[str, Any]) -> None:
        pass

    def _load_prefetch_state(self, path: Path) -> None:
        pass


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
