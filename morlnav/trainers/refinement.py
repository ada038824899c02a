"""A last stage of training: the exact gradient of whole episodes, through an environment that is differentiable."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import partial

import torch
from torch import Tensor, nn, optim
from torch.optim.lr_scheduler import LRScheduler
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp
from torchrl.record.loggers import Logger
from tqdm import trange

from morlnav.config import Part, supply
from morlnav.limits import check_at_least, check_positive
from morlnav.trainers.stepper import linear_decay

LEFT = 0.05
"""Share of the episodes of a drive that may be unfinished at its end."""


class PathwiseRefinement:
    r"""Refines a policy by derivatives through a differentiable environment, over whole episodes (Mohamed et al., JMLR
    2020, Sec. 5: the pathwise gradient).

    What a single action changes of the return is less than a critic's error, so that an actor which climbs critics
    stops far from what it could reach. The environment knows exactly: the actor drives episodes, and the derivative of
    what they earn ::

        J = Σ_h γ^h·wᵀr_h,    g_h = dJ/da_h

    is taken in each action, through all that follows: motion, sensors, the actor's own reactions, learned rewards. The
    actor then climbs ``mean g_hᵀπ(s_h, λ)`` over all states on the way. The policy still sees observations alone.

    A contact or an arrival is no differentiable event: what the rewards tell of a jump (see
    :class:`~morlnav.navigation.envs.rewards.Collision`) is all that is known of it. So it leads to the nearest optimum,
    and what comes before it has to find the ways. Long chains explode where a robot's own reactions amplify a push;
    the gradient of one episode is therefore shortened to ``clip``, as far as the actor can follow it: near the bounds
    of an action, to which it is squashed, it cannot. What is no finite number counts nothing.

    Args:
        drives: how often all environments drive an episode, after which the actor learns; 0 leaves the policy as it is.
        num_envs: environments side by side.
        horizon: steps of a drive at most.
        clip: largest norm of an episode's gradient, in the unit of raw rewards per half the range of an action.
        optimizer: of the actor, called with its ``params``.
        schedule: of the learning rate, called with the ``optimizer`` and its ``total_steps``; ``None`` is constant.
        average_decay: of the averaged actor, which is kept, per drive; 0 keeps the actor itself.
        make_env: makes ``make_env(num_envs=...)`` with a gradient.
        scalarisation: maps ``(λ, m)`` to weights.
        seed: of the preferences that are drawn.
        progress_bar: show one.

    Raises:
        ValueError: for numbers below what makes sense, or an environment that has no gradient.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from morlnav import NavigationEnv
        >>> from morlnav.data import UniformPreferences
        >>> from morlnav.modules import Actor
        >>> from morlnav.objectives import LinearScalarisation
        >>> from morlnav.transforms import DrawPreference
        >>> def make_env(num_envs):
        ...     return TransformedEnv(NavigationEnv(num_envs=num_envs, seed=0), DrawPreference(UniformPreferences(2)))
        >>> refinement = PathwiseRefinement(drives=1, num_envs=4, horizon=5, make_env=make_env,
        ...     scalarisation=LinearScalarisation())
        >>> actor = Actor(2, [0.0, -3.14], [0.5, 3.14], features=34)
        >>> bool((refinement(actor).mlp[0].weight != actor.mlp[0].weight).any())
        True
    """

    def __init__(
        self,
        drives: int = 200,
        num_envs: int = 128,
        horizon: int = 120,
        clip: float = 30.0,
        optimizer: Part[optim.Optimizer] = partial(optim.Adam, lr=5e-4, betas=(0.9, 0.99)),  # noqa: B008
        schedule: Part[LRScheduler] | None = linear_decay,
        average_decay: float = 0.95,
        *,
        make_env: Callable[..., EnvBase],
        scalarisation: nn.Module,
        seed: int = 0,
        progress_bar: bool = False,
    ) -> None:
        check_at_least(0, drives=drives)
        check_at_least(1, num_envs=num_envs, horizon=horizon)
        check_positive(clip=clip)
        if not 0 <= average_decay < 1:
            raise ValueError(f"average_decay must be from 0 to below 1, got {average_decay}.")
        self.drives, self.clip, self.average_decay = drives, clip, average_decay
        self.horizon, self.optimizer, self.schedule = horizon, optimizer, schedule
        self.scalarisation, self.seed, self.progress_bar = scalarisation, seed, progress_bar
        if drives:
            self.env = make_env(num_envs=num_envs)
            _check(self.env)
            space = self.env.action_spec_unbatched.space
            self.low, self.high = space.low, space.high

    def __call__(self, policy: nn.Module, gamma: Tensor | float = 1.0, logger: Logger | None = None) -> nn.Module:
        """The refined policy; the one that is given stays as it is.

        Args:
            policy: maps observations ``[..., D]`` and preferences ``[..., n]`` to actions ``[..., A]``.
            gamma: discount, one for all or one per entry of the reward ``[m]``.
            logger: receives ``refinement/return``, the mean of ``wᵀG``, at every drive.

        Raises:
            ValueError: if learning diverges.
        """
        if not self.drives:
            return policy
        torch.manual_seed(self.seed)
        actor = deepcopy(policy).train()
        optimizer, schedule = self.make_optimizer(list(actor.parameters()))
        average = AveragedModel(actor, multi_avg_fn=get_ema_multi_avg_fn(self.average_decay))
        average.update_parameters(actor)
        for drive in trange(self.drives, desc="refinement", disable=not self.progress_bar):
            observation, preference, gradient, running, gained = self._drive(actor, gamma)
            climbed = (gradient * actor(observation, preference)).sum(-1)
            loss = -(climbed * running).sum() / running.sum()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            if schedule is not None:
                schedule.step()
            average.update_parameters(actor)
            if not nn.utils.get_total_norm(actor.parameters()).isfinite():
                raise ValueError(
                    f"Refinement diverged after {drive + 1} drives; lower refinement.optimizer.lr or refinement.clip."
                )
            if logger is not None:
                logger.log_scalar("refinement/return", gained, step=drive + 1)
        return average.module.train(policy.training)

    def make_optimizer(self, params: list[nn.Parameter]) -> tuple[optim.Optimizer, LRScheduler | None]:
        """The optimizer of ``params``, and the schedule of its learning rate."""
        optimizer = supply(self.optimizer, params=params)
        if self.schedule is None:
            return optimizer, None
        return optimizer, supply(self.schedule, optimizer=optimizer, total_steps=max(1, self.drives))

    @torch.enable_grad()
    def _drive(self, actor: nn.Module, gamma: Tensor | float) -> tuple[Tensor, Tensor, Tensor, Tensor, float]:
        """An episode in each environment: states ``[H, B]``, what a push there would gain, and what counts of them."""
        env, half = self.env, (self.high - self.low) / 2
        now = env.reset()
        preference, alive = now["preference"], now["done"].logical_not()
        states, running, pushes, reach, gained, discount = [], [], [], [], 0.0, 1.0
        for _ in range(self.horizon):
            push = torch.zeros_like(env.action_spec.zero(), requires_grad=True)  # nothing, but for its derivative
            action = (actor(now["observation"], preference) + push).clamp(self.low, self.high)
            reach.append(1 - ((action.detach() - self.low) / half - 1).square())  # of what is squashed to the bounds
            states.append(now["observation"].detach())
            running.append(alive.squeeze(-1))
            pushes.append(push)
            now = env.step(now.set("action", action))
            gained = gained + discount * alive * now["next", "reward"]
            discount = discount * gamma
            alive = alive & ~now["next", "done"]
            now = step_mdp(now)
            if alive.float().mean() <= LEFT:
                break
        earned = (self.scalarisation(preference, gained.shape[-1]) * gained).sum(-1)
        gradient = torch.stack(torch.autograd.grad(earned.sum(), pushes)).nan_to_num(0.0, 0.0, 0.0) * half
        norm = (gradient * torch.stack(reach)).square().sum((0, -1), keepdim=True).sqrt()
        gradient = gradient * (self.clip / norm.clamp_min(self.clip)) / half
        seen = torch.stack(states)
        return seen, preference.expand(len(seen), -1, -1), gradient, torch.stack(running), earned.mean().item()


def _check(env: EnvBase) -> None:
    """Refuse an environment through which no derivative leads."""
    begin = env.reset()
    with torch.enable_grad():
        push = torch.zeros_like(env.action_spec.zero(), requires_grad=True)
        seen = env.step(begin.set("action", env.action_spec.rand() + push))["next", "observation"]
    if not seen.requires_grad:
        name = type(getattr(env, "base_env", env)).__name__
        raise ValueError(
            f"{name} has no gradient in the action, which a refinement climbs; leave it out (refinement.drives=0)."
        )
