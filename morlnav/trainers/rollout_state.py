"""Unfinished episodes in a checkpoint."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv


class RolloutState:
    """Checkpoint component that holds a collector's unfinished episodes, so that a resumed run equals an unbroken one.

    TorchRL's collector starts new episodes after loading, because environments cannot be saved in general. One that
    can has ``get_state()`` and ``set_state(state)``, as :class:`~morlnav.navigation.envs.NavigationEnv` does.

    Args:
        collector: a single-process collector of such an environment.
    """

    def __init__(self, collector: Collector) -> None:
        self.collector = collector

    @staticmethod
    def can_hold(env: TransformedEnv) -> bool:
        """Whether an environment can be saved; after the others, a resumed run begins new episodes.

        >>> from torchrl.envs import PendulumEnv
        >>> RolloutState.can_hold(TransformedEnv(PendulumEnv()))
        False
        """
        return all(callable(getattr(env.base_env, name, None)) for name in ("get_state", "set_state"))

    def state_dict(self) -> dict[str, Any]:
        """The environment's state, and the tensordict that the next step starts from."""
        return {"env": self.collector.env.base_env.get_state(), "carrier": self.collector._carrier.clone().to_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Put the episodes back where they were."""
        self.collector.env.base_env.set_state(state["env"])
        carrier = self.collector._carrier
        carrier.update(TensorDict(state["carrier"], batch_size=carrier.batch_size))
