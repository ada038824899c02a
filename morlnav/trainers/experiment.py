"""From a config to a trainer: TorchRL's, with our optimisation step and hooks."""

from __future__ import annotations

import copy
import math
import multiprocessing
import signal
import traceback
from functools import partial
from pathlib import Path

import torch
from omegaconf import DictConfig
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torch.optim.lr_scheduler import LambdaLR
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.checkpoint import Checkpoint, CheckpointRotation, GlobalRNGState
from torchrl.collectors import BaseCollector
from torchrl.data import ReplayBuffer
from torchrl.envs import TransformedEnv
from torchrl.objectives import SoftUpdate
from torchrl.record.loggers import Logger
from torchrl.trainers.trainers import ReplayBufferTrainer, SelectKeys, Trainer

from morlnav.data import rewarded_transitions, simplex_grid
from morlnav.evaluation import evaluation_scenes
from morlnav.modules import PartlyGreedyNoise
from morlnav.objectives import MORLTD3Loss
from morlnav.trainers.builders import (
    build,
    final_discount,
    make_base_env,
    make_env,
    make_loss,
    make_networks,
    make_preferences,
    make_replay,
)
from morlnav.trainers.divergence import StopDivergence
from morlnav.trainers.drex import make_demonstrations, train_clone
from morlnav.trainers.evaluator import EvaluatePolicy
from morlnav.trainers.hooks import AnnealDiscount, LogEpisodes, LogOptimisation, StepExploration
from morlnav.trainers.resume import RolloutState
from morlnav.trainers.stepper import MORLTD3Stepper
from morlnav.trainers.styles import demonstrated_objectives, demonstrated_paths, style_config

REPLAY_KEYS = ("observation", "preference", "action")
REPLAY_NEXT_KEYS = ("observation", "preference", "reward", "done", "terminated")


def make_trainer(cfg: DictConfig, directory: Path, logger: Logger) -> Trainer:
    """Everything wired to TorchRL's trainer; ``directory`` receives checkpoints.

    Raises:
        ValueError: if the numbers in the config contradict each other.
        ChildProcessError: if a worker process dies at its start.
    """
    settings = cfg.trainer
    _check(cfg)
    env = make_env(cfg)
    actor, critics = make_networks(cfg, env.base_env)
    policy = TensorDictModule(actor, in_keys=["observation", "preference"], out_keys=["action"])
    loss = make_loss(cfg, env.base_env, policy, critics, _make_clones(cfg) if cfg.loss.guidance is not None else None)
    if settings.compile is not None:
        _compile(loss, settings.compile)
    noise = _make_exploration(cfg, env)
    stepper, replay = _make_stepper(cfg, loss, actor), _make_replay(cfg, env)
    # Last, for an error after it would leave its workers behind.
    collector = _make_collector(cfg, env, TensorDictSequential(policy, noise))
    rollout = {"rollout": RolloutState(collector)} if _in_one_process(cfg) else {}
    trainer = Trainer(
        collector=collector,
        total_frames=settings.total_frames,
        frame_skip=1,
        loss_module=loss,
        optimization_stepper=stepper,
        replay_buffer=replay,
        optim_steps_per_batch=settings.optim_steps_per_batch,
        logger=logger,
        clip_norm=settings.clip_norm,
        progress_bar=settings.progress_bar,
        log_interval=2**62,  # our hooks write the logs
        auto_log_optim_steps=False,
        checkpoint=Checkpoint(rng=GlobalRNGState(), average=stepper.average, **rollout),
        checkpoint_rotation=CheckpointRotation(directory / "checkpoints", keep_last=settings.checkpoint.keep_last),
        save_trainer_interval=settings.checkpoint.interval,
    )
    _register_hooks(cfg, directory, trainer, env, noise)
    return trainer


def _compile(loss: MORLTD3Loss, arguments: DictConfig) -> None:
    try:
        for method in ("value_loss", "actor_loss"):
            setattr(loss, method, torch.compile(getattr(loss, method), **arguments))
    except (TypeError, RuntimeError) as error:
        message = f"trainer.compile must be null or arguments of torch.compile, as {{mode: default}}, got {arguments}."
        raise ValueError(message) from error


