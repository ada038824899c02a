"""A learning that diverged ends before anything of it is kept."""

from __future__ import annotations

from torch.nn.utils import get_total_norm
from torchrl.trainers.trainers import Trainer, TrainerHookBase

NETWORKS = {
    "actor_network_params": ("the actor's", "stepper.optimizer_actor.lr"),
    "qvalue_network_params": ("the critics'", "stepper.optimizer_critic.lr"),
}
"""What the parameters of a loss are called, and where the config has their learning rate."""


class StopDivergence(TrainerHookBase):
    """End the training once a weight that the loss learns is not finite: it is never evaluated or checkpointed.

    Register it before every other hook that acts on the learned weights; checkpoints come after all hooks.

    Examples:
        >>> StopDivergence().register(trainer)  # doctest: +SKIP
    """

    def __init__(self) -> None:
        self.trainer: Trainer | None = None

    def __call__(self) -> None:
        """Look at all weights at once.

        Raises:
            ValueError: naming the networks, the learning rates to lower, and the checkpoint that is left.
        """
        loss = self.trainer.loss_module
        if get_total_norm(loss.parameters()).isfinite():  # ten times as fast as to look at every weight
            return
        ruined = dict.fromkeys(
            name.split(".")[0] for name, value in loss.named_parameters() if not value.isfinite().all()
        )
        if not ruined:
            return
        names, rates = zip(*(NETWORKS.get(name, (f"{name}'s", "the learning rate")) for name in ruined), strict=True)
        raise ValueError(
            f"Learning diverged: {' and '.join(names)} weights are not finite after {self.trainer.collected_frames:,} "
            f"frames; lower {' and '.join(dict.fromkeys(rates))}, or the scale of the rewards{self._left()}."
        )

    def _left(self) -> str:
        rotation = self.trainer.checkpoint_rotation
        checkpoint = None if rotation is None else rotation.latest()
        return "" if checkpoint is None else f" (the last checkpoint, {checkpoint}, is intact)"

    def register(self, trainer: Trainer, name: str = "stop_divergence") -> None:
        """Register after every round of optimisation steps."""
        self.trainer = trainer
        trainer.register_op("post_steps", self)
