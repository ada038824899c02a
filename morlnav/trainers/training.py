"""A training: parts that a config names, wired to TorchRL's ``Trainer``.

The environment pays a vector of rewards and draws λ at each reset; the actor drives; replay stores each transition once
and gives it a fresh λ whenever it is sampled; critics learn the vector of values, and the actor climbs ``wᵀQ``. Hooks
raise the discount, measure the interpolator's keys, evaluate, and log.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import BaseCollector, Collector
from torchrl.data import ReplayBuffer
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv
from torchrl.record.loggers import Logger
from torchrl.trainers.trainers import ReplayBufferTrainer, SelectKeys, Trainer, TrainerHookBase

from morlnav.config import Part, as_part, build, check, setting, supply, takes
from morlnav.data import FixedPreferences, PreferenceSampler
from morlnav.evaluation import Evaluation, eval_env
from morlnav.limits import check_at_least
from morlnav.objectives import MORLTD3Loss
from morlnav.sentences import first_line
from morlnav.trainers.collectors import RolloutState, make_collector, num_workers, share_of
from morlnav.trainers.divergence import StopDivergence
from morlnav.trainers.drex import DREX, LearnedReward
from morlnav.trainers.haste import hasten, product_dtype
from morlnav.trainers.hooks import StepExploration
from morlnav.trainers.live import live_objects, side_by_side
from morlnav.trainers.refinement import PathwiseRefinement
from morlnav.trainers.stepper import MORLTD3Stepper


class Training:
    """All that a run of MORL-TD3 is made of; :meth:`make_trainer` wires it.

    A :class:`~morlnav.config.Part` may be a node of a config with a ``_target_``, or any callable that makes the part.
    It is handed the live objects that it names as arguments (``docs/extending.md`` lists them).

    Args:
        env: the environment, whose reward is a vector.
        transforms: of the environment, by name; ``None`` leaves one out.
        preferences: draws λ, in the environment and in replay.
        actor: the policy ``π(s, λ)``.
        critic: a vector critic ``Q(s, a, λ)``, made once for each of the loss's critics.
        loss: both losses, with their terms.
        stepper: optimizers, schedules, targets and the averaged actor.
        exploration: noise on the actions that are collected.
        replay: the buffer, with its transforms.
        collector: drives the environments.
        trainer: TorchRL's ``Trainer``, and how long it trains.
        refinement: a last stage, on the averaged actor; ``None`` leaves it out.
        evaluation: measures the policy, while it learns and in the end.
        hooks: of the trainer, by name; ``None`` leaves one out.
        rewards: learns rewards from demonstrations first; ``None`` learns none.
        logger: where scalars go.
        seed: of everything that is drawn.
        device: where networks, replay and environments are.
        products: type in which hidden layers multiply while learning; ``auto`` is bfloat16 where it is fast.
        compile: arguments of ``torch.compile`` for both losses; ``None`` is eager.
        cache: folder of what is learned from demonstrations, by its config; ``None`` keeps nothing.

    Raises:
        ValueError: for a seed or a device that cannot be.
    """

    def __init__(
        self,
        env: Part[EnvBase],
        *,
        transforms: Mapping[str, Part[Transform] | None],
        preferences: Part[PreferenceSampler],
        actor: Part[nn.Module],
        critic: Part[nn.Module],
        loss: Part[MORLTD3Loss],
        stepper: Part[MORLTD3Stepper],
        exploration: Part[nn.Module],
        replay: Part[ReplayBuffer],
        collector: Part[BaseCollector],
        trainer: Part[Trainer],
        evaluation: Part[Evaluation],
        hooks: Mapping[str, Part[TrainerHookBase] | None] | None = None,
        refinement: Part[PathwiseRefinement] | None = None,
        rewards: Part[DREX] | None = None,
        logger: Part[Logger] | None = None,
        seed: int = 0,
        device: str = "cpu",
        products: Literal["auto", "float32", "bfloat16"] = "auto",
        compile: Mapping[str, Any] | None = None,
        cache: str | None = None,
    ) -> None:
        for name, value in dict(locals()).items():
            if name != "self":
                setattr(self, name, as_part(value, name))
        self.transforms = {name: part for name, part in self.transforms.items() if part is not None}
        self.hooks = {name: part for name, part in (self.hooks or {}).items() if part is not None}
        if compile is not None:
            check({"_target_": "torch.compile", **compile}, "compile", ("model",))
        if not 0 <= seed < 2**31:
            raise ValueError(f"seed must be a whole number from 0 to 2**31 - 1, got {seed}.")
        if device.startswith("meta"):
            raise ValueError(f"device={device} holds no numbers; name one that computes, such as cpu or cuda.")
        try:
            torch.empty(0, device=device)
        except (RuntimeError, AssertionError) as error:  # PyTorch raises the latter where it was built without CUDA
            raise ValueError(f"device={device} cannot be used on this machine: {first_line(error)}") from error

    # Environments

    def base_env(self, num_envs: int | None = None, seed: int | None = None) -> EnvBase:
        """The environment without transforms; ``num_envs`` of it side by side, by default as many as its node says."""
        seed, make = self.seed if seed is None else seed, self.env
        several = num_envs is not None and "num_envs" in takes(make)
        if several:
            make = make.replace(num_envs=num_envs) if isinstance(make, Part) else partial(make, num_envs=num_envs)
        if several or num_envs in (None, 1):
            env = supply(make, seed=seed)
        else:
            env = side_by_side(lambda: supply(make, seed=seed), num_envs)
        if "seed" not in takes(make):
            env.set_seed(seed)
        return env.to(self.device)

    def make_env(
        self, rewards: Mapping[str, Transform], num_envs: int | None = None, seed: int | None = None, first: int = 0
    ) -> TransformedEnv:
        """An environment to learn in; after :func:`~morlnav.evaluation.eval_env` one to measure in.

        Args:
            rewards: learned ones, by the name of their objective.
            num_envs: environments side by side, by default as many as the environment's node says.
            seed: of the environment.
            first: number of its first environment among those of all workers.
        """
        learned = Compose(*map(copy.deepcopy, rewards.values()))
        env = TransformedEnv(self.base_env(num_envs, seed), learned, auto_unwrap=True)  # it may bring transforms along
        live = self._live(env, offset=first)
        for part in self.transforms.values():
            env.append_transform(supply(part, **live))
        if "preference" not in env.observation_spec.keys(True):
            raise ValueError("transforms must draw a preference, as morlnav.transforms.DrawPreference does.")
        return env.to(self.device)

    def unpaid_env(self) -> TransformedEnv:
        """One environment to measure in before rewards are learned; its λ weighs nothing."""
        brief = copy.copy(self)
        brief.preferences = lambda: FixedPreferences([1.0])  # of other objectives than the config's own has entries for
        return eval_env(brief.make_env({}, num_envs=1))

    # Learning from demonstrations

    def learn_rewards(self, directory: Path | None = None, logger: Logger | None = None) -> dict[str, LearnedReward]:
        """Learn what is to be learned from demonstrations, by the name of the objective; see :class:`DREX`."""
        return {} if self.rewards is None else self.pipeline().learn(directory, logger)

    def restore_rewards(self, directory: Path) -> dict[str, LearnedReward]:
        """The rewards that a run directory holds."""
        return {} if self.rewards is None else self.pipeline().restore(directory)

    def pipeline(self) -> DREX:
        """What learns rewards from demonstrations."""
        on_cpu = copy.copy(self)
        on_cpu.device = "cpu"  # its networks are small
        live = live_objects(on_cpu.unpaid_env()) | {"seed": self.seed}
        live["make_env"] = lambda **settings: eval_env(on_cpu.base_env(**settings))
        live |= {"cache": self.cache, "progress_bar": setting(self.trainer, "progress_bar")}
        if isinstance(self.env, Part) and isinstance(self.rewards, Part):  # what is paid, and to how many, is no matter
            unrelated = ("objectives", "num_envs", "inflation")
            env = {name: value for name, value in self.env.node.items() if name not in unrelated}
            live["config"] = {"env": env | {"max_steps": live.get("max_steps")}, "rewards": self.rewards.node}
        return supply(self.rewards, **live)

    # The trainer

    def make_trainer(
        self, directory: Path, learned: Mapping[str, LearnedReward] | None = None, logger: Logger | None = None
    ) -> Trainer:
        """Everything wired to TorchRL's trainer.

        Args:
            directory: receives checkpoints.
            learned: what :meth:`learn_rewards` returned.
            logger: receives scalars.

        Raises:
            ValueError: if the parts do not fit.
            ChildProcessError: if a worker process dies at its start.
        """
        torch.manual_seed(self.seed)
        learned = learned or {}
        rewards = {name: reward.transform for name, reward in learned.items()}
        make_env = partial(self.make_env, rewards)
        env = make_env()
        live = self._live(env) | {"make_env": make_env}
        actor = supply(self.actor, **live).to(env.device)
        critics = [supply(self.critic, **live).to(env.device) for _ in range(setting(self.loss, "num_qvalue_nets"))]
        policy = TensorDictModule(actor, ["observation", "preference"], ["action"])
        replay = self._make_replay(live)
        loss = self._make_loss(live, policy, critics, {name: reward.clone for name, reward in learned.items()})
        batches = max(1, math.ceil(setting(self.trainer, "total_frames") / self._frames_per_batch(env)))
        noise = self._make_exploration(live, batches).to(env.device)
        updates = max(1, batches * setting(self.trainer, "optim_steps_per_batch"))
        stepper = supply(self.stepper, **live, loss=loss, actor=actor, total_updates=updates)
        collector = make_collector(  # last, for an error after it would leave its workers behind
            self.collector, make_env, TensorDictSequential(policy, noise), env=env, seed=self.seed, device=self.device
        )
        components = {"average": stepper.average}
        if not num_workers(self.collector) and RolloutState.can_hold(env):
            components["rollout"] = RolloutState(collector)
        trainer = supply(
            self.trainer,
            collector=collector,
            loss_module=loss,
            optimization_stepper=stepper,
            replay_buffer=replay,
            logger=logger,
            directory=directory,
            components=components,
        )
        live |= {"policy": stepper.average.module, "loss": loss, "exploration": noise, "trainer": trainer}
        live |= {"total_frames": trainer.total_frames, "evaluation": self.make_evaluation(learned), "learned": learned}
        StopDivergence().register(trainer)  # before all that looks at what was learned
        for name, part in self.hooks.items():
            supply(part, **live).register(trainer, name)
        SelectKeys(loss.in_keys).register(trainer)
        ReplayBufferTrainer(replay, flatten_tensordicts=True).register(trainer)
        StepExploration(noise).register(trainer)
        return trainer

    def rehearse(self, directory: Path) -> None:
        """Build every part but the logger, with rewards of nothing in place of learned ones; judge and store one batch.

        Args:
            directory: where a part may write that writes at once.

        Raises:
            ValueError: for whatever a constructor refuses, for networks that do not fit, and for a replay that needs
                more memory than there is.
        """
        state = torch.get_rng_state()
        learned = {} if self.rewards is None else self.pipeline().untrained()
        brief = copy.copy(self)
        if num_workers(self.collector):  # workers cost seconds
            share_of(num_workers(self.collector), self.base_env().batch_size.numel())
            frames = setting(self.collector, "frames_per_batch")
            brief.collector = partial(Collector, backend="direct", frames_per_batch=frames)
        if (refinement := self.make_refinement(learned)) is not None:  # what learns last of all
            refinement.make_optimizer([nn.Parameter(torch.zeros(1))])
        trainer = brief.make_trainer(directory, learned)
        loss, batch = trainer.loss_module, next(iter(trainer.collector)).flatten()
        try:
            for method in (type(loss).value_loss, type(loss).actor_loss):  # not compiled, which would take a minute
                method(loss, batch)
        except (ValueError, TypeError, RuntimeError) as error:
            raise ValueError(f"loss, with actor and critic: {first_line(error)}") from error
        finally:
            trainer.collector.shutdown()
        try:
            trainer.replay_buffer.extend(batch)  # takes the memory of all rows at once
        except (MemoryError, RuntimeError) as error:
            raise ValueError(f"replay.storage cannot hold a batch: {first_line(error)}") from error
        torch.set_rng_state(state)

    def make_evaluation(self, learned: Mapping[str, LearnedReward]) -> Evaluation:
        """What measures a policy that learned, or learns, with these rewards."""
        demonstrators = {name: reward.demonstrator for name, reward in learned.items() if reward.demonstrator}
        live = self._live_after(learned) | {"demonstrators": demonstrators}
        del live["seed"]  # its own, for held-out episodes
        return supply(self.evaluation, **live)

    def make_refinement(self, learned: Mapping[str, LearnedReward]) -> PathwiseRefinement | None:
        """What refines a policy that learned with these rewards; ``None`` where the config has nothing."""
        if self.refinement is None:
            return None
        return supply(self.refinement, **self._live_after(learned), progress_bar=setting(self.trainer, "progress_bar"))

    def finish(self, trainer: Trainer, learned: Mapping[str, LearnedReward] | None = None) -> nn.Module:
        """The policy of a trainer that has finished: its averaged actor, refined where the config says so.

        Args:
            trainer: of :meth:`make_trainer`.
            learned: what it was made with.
        """
        policy = trainer.checkpoint.components["average"].module
        refinement = self.make_refinement(learned or {})
        if refinement is None:
            return policy
        return refinement(policy, trainer.loss_module.value_estimator.gamma, trainer.logger)

    def _live_after(self, learned: Mapping[str, LearnedReward]) -> dict[str, Any]:
        """For what drives a policy that learned with these rewards."""
        make_env = partial(self.make_env, {name: reward.transform for name, reward in learned.items()})
        live = self._live(make_env(num_envs=1)) | {"make_env": make_env}
        return live | {"scalarisation": build(setting(self.loss, "scalarisation"), "loss.scalarisation", **live)}

    def make_logger(self, directory: Path) -> Logger | None:
        """The logger, which writes into ``directory/logs``."""
        if self.logger is None:
            return None
        return supply(self.logger, exp_name="logs", log_dir=str(directory))

    def _live(self, env: TransformedEnv, **more: Any) -> dict[str, Any]:
        live = live_objects(env) | {"seed": self.seed, "device": self.device} | more
        if not live["num_objectives"] and "num_objectives" in takes(self.preferences):
            raise ValueError(
                "Every objective is static, so that λ has none to weigh; choose another besides, or ablation=baseline, "
                "which learns from the baseline alone."
            )
        return live | {"sampler": supply(self.preferences, **live)}

    def _make_replay(self, live: Mapping[str, Any]) -> ReplayBuffer:
        # Without one, PrioritizedSampler draws by NumPy on a CPU; the state of one on a GPU TorchRL cannot load.
        generator = torch.Generator().manual_seed(self.seed) if torch.device(self.device).type == "cpu" else None
        return supply(self.replay, **live, generator=generator)

    def _make_loss(
        self,
        live: Mapping[str, Any],
        policy: TensorDictModule,
        critics: list[nn.Module],
        clones: Mapping[str, nn.Module],
    ) -> MORLTD3Loss:
        own = {id(parameter): parameter for parameter in policy.parameters()}
        keys = ["observation", "preference", "action"]
        loss = supply(
            self.loss,
            **live,
            actor_network=copy.deepcopy(policy, own),  # on the same parameters, with products of its own
            qvalue_network=[TensorDictModule(critic, keys, ["state_action_value"]) for critic in critics],
            clones={
                name: TensorDictModule(copy.deepcopy(clone), ["observation"], ["action"])
                for name, clone in clones.items()
                if clone is not None
            },
        )
        hasten(loss, product_dtype(self.products, torch.device(self.device)), self.compile)
        return loss.to(self.device)

    def _make_exploration(self, live: Mapping[str, Any], batches: int) -> nn.Module:
        space = live["action_spec"].space
        return supply(
            self.exploration,
            **live,
            spec=live["action_spec"],  # of one environment: workers hold different numbers of them
            std=((space.high - space.low) / 2).tolist(),
            annealing_num_steps=batches,
        )

    def _frames_per_batch(self, env: EnvBase) -> int:
        frames, side_by_side = setting(self.collector, "frames_per_batch"), env.batch_size.numel()
        if frames < 1 or frames % side_by_side:
            raise ValueError(
                f"collector.frames_per_batch ({frames}) must be a positive multiple of the {side_by_side} environments "
                f"(env.num_envs)."
            )
        check_at_least(0, **{"collector.init_random_frames": setting(self.collector, "init_random_frames")})
        return frames
