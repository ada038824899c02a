"""A pull of the actor toward actions that roll-outs in the environment itself found to be better."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDict
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from morlnav.objectives.terms.base import Acted, LossTerm


class RolloutSearch(LossTerm):
    """Policy improvement by roll-outs (Bertsekas, 2020, Sec. 2.4) in an environment that can be set to a state.

    A single action changes the return by less than a critic's error; an action that is *held* does not. In some of the
    replayed states, copies of the actor drive on in the environment: one as it is, the others with an offset that each
    holds for some steps before it drives as the actor does. What they earn in ``horizon`` steps is known, and the
    critics judge where that ends::

        G = Σ_{h<H} γ^h·r_h + γ^H·mean_k Q_k(s_H, π(s_H, λ), λ)

    Where the best copy's ``wᵀG`` exceeds the actor's own by more than ``margin``, the actor is drawn to that copy's
    first action: ``coefficient·mean ‖(π - a) / h‖²`` over the states, ``h`` half the range of an action. Nothing
    is learned by these roll-outs but where to go; the policy still sees observations alone.

    Args:
        coefficient: of the pull.
        margin: in the learner's unit of value.
        states: how many states copies are made in.
        copies: of the actor in each of them, one of which drives as it is.
        horizon: steps ``H`` of a roll-out.
        hold: the most steps that an offset is held; each copy draws from 1 up to it.
        spread: largest standard deviation of an offset, in units of half the action range ...
        octaves: ... which is divided by up to two to this power, evenly in the exponent: small offsets refine.
        interval: actor updates from one search to the next; those between learn from the same answers.
        make_env: makes ``make_env(num_envs=...)`` side by side, with ``_supports_set_state``.
        reward_unit: gives rewards ``[..., m]`` the unit that replay gives the learner.

    Raises:
        ValueError: for numbers below what makes sense, or an environment that cannot be set to a state.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from morlnav import NavigationEnv
        >>> from morlnav.data import UniformPreferences
        >>> from morlnav.transforms import DrawPreference
        >>> def make_env(num_envs):
        ...     return TransformedEnv(NavigationEnv(num_envs=num_envs), DrawPreference(UniformPreferences(2)))
        >>> RolloutSearch(states=4, copies=2, make_env=make_env).in_keys[:2]
        ['pose', ('scene', 'start')]
    """

    def __init__(
        self,
        coefficient: float = 1.0,
        margin: float = 0.002,
        states: int = 96,
        copies: int = 8,
        horizon: int = 25,
        hold: int = 15,
        spread: float = 0.25,
        octaves: float = 4.0,
        interval: int = 8,
        *,
        make_env: Callable[..., EnvBase],
        reward_unit: Callable[[Tensor], Tensor] = lambda reward: reward,
    ) -> None:
        super().__init__()
        least = {"states": (states, 1), "copies": (copies, 2), "horizon": (horizon, 1), "hold": (hold, 1)}
        least |= {"interval": (interval, 1), "coefficient": (coefficient, 0), "spread": (spread, 0)}
        for name, (value, low) in (least | {"octaves": (octaves, 0)}).items():
            if value < low:
                raise ValueError(f"{name} must be at least {low}, got {value}.")
        self.coefficient, self.margin = coefficient, margin
        self.states, self.copies, self.horizon, self.hold = states, copies, horizon, hold
        self.spread, self.octaves, self.interval = spread, octaves, interval
        self.reward_unit = reward_unit
        if not (env := make_env(num_envs=1))._supports_set_state:
            name = type(getattr(env, "base_env", env)).__name__
            raise ValueError(
                f"{name} cannot be set to a state (TorchRL's set_state), which a search by roll-outs needs; leave it "
                "out (loss.terms.rollouts=null)."
            )
        env = make_env(num_envs=states * copies)
        self._env = (env,)  # its transforms are no parts of the loss
        observed, size = env.observation_spec, env.action_spec.shape[-1]
        self._state_keys = list(env.state_spec.keys(True, True))
        # What was found, so that a resumed run goes on with it.
        self.register_buffer("calls", torch.zeros((), dtype=torch.int64))
        self.register_buffer("observation", torch.zeros(states, observed["observation"].shape[-1]))
        self.register_buffer("preference", torch.zeros(states, observed["preference"].shape[-1]))
        self.register_buffer("found", torch.zeros(states, size))
        self.register_buffer("better", torch.zeros(states))

    @property
    def in_keys(self) -> Sequence[NestedKey]:
        """The environment's state."""
        return self._state_keys

    def actor(self, acted: Acted) -> Tensor:
        """The mean pull ``[B]``, the same for every sample."""
        if self.calls % self.interval == 0:
            self._search(acted)
        self.calls += 1
        asked = TensorDict(observation=self.observation, preference=self.preference, batch_size=[self.states])
        distance = ((acted.policy(asked) - self.found) / acted.half_range).square().sum(-1)
        return (self.coefficient * self.better * distance).mean().expand(len(acted.action))

    @torch.compiler.disable  # an environment is no graph
    @torch.no_grad()
    def _search(self, acted: Acted) -> None:
        """Look for better actions in some states of the batch."""
        rows = torch.arange(self.states, device=acted.action.device) % len(acted.action)
        begin, weights, gamma = acted.batch[rows], acted.weights[rows], torch.as_tensor(acted.gamma)
        shape = self.copies, self.states
        offset, hold = self._offsets(acted.half_range)
        env = self._env[0]
        now = begin.select("preference", *self._state_keys).expand(shape).reshape(-1)
        now = env.reset(now, set_state=True)
        first, alive, gained, discount = None, now["terminated"].logical_not(), 0.0, 1.0
        for step in range(self.horizon):
            action = acted.policy(now)
            action = torch.where(step < hold, action + offset, action).clamp(acted.low, acted.high)
            first = action if first is None else first
            now = env.step(now.set("action", action))
            gained = gained + discount * alive * self.reward_unit(now["next", "reward"])
            discount = discount * gamma
            alive = alive & ~now["next", "terminated"]
            now = step_mdp(now)
        now.set("action", acted.policy(now))
        gained = gained + discount * alive * acted.values_of(now).mean(0)
        self.worth = (weights * gained.view(*shape, -1)).sum(-1)
        gain, best = (self.worth - self.worth[0]).max(0)
        self.observation.copy_(begin["observation"])
        self.preference.copy_(begin["preference"])
        self.found.copy_(first.view(*shape, -1).take_along_dim(best[None, :, None], 0).squeeze(0))
        self.better.copy_(gain > self.margin)

    def _offsets(self, half_range: Tensor) -> tuple[Tensor, Tensor]:
        """What copies add to their action ``[copies·states, A]``, and for how many steps ``[copies·states, 1]``."""
        device = self.found.device
        shape = self.copies, self.states
        size = self.spread / 2 ** (self.octaves * torch.rand(*shape, 1, device=device))
        offset = size * torch.randn(*shape, self.found.shape[-1], device=device) * half_range
        offset[0] = 0
        hold = torch.randint(1, self.hold + 1, (*shape, 1), device=device)
        return offset.flatten(0, 1), hold.flatten(0, 1)
