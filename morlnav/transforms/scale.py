"""The learner's unit of reward."""

from __future__ import annotations

from torchrl.envs import RewardScaling

from morlnav.limits import check_positive


class ScaleReward(RewardScaling):
    """Replay-buffer transform: TorchRL's ``RewardScaling`` of stored transitions, so that logs and files stay raw.

    Args:
        scale: factor of every entry of the reward.

    Raises:
        ValueError: unless it is positive.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> batch = TensorDict(next=TensorDict(reward=torch.tensor([[-10.0, 5.0]]), batch_size=[1]), batch_size=[1])
        >>> ScaleReward(0.01)(batch)["next", "reward"]
        tensor([[-0.1000,  0.0500]])
    """

    def __init__(self, scale: float = 0.01) -> None:
        check_positive(scale=scale)
        super().__init__(loc=0.0, scale=scale, in_keys=[("next", "reward")])