def _make_clones(cfg: DictConfig) -> dict[str, nn.Module]:
    views = {name: style_config(cfg, name) for name in demonstrated_objectives(cfg)}
    return {name: train_clone(view, make_demonstrations(view)) for name, view in views.items()}


def _check(cfg: DictConfig) -> None:
    settings = cfg.trainer
    counts = {"env.num_envs": cfg.env.num_envs} | {
        f"trainer.{name}": settings[name]
        for name in ("frames_per_batch", "optim_steps_per_batch", "policy_update_delay", "batch_size")
    }
    for name, count in counts.items():
        if not isinstance(count, int) or count < 1:
            raise ValueError(f"{name} must be a whole number of at least 1, got {count}.")
    if settings.exploration.sigma_init < settings.exploration.sigma_end:
        raise ValueError(
            f"trainer.exploration must not grow, but sigma_init is {settings.exploration.sigma_init} and sigma_end "
            f"{settings.exploration.sigma_end}."
        )
    if cfg.trainer.frames_per_batch % cfg.env.num_envs:
        raise ValueError(
            f"trainer.frames_per_batch ({cfg.trainer.frames_per_batch}) must be a multiple of env.num_envs "
            f"({cfg.env.num_envs})."
        )
    if settings.inflation < 0:
        raise ValueError(f"trainer.inflation must not be negative, got {settings.inflation}.")


def _in_one_process(cfg: DictConfig) -> bool:
    return "num_collectors" not in cfg.collector


def _make_collector(cfg: DictConfig, env: TransformedEnv, policy: TensorDictModule) -> BaseCollector:
    """The collector of the config; workers make their own share of the environments."""
    settings = {
        "policy": policy,
        "frames_per_batch": cfg.trainer.frames_per_batch,
        "total_frames": -1,
        "init_random_frames": cfg.trainer.random_frames,
        "device": cfg.device,
    }
    if _in_one_process(cfg):
        return build(cfg.collector, create_env_fn=env, auto_register_policy_transforms=False, **settings)
    workers = cfg.collector.num_collectors
    if cfg.env.num_envs % workers:
        raise ValueError(f"env.num_envs ({cfg.env.num_envs}) must be a multiple of {workers} collectors.")
    share = cfg.env.num_envs // workers
    makers = [partial(_make_workers_env, cfg, share, worker) for worker in range(workers)]
    try:
        return build(cfg.collector, create_env_fn=makers, **settings)
    except RuntimeError as error:
        if not isinstance(error.__cause__, EOFError):
            raise
        traceback.clear_frames(error.__traceback__)  # what is left of the collector would hang at exit
        message = "A collecting process died at its start; for lack of memory? Then lower collector.num_collectors."
        raise ChildProcessError(message) from error


def _make_workers_env(cfg: DictConfig, share: int, worker: int) -> TransformedEnv:
    seed = cfg.seed * cfg.collector.num_collectors + worker
    if multiprocessing.parent_process() is not None:  # Ctrl-C reaches all processes; the learner stops the workers
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.manual_seed(seed)  # preferences and exploration draw from the worker's global state
    if "offset" in cfg.preferences:  # its environments are those from this number on
        cfg = copy.deepcopy(cfg)
        cfg.preferences.offset = worker * share
    return make_env(cfg, share, seed)


def _num_batches(cfg: DictConfig) -> int:
    return max(1, math.ceil(cfg.trainer.total_frames / cfg.trainer.frames_per_batch))


