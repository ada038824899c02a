"""Draws a preference λ at reset and carries it through the episode."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Bounded, Composite
from torchrl.envs.transforms import TensorDictPrimer

from morlnav.data.preferences import PreferenceSampler


class DrawPreference(TensorDictPrimer):
    """Environment transform: each reset draws λ, each step carries it on (Sec. IV-A).

    * A reset without a preference draws one, a partial reset only for the environments that it resets.
    * A preference handed to a full ``reset`` is kept: ``env.reset(TensorDict(preference=...))``. One that is found in a
      partial reset (``"_reset"`` in the tensordict) belongs to the episode that ended, so a new one is drawn, as is at
      every automatic reset.
    * A preference set between two steps holds from there on.

    Draws come from torch's global random state. Worker processes start from equal states, so call ``env.set_seed`` on a
    ``ParallelEnv``, which gives every worker its own.

    Args:
        sampler: draws ``[*batch_size, n]`` for the environment's batch size.
        preference_key: entry that holds λ, ``[*batch_size, n]`` in [0, 1].

    Examples:
        >>> from torchrl.envs import PendulumEnv, TransformedEnv
        >>> from morlnav.data.preferences import UniformPreferences
        >>> env = TransformedEnv(PendulumEnv(), DrawPreference(UniformPreferences(3)))
        >>> rollout = env.rollout(4)
        >>> rollout["preference"].shape
        torch.Size([4, 3])
        >>> bool((rollout["preference"] == rollout["next", "preference"]).all())
        True
    """

    def __init__(self, sampler: PreferenceSampler, preference_key: NestedKey = "preference") -> None:
        spec = Composite()
        spec[preference_key] = Bounded(0, 1, shape=(sampler.num_objectives,))
        super().__init__(spec, expand_specs=True)
        self.sampler = sampler
        self.preference_key = preference_key

    # The primer gives the specs. It overwrites a preference given to reset, and prefers a stale ("next", preference)
    # to one set between two steps; hence our own reset and step.
    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        given = tensordict.get(self.preference_key, None)
        if given is None or tensordict.get(self.reset_key, None) is not None:
            return self.forward(tensordict_reset)
        return tensordict_reset.set(self.preference_key, given)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.preference_key, tensordict.get(self.preference_key))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draws a preference for every element of ``tensordict``, outside of an environment too."""
        return tensordict.set(self.preference_key, self.sampler(*tensordict.batch_size, device=tensordict.device))

    def __repr__(self) -> str:
        return f"{type(self).__name__}(sampler={self.sampler}, preference_key={self.preference_key!r})"
