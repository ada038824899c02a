"""From a config to a trainer: environment, networks, loss, replay, collector, trainer, each built by one function."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torch.optim.lr_scheduler import LambdaLR
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.checkpoint import Checkpoint, CheckpointRotation, GlobalRNGState
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage
from torchrl.envs import Compose, RewardScaling, RewardSum, StepCounter, TransformedEnv
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate, ValueEstimators
from torchrl.record.loggers import Logger
from torchrl.trainers.trainers import ReplayBufferTrainer, SelectKeys, Trainer

from morlnav.data import PreferenceSampler, simplex_grid
from morlnav.envs import NavigationEnv
from morlnav.evaluation import evaluation_scenes
from morlnav.objectives import MORLTD3Loss
from morlnav.trainers.evaluator import EvaluatePolicy
from morlnav.trainers.hooks import AnnealDiscount, LogEpisodes, LogOptimisation, StepExploration
from morlnav.trainers.resume import PickleFreeReplayBuffer, RolloutState
from morlnav.trainers.stepper import MORLTD3Stepper
from morlnav.transforms import DrawPreference


def build(node: DictConfig, **objects: Any) -> Any:
    """Call a config's ``_target_`` with live objects, which OmegaConf cannot hold."""
    try:
        return instantiate(node, _partial_=True, _convert_="all")(**objects)
    except TypeError as error:  # a value of the wrong kind, or an argument that the class does not have
        raise ValueError(f"{node._target_} refuses its config: {error}") from error


REPLAY_KEYS = ("observation", "preference", "action")
REPLAY_NEXT_KEYS = ("observation", "preference", "reward", "done", "terminated")


def make_base_env(cfg: DictConfig, num_envs: int | None = None, seed: int | None = None) -> NavigationEnv:
    """The bare environment: world, scenes and objectives from the config."""
    return NavigationEnv(
        world=build(cfg.world, device=cfg.device),
        scenes=build(cfg.env.scenes),
        objectives=instantiate(cfg.objectives, _convert_="all"),
        num_envs=num_envs if num_envs is not None else cfg.env.num_envs,
        observe_human=cfg.env.observe_human,
        seed=seed,
    )


def make_preferences(cfg: DictConfig, num_objectives: int) -> PreferenceSampler:
    """The preference sampler for this many tuneable objectives."""
    return instantiate(cfg.preferences, num_objectives=num_objectives)


def make_env(cfg: DictConfig) -> TransformedEnv:
    """The training environment: a preference per episode, a time limit, and returns."""
    env = make_base_env(cfg, seed=cfg.seed)
    sampler = make_preferences(cfg, len(env.objectives))
    return TransformedEnv(env, Compose(StepCounter(cfg.env.max_steps), RewardSum(), DrawPreference(sampler)))


def make_networks(cfg: DictConfig, env: NavigationEnv) -> tuple[nn.Module, list[nn.Module]]:
    """The actor and the twin critics as plain modules that fit the environment."""
    lidar = env.world.lidar
    shape = {
        "num_preferences": len(env.objectives),
        "action_low": env.world.robot.action_low.tolist(),
        "action_high": env.world.robot.action_high.tolist(),
    }
    features = {"observe_human": env.observe_human, "lidar_range": lidar.max_range, "sectors": lidar.sectors}
    actor = build(cfg.networks.actor, **shape, features=instantiate(cfg.networks.features, **features))
    critics = [
        build(
            cfg.networks.critic,
            **shape,
            num_objectives=len(env.rewards),
            features=instantiate(cfg.networks.features, **features),
        )
        for _ in range(cfg.loss.num_qvalue_nets)
    ]
    return actor.to(env.device), [critic.to(env.device) for critic in critics]


def make_loss(cfg: DictConfig, env: NavigationEnv, actor: nn.Module, critics: list[nn.Module]) -> MORLTD3Loss:
    """The loss with its angle term, interpolator and value estimator."""
    settings = [key for key in cfg.loss if key not in LOSS_SETTINGS]
    if cfg.loss.angle not in cfg.loss.angles:
        raise ValueError(f"loss.angle must be one of {', '.join(cfg.loss.angles)}, got {cfg.loss.angle}.")
    loss = build(
        OmegaConf.masked_copy(cfg.loss, settings),
        actor_network=actor,
        qvalue_network=[
            TensorDictModule(critic, in_keys=["observation", "preference", "action"], out_keys=["state_action_value"])
            for critic in critics
        ],
        action_spec=env.action_spec_unbatched,
        angle=instantiate(cfg.loss.angles[cfg.loss.angle]),
        interpolator=instantiate(
            cfg.loss.interpolator, num_objectives=len(env.objectives), num_static=env.num_static
        ).to(env.device),
    )
    loss.make_value_estimator(ValueEstimators.TD0, gamma=float(cfg.loss.gamma))
    return loss.to(env.device)


LOSS_SETTINGS = ("angle", "angles", "interpolator", "gamma", "gamma_start", "gamma_fraction")


