"""What a loss tells a term, and what it asks of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor, nn


@dataclass
class Judged:
    """Transitions of a batch, and how critics value them.

    Attributes:
        batch: what was sampled, ``[B]``.
        preference: λ, ``[B, n]``.
        weights: ``w(λ)``, ``[B, m]``.
        values: value vectors of ``k`` critics, ``[k, B, m]``; of the one that an actor climbs, ``[B, m]``.
    """

    batch: TensorDictBase
    preference: Tensor
    weights: Tensor
    values: Tensor

    def scalarise(self, values: Tensor) -> Tensor:
        """``wᵀQ`` of value vectors ``[..., B, m]``, ``[..., B]``."""
        return (self.weights * values).sum(-1)

    @property
    def num_static(self) -> int:
        """How many entries stand in front of those that the preference weighs, ``m - n``."""
        return self.weights.shape[-1] - self.preference.shape[-1]


@dataclass
class Acted(Judged):
    """What the actor would do in the states of a batch, and how the critic that it climbs values that.

    Attributes:
        action: ``π(s, λ)``, ``[B, A]``, with a gradient to the actor, as :attr:`values` have one.
        low: least action, ``[A]`` or one number.
        high: largest action.
        value_of: values other actions in the same states: ``[P, B, A]`` to ``[P, B, m]``.
    """

    action: Tensor
    low: Tensor
    high: Tensor
    value_of: Callable[[Tensor], Tensor]

    @property
    def half_range(self) -> Tensor:
        """Half the range of each entry of an action: the unit in which m/s and rad/s count alike."""
        return (self.high - self.low) / 2


class LossTerm(nn.Module):
    """A penalty that a loss adds to its actor's loss, to its critics' loss, or to both; a subclass writes the method.

    The loss reports what it adds under the name that the term has there: ``{name}_actor`` and ``{name}_qvalue``.

    Examples:
        >>> class Effort(LossTerm):
        ...     def actor(self, acted):
        ...         return 0.1 * acted.action.square().sum(-1)
        >>> Effort().adds_to
        ['actor']
    """

    in_keys: Sequence[NestedKey] = ()
    """Entries of the batch that it reads, beyond those of the networks."""

    @property
    def adds_to(self) -> list[str]:
        """Which losses it adds to, out of ``actor`` and ``qvalue``; by default those that its class has methods for."""
        written = {"actor": type(self).actor is not LossTerm.actor, "qvalue": type(self).critic is not LossTerm.critic}
        return [name for name, own in written.items() if own]

    def actor(self, acted: Acted) -> Tensor:
        """Penalty ``[B]`` of the actor's actions."""
        raise NotImplementedError(f"{type(self).__name__} adds nothing to the actor's loss.")

    def critic(self, judged: Judged) -> Tensor:
        """Penalty ``[k, B]`` of the critics' values for the actions that were taken."""
        raise NotImplementedError(f"{type(self).__name__} adds nothing to the critics' loss.")

    def attach(self, scalarisation: nn.Module) -> None:
        """Get to know the weights of the loss that it is a term of."""

    def update(self, preferences: Tensor, values: Tensor) -> None:
        """Take in what the policy was measured to reach: value vectors ``[E, m]`` under preferences ``[E, n]``."""