def _make_replay(cfg: DictConfig, env: TransformedEnv) -> ReplayBuffer:
    """The replay buffer, filled with the demonstrations if so wished; new transitions write over them in the end."""
    base = env.base_env
    replay = make_replay(cfg, len(base.objectives))
    if cfg.replay.demonstrations:
        if not base.observe_human:
            raise ValueError(
                "replay.demonstrations needs env.observe_human=true: rewards are computed from what is seen."
            )
        views = [style_config(cfg, name) for name in demonstrated_objectives(cfg)] or [cfg]
        rows = torch.cat(
            [rewarded_transitions(make_demonstrations(view).to(cfg.device), base.rewards) for view in views]
        )
        rows["preference"] = make_preferences(cfg, len(base.objectives))(len(rows))
        rows["next", "preference"] = rows["preference"]
        replay.extend(rows)
    return replay


def _make_exploration(cfg: DictConfig, env: TransformedEnv) -> PartlyGreedyNoise:
    space = env.base_env.action_spec_unbatched.space
    return PartlyGreedyNoise(
        spec=env.base_env.action_spec_unbatched,  # workers hold different numbers of environments
        std=((space.high - space.low) / 2).tolist(),
        annealing_num_steps=_num_batches(cfg),
        **cfg.trainer.exploration,
    ).to(env.base_env.device)


def _make_stepper(cfg: DictConfig, loss: MORLTD3Loss, actor: nn.Module) -> MORLTD3Stepper:
    settings = cfg.trainer
    optimizers = [
        build(settings.optimizer_actor, params=list(loss.actor_network_params.parameters())),
        build(settings.optimizer_critic, params=list(loss.qvalue_network_params.parameters())),
    ]
    updates = _num_batches(cfg) * settings.optim_steps_per_batch
    totals = (max(1, updates // settings.policy_update_delay), updates)

    def decay(progress: float) -> float:
        start, end = settings.lr_decay_start, settings.lr_decay_end
        return 1.0 if progress <= start else max(end, 1 - (1 - end) * (progress - start) / (1 - start))

    return MORLTD3Stepper(
        *optimizers,
        SoftUpdate(loss, tau=settings.target_tau),
        policy_update_delay=settings.policy_update_delay,
        actor=actor,
        average=AveragedModel(actor, multi_avg_fn=get_ema_multi_avg_fn(settings.average_decay)),
        schedulers=[
            LambdaLR(optimizer, lambda step, total=total: decay(step / total))
            for optimizer, total in zip(optimizers, totals, strict=True)
        ],
    )


def _register_hooks(
    cfg: DictConfig, directory: Path, trainer: Trainer, env: TransformedEnv, noise: PartlyGreedyNoise
) -> None:
    base = make_base_env(cfg, 1, cfg.seed, env.base_env.rewards)  # with a robot of its true size
    loss, stepper = trainer.loss_module, trainer.optimization_stepper
    rewards, during = tuple(base.rewards), cfg.evaluation.during
    LogEpisodes(rewards, cfg.logger.interval).register(trainer)
    SelectKeys([*REPLAY_KEYS, *(("next", key) for key in REPLAY_NEXT_KEYS)]).register(trainer)
    ReplayBufferTrainer(trainer.replay_buffer, flatten_tensordicts=True).register(trainer)
    StepExploration(noise).register(trainer)
    frames = int(cfg.loss.gamma_fraction * cfg.trainer.total_frames)
    AnnealDiscount(cfg.loss.gamma_start, final_discount(cfg, base), frames).register(trainer)
    StopDivergence().register(trainer)  # before the weights are evaluated
    scenes = evaluation_scenes(during.episodes, seed=cfg.evaluation.seed + 1, sampler=base.scenes)
    EvaluatePolicy(
        stepper.average.module,
        base,
        scenes,
        simplex_grid(len(base.objectives), during.steps),
        loss,
        during.interval,
        cfg.env.max_steps,
        demonstrated_paths(cfg, scenes, base.world, directory, demonstrated_objectives(cfg)),
    ).register(trainer)
    scalars = {
        "gamma": lambda: loss.value_estimator.gamma.max(),
        "exploration": lambda: noise.sigma,
        "lr_actor": lambda: stepper.optimizer_actor.param_groups[0]["lr"],
        "lr_critic": lambda: stepper.optimizer_critic.param_groups[0]["lr"],
    }
    LogOptimisation(rewards, cfg.logger.interval, scalars).register(trainer)