def make_replay(cfg: DictConfig, num_objectives: int) -> PickleFreeReplayBuffer:
    """Replay that stores each transition once and redraws its preference whenever it is sampled."""
    relabel = build(cfg.replay.relabel, sampler=make_preferences(cfg, num_objectives))
    scale = RewardScaling(loc=0.0, scale=cfg.replay.reward_scale, in_keys=[("next", "reward")])
    return PickleFreeReplayBuffer(
        storage=LazyTensorStorage(int(cfg.replay.capacity), device=cfg.device),
        batch_size=cfg.trainer.batch_size,
        transform=Compose(relabel, scale),
    )


def make_trainer(cfg: DictConfig, directory: Path, logger: Logger) -> Trainer:
    """Everything wired to TorchRL's trainer; ``directory`` receives checkpoints.

    Raises:
        ValueError: if the numbers in the config contradict each other.
    """
    settings = cfg.trainer
    if cfg.env.num_envs < 1:
        raise ValueError(f"env.num_envs must be at least 1, got {cfg.env.num_envs}.")
    if settings.frames_per_batch % cfg.env.num_envs:
        raise ValueError(
            f"trainer.frames_per_batch ({settings.frames_per_batch}) must be a multiple of env.num_envs "
            f"({cfg.env.num_envs})."
        )
    env = make_env(cfg)
    base = env.base_env
    actor_module, critics = make_networks(cfg, base)
    actor = TensorDictModule(actor_module, in_keys=["observation", "preference"], out_keys=["action"])
    loss = make_loss(cfg, base, actor, critics)
    half_range = (base.action_spec_unbatched.space.high - base.action_spec_unbatched.space.low) / 2
    batches = max(1, settings.total_frames // settings.frames_per_batch)
    noise = AdditiveGaussianModule(
        spec=base.action_spec, std=half_range.tolist(), annealing_num_steps=batches, **settings.exploration
    ).to(base.device)
    collector = Collector(
        env,
        TensorDictSequential(actor, noise),
        frames_per_batch=settings.frames_per_batch,
        total_frames=-1,
        init_random_frames=settings.random_frames,
        device=cfg.device,
        auto_register_policy_transforms=False,
    )

    optimizers = [
        build(settings.optimizer_actor, params=list(loss.actor_network_params.parameters())),
        build(settings.optimizer_critic, params=list(loss.qvalue_network_params.parameters())),
    ]
    updates = batches * settings.optim_steps_per_batch
    steps = (max(1, updates // settings.policy_update_delay), updates)  # of the actor and of the critics

    def decay(progress: float) -> float:
        start, end = settings.lr_decay_start, settings.lr_decay_end
        return 1.0 if progress <= start else max(end, 1 - (1 - end) * (progress - start) / (1 - start))

    schedulers = [
        LambdaLR(optimizer, lambda step, total=total: decay(step / total))
        for optimizer, total in zip(optimizers, steps, strict=True)
    ]
    average = AveragedModel(actor_module, multi_avg_fn=get_ema_multi_avg_fn(settings.average_decay))
    stepper = MORLTD3Stepper(
        *optimizers,
        SoftUpdate(loss, tau=settings.target_tau),
        policy_update_delay=settings.policy_update_delay,
        actor=actor_module,
        average=average,
        schedulers=schedulers,
    )
    replay = make_replay(cfg, len(base.objectives))
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
        log_interval=2**62,
        auto_log_optim_steps=False,
        checkpoint=Checkpoint(rng=GlobalRNGState(), rollout=RolloutState(collector), average=average),
        checkpoint_rotation=CheckpointRotation(directory / "checkpoints", keep_last=settings.checkpoint.keep_last),
        save_trainer_interval=settings.checkpoint.interval,
    )
    rewards = tuple(base.rewards)
    LogEpisodes(rewards, cfg.logger.interval, loss.scalarisation).register(trainer)
    SelectKeys([*REPLAY_KEYS, *(("next", key) for key in REPLAY_NEXT_KEYS)]).register(trainer)
    ReplayBufferTrainer(replay, flatten_tensordicts=True).register(trainer)
    StepExploration(noise).register(trainer)
    AnnealDiscount(
        loss, cfg.loss.gamma_start, cfg.loss.gamma, int(cfg.loss.gamma_fraction * settings.total_frames)
    ).register(trainer)
    during = cfg.evaluation.during
    EvaluatePolicy(
        average.module,
        base,
        evaluation_scenes(during.episodes, seed=cfg.evaluation.seed + 1, sampler=base.scenes),
        simplex_grid(len(base.objectives), during.steps),
        loss,
        during.interval,
        cfg.env.max_steps,
    ).register(trainer)
    scalars = {
        "gamma": lambda: loss.value_estimator.gamma,
        "exploration": lambda: noise.sigma,
        "lr_actor": lambda: optimizers[0].param_groups[0]["lr"],
        "lr_critic": lambda: optimizers[1].param_groups[0]["lr"],
    }
    LogOptimisation(rewards, cfg.logger.interval, scalars).register(trainer)
    return trainer
