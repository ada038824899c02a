"""Unfinished episodes in a checkpoint."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDict
from torchrl.collectors import Collector


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
