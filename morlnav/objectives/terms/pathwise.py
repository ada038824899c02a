"""The gradient of the return through the environment itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDict
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from morlnav.objectives.terms.base import Acted, LossTerm


class PathwiseGradient(LossTerm):
    r"""Policy gradient by derivatives through a differentiable environment, over whole episodes (Mohamed et al., JMLR
    2020, Sec. 5; "analytic" or "pathwise" gradient; Heess et al., NeurIPS 2015, with critics at the horizon only).

    A single action changes the return by less than a critic's error. The environment knows exactly: from replayed
    states the actor drives on as it is, and the derivative of what it earns ::

        J = Σ_{h<H} γ^h·wᵀr_h + γ^H·wᵀ mean_k Q_k(s_H, π(s_H, λ), λ)

    is taken in each of its actions, ``g_h = dJ/da_h``, through all that follows. The actor then climbs
    ``coefficient·mean g_hᵀπ(s_h, λ)`` over the states on the way; with ``horizon`` beyond an episode's end, critics
    have no part in it. The policy still sees observations alone.

    A contact or an arrival is no differentiable event: what the rewards tell of a jump (see
    :class:`~morlnav.navigation.envs.rewards.Collision`) is all that is known of it. Long chains explode where a
    robot's own reactions amplify a push; the gradient of one episode is therefore shortened to ``clip``, as far as the
    actor can follow it: near the bounds of an action, to which it is squashed, it cannot.

    Args:
        coefficient: of the climb, against 1 for the critics' value.
        after: actor updates before it begins; early drivers have little to refine.
        states: how many replayed states are driven on from.
        horizon: steps ``H`` of a drive at most.
        interval: actor updates from one drive to the next; those between climb the same gradient.
        samples: states on the way that one update learns from.
        clip: largest norm of an episode's gradient, in the learner's unit of value per half the range of an action.
        make_env: makes ``make_env(num_envs=...)`` side by side, with ``_supports_set_state`` and a gradient.
        reward_unit: gives rewards ``[..., m]`` the unit that replay gives the learner.

    Raises:
        ValueError: for numbers below what makes sense, or an environment that cannot be set to a state or has no
            gradient.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from morlnav import NavigationEnv
        >>> from morlnav.data import UniformPreferences
        >>> from morlnav.transforms import DrawPreference
        >>> def make_env(num_envs):
        ...     return TransformedEnv(NavigationEnv(num_envs=num_envs), DrawPreference(UniformPreferences(2)))
        >>> PathwiseGradient(states=4, make_env=make_env).in_keys[:2]
        ['pose', ('scene', 'start')]
    """

    def __init__(
        self,
        coefficient: float = 1.0,
        after: int = 0,
        states: int = 64,
        horizon: int = 110,
        interval: int = 8,
        samples: int = 512,
        clip: float = 0.3,
        *,
        make_env: Callable[..., EnvBase],
        reward_unit: Callable[[Tensor], Tensor] = lambda reward: reward,
    ) -> None:
        super().__init__()
        least = {"states": (states, 1), "horizon": (horizon, 1), "interval": (interval, 1), "samples": (samples, 1)}
        for name, (value, low) in (least | {"coefficient": (coefficient, 0), "after": (after, 0)}).items():
            if value < low:
                raise ValueError(f"{name} must be at least {low}, got {value}.")
        if not clip > 0:
            raise ValueError(f"clip must be positive, got {clip}.")
        self.coefficient, self.after, self.clip = coefficient, after, clip
        self.states, self.horizon, self.interval, self.samples = states, horizon, interval, samples
        self.reward_unit = reward_unit
        env = make_env(num_envs=states)
        _check(env)
        self._env = (env,)  # its transforms are no parts of the loss
        observed, size = env.observation_spec, env.action_spec.shape[-1]
        self._state_keys = list(env.state_spec.keys(True, True))
        # What was found, so that a resumed run goes on with it.
        self.register_buffer("calls", torch.zeros((), dtype=torch.int64))
        self.register_buffer("observation", torch.zeros(horizon, states, observed["observation"].shape[-1]))
        self.register_buffer("preference", torch.zeros(horizon, states, observed["preference"].shape[-1]))
        self.register_buffer("gradient", torch.zeros(horizon, states, size))
        self.register_buffer("driven", torch.zeros(horizon, states, dtype=torch.bool))

    @property
    def in_keys(self) -> Sequence[NestedKey]:
        """The environment's state."""
        return self._state_keys

    def actor(self, acted: Acted) -> Tensor:
        """The mean of what is to be climbed, negative, ``[B]``, the same for every sample."""
        self.calls += 1
        if (since := int(self.calls) - 1 - self.after) < 0:
            return acted.action.new_zeros(acted.action.shape[:-1])
        if since % self.interval == 0:
            self._drive(acted)
        rows = self.driven.flatten().float().multinomial(self.samples, replacement=True)
        observation, preference, gradient = (
            found.flatten(0, 1)[rows] for found in (self.observation, self.preference, self.gradient)
        )
        action = acted.policy(TensorDict(observation=observation, preference=preference, batch_size=[self.samples]))
        climbed = (gradient * action / acted.half_range).sum(-1)
        return (-self.coefficient * climbed.mean()).expand(acted.action.shape[:-1])

    @torch.compiler.disable  # an environment is no graph
    @torch.enable_grad()
    def _drive(self, acted: Acted) -> None:
        """Drive on from some states of the batch, and differentiate what that earns."""
        batch, weights = acted.batch.reshape(-1), acted.weights.flatten(0, -2)
        rows = torch.arange(self.states, device=weights.device) % len(batch)
        begin, weights, gamma = batch[rows], weights[rows], torch.as_tensor(acted.gamma)
        env, half = self._env[0], acted.half_range
        now = env.reset(begin.select("preference", *self._state_keys), set_state=True)
        push = torch.zeros_like(self.gradient, requires_grad=True)  # nothing, but for its derivative
        reach, alive, gained, discount = [], now["terminated"].logical_not(), 0.0, 1.0
        self.driven.zero_()
        for step in range(self.horizon):
            action = (acted.policy(now) + push[step]).clamp(acted.low, acted.high)
            if not action.isfinite().all():  # learning has diverged, which is told elsewhere
                self.gradient.zero_()
                self.driven.fill_(True)
                return
            self.observation[step], self.driven[step] = now["observation"].detach(), alive.squeeze(-1)
            reach.append(1 - ((action.detach() - acted.low) / half - 1).square())  # of what is squashed to the bounds
            now = env.step(now.set("action", action))
            gained = gained + discount * alive * self.reward_unit(now["next", "reward"])
            discount = discount * gamma
            alive = alive & ~now["next", "terminated"]
            now = step_mdp(now)
            if not alive.any():
                break
        now.set("action", acted.policy(now))
        gained = gained + discount * alive * acted.values_of(now).mean(0)
        (gradient,) = torch.autograd.grad((weights * gained).sum(), push)
        gradient = gradient.nan_to_num_(0.0, 0.0, 0.0)[: len(reach)] * half
        norm = (gradient * torch.stack(reach)).square().sum((0, -1), keepdim=True).sqrt()
        self.gradient[: len(reach)] = gradient * (self.clip / norm.clamp_min(self.clip))
        self.preference.copy_(begin["preference"])


def _check(env: EnvBase) -> None:
    """Refuse an environment that cannot be set to a state, or through which no derivative leads."""
    leave = "leave it out (loss.terms.pathwise=null)."
    name = type(getattr(env, "base_env", env)).__name__
    if not env._supports_set_state:
        raise ValueError(f"{name} cannot be set to a state (TorchRL's set_state), which a gradient needs; {leave}")
    begin = env.reset()
    with torch.enable_grad():
        push = torch.zeros_like(env.action_spec.zero(), requires_grad=True)
        seen = env.step(begin.set("action", env.action_spec.rand() + push))["next", "observation"]
    if not seen.requires_grad:
        raise ValueError(f"{name} has no gradient in the action, which this term climbs; {leave}")
