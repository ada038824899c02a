"""The replay buffer: pickle-free on disk, with its transforms by name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.checkpoint import StateDictCheckpointAdapter
from torchrl.data import TensorDictReplayBuffer, TensorStorage
from torchrl.data.replay_buffers import Sampler, TensorStorageCheckpointer
from torchrl.envs import Compose, Transform


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
            raise ValueError(
                f"it holds {len(rows)} transitions; expected a replay.storage.max_size of at least as many"
            )
        storage.set(slice(0, len(rows)), rows, set_cursor=False)
        storage._len = len(rows)


class ReplayBuffer(TensorDictReplayBuffer):
    """TorchRL's replay buffer with transforms by name; it saves no pickles, and only the rows that it holds.

    Args:
        storage: where rows lie.
        sampler: chooses which are sampled.
        batch_size: rows of a sample.
        transforms: of what is sampled, in their order; ``None`` leaves one out.
        generator: source of the sampler's randomness.

    Examples:
        >>> from torchrl.data import LazyTensorStorage, RandomSampler
        >>> from morlnav.data import UniformPreferences
        >>> from morlnav.transforms import HindsightPreferenceRelabel
        >>> relabel = HindsightPreferenceRelabel(UniformPreferences(2))
        >>> buffer = ReplayBuffer(LazyTensorStorage(100), RandomSampler(), 32, {"relabel": relabel})
    """

    def __init__(
        self,
        storage: TensorStorage,
        sampler: Sampler,
        batch_size: int = 256,
        transforms: Mapping[str, Transform | None] | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        if batch_size < 1 or batch_size > storage.max_size:
            raise ValueError(f"batch_size must be from 1 to the storage's {storage.max_size}, got {batch_size}.")
        if (capacity := getattr(sampler, "_max_capacity", storage.max_size)) < storage.max_size:  # of priorities
            raise ValueError(f"sampler.max_capacity must be at least the storage's {storage.max_size}, got {capacity}.")
        super().__init__(
            storage=storage,
            sampler=sampler,
            batch_size=batch_size,
            transform=Compose(*(transform for transform in (transforms or {}).values() if transform is not None)),
            generator=generator,
            checkpointer=FilledRows(),
        )

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
