"""From a config to components: environment, networks, loss and replay, each built by one function."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import LazyTensorStorage
from torchrl.envs import Compose, RewardScaling, RewardSum, StepCounter, TransformedEnv
from torchrl.objectives import ValueEstimators

from morlnav.data import PreferenceSampler
from morlnav.envs import NavigationEnv, Objective
from morlnav.modules import UniformActions, round_products
from morlnav.objectives import Guidance, MORLTD3Loss
from morlnav.trainers.resume import FilledRows, PickleFreeReplayBuffer
from morlnav.transforms import DrawPreference

LOSS_SETTINGS = (
    "angle",
    "angles",
    "interpolator",
    "bounded",
    "scalarisation",
    "guidance",
    "search",
    "gamma",
    "gamma_start",
    "gamma_fraction",
)


def build(node: DictConfig, **objects: Any) -> Any:
    """Call a config's ``_target_`` with live objects, which OmegaConf cannot hold.

    Examples:
        >>> world = build(OmegaConf.create({"_target_": "morlnav.world.TensorWorld", "goal_radius": 0.5}), device="cpu")
        >>> world.goal_radius
        0.5
    """
    try:
        return instantiate(node, _partial_=True, _convert_="all")(**objects)
    except TypeError as error:  # a value of the wrong kind, or an argument that the class does not have
        raise ValueError(f"{node._target_} refuses its config: {error}") from error


def make_base_env(
    cfg: DictConfig,
    num_envs: int | None = None,
    seed: int | None = None,
    objectives: Mapping[str, Objective] | None = None,
) -> NavigationEnv:
    """The bare environment: world, scenes and, unless given, objectives from the config."""
    return NavigationEnv(
        world=build(cfg.world, device=cfg.device),
        scenes=build(cfg.env.scenes),
        objectives=objectives if objectives is not None else instantiate(cfg.objectives, _convert_="all"),
        num_envs=num_envs if num_envs is not None else cfg.env.num_envs,
        observe_human=cfg.env.observe_human,
        seed=seed,
    )


def make_preferences(cfg: DictConfig, num_objectives: int) -> PreferenceSampler:
    """The preference sampler for this many tuneable objectives."""
    return instantiate(cfg.preferences, num_objectives=num_objectives)


def make_env(cfg: DictConfig, num_envs: int | None = None, seed: int | None = None) -> TransformedEnv:
    """The training environment: a preference per episode, a time limit, returns, and a robot that is a little wider.

    What a robot has learned with the radius of its body and ``trainer.inflation`` more keeps clear of what a lidar's
    sector tells only roughly, as costmaps of planners do; the returned environment's world is the only one inflated.

    Examples:
        >>> from hydra import compose, initialize_config_dir
        >>> from morlnav.cli import conf_dir
        >>> with initialize_config_dir(conf_dir(), version_base="1.3"):
        ...     cfg = compose("train", ["objectives=[baseline,distance,efficiency]"])
        >>> env = make_env(cfg, num_envs=2)
        >>> env.rollout(3)["preference"].shape
        torch.Size([2, 3, 2])
    """
    env = make_base_env(cfg, num_envs, seed if seed is not None else cfg.seed)
    env.world.robot = robot = copy.copy(env.world.robot)
    object.__setattr__(robot, "radius", robot.radius + cfg.trainer.inflation)  # it may be frozen, or of another kind
    sampler = make_preferences(cfg, len(env.objectives))
    return TransformedEnv(env, Compose(StepCounter(cfg.env.max_steps), RewardSum(), DrawPreference(sampler)))


def make_features(node: DictConfig, env: NavigationEnv) -> nn.Module:
    """The module that a network looks at raw observations through."""
    lidar = env.world.lidar
    return build(
        node,
        observe_human=env.observe_human,
        lidar_range=lidar.max_range,
        sectors=lidar.sectors,
    )


def _make_afterstate(cfg: DictConfig, env: NavigationEnv) -> nn.Module | None:
    node = cfg.networks.get("afterstate")
    if node is None:
        return None
    return build(node, robot=env.world.robot, step_time=env.world.step_time, observe_human=env.observe_human)


def bounds_of(env: NavigationEnv) -> dict[str, list[float]]:
    """The action's bounds, by the names of the arguments that networks and noise take them as."""
    robot = env.world.robot
    return {"action_low": robot.action_low.tolist(), "action_high": robot.action_high.tolist()}


def make_networks(cfg: DictConfig, env: NavigationEnv) -> tuple[nn.Module, list[nn.Module]]:
    """The actor and the twin critics as plain modules that fit the environment.

    Examples:
        >>> from hydra import compose, initialize_config_dir
        >>> from morlnav.cli import conf_dir
        >>> with initialize_config_dir(conf_dir(), version_base="1.3"):
        ...     cfg = compose("train", ["objectives=[baseline,distance,efficiency]"])
        >>> env = make_base_env(cfg, num_envs=1)
        >>> actor, critics = make_networks(cfg, env)
        >>> len(critics)
        2
    """
    shape = {"num_preferences": len(env.objectives), **bounds_of(env)}
    actor = build(cfg.networks.actor, **shape, features=make_features(cfg.networks.features, env))
    critics = [
        build(
            cfg.networks.critic,
            **shape,
            num_objectives=len(env.rewards),
            features=make_features(cfg.networks.features, env),
            afterstate=_make_afterstate(cfg, env),
        )
        for _ in range(cfg.loss.num_qvalue_nets)
    ]
    return actor.to(env.device), [critic.to(env.device) for critic in critics]


def make_loss(
    cfg: DictConfig,
    env: NavigationEnv,
    actor: nn.Module,
    critics: list[nn.Module],
    clones: Mapping[str, nn.Module] | None = None,
) -> MORLTD3Loss:
    """The loss with its angle term, interpolator, value estimator and guidance by ``clones``, named as objectives."""
    guides = [_make_guidance(cfg, env, name, clone) for name, clone in (clones or {}).items()]
    if cfg.loss.get("search") is not None:
        proposal = TensorDictModule(UniformActions(**bounds_of(env)), ["observation"], ["action"])
        guides.append(build(cfg.loss.search, guide=proposal))
    settings = [key for key in cfg.loss if key not in LOSS_SETTINGS]
    if cfg.loss.angle not in cfg.loss.angles:
        raise ValueError(f"loss.angle must be one of {', '.join(cfg.loss.angles)}, got {cfg.loss.angle}.")
    parameters = {id(parameter): parameter for parameter in actor.parameters()}
    loss = build(
        OmegaConf.masked_copy(cfg.loss, settings),
        actor_network=copy.deepcopy(actor, parameters),  # on the same parameters, with products of its own
        qvalue_network=[
            TensorDictModule(critic, in_keys=["observation", "preference", "action"], out_keys=["state_action_value"])
            for critic in critics
        ],
        action_spec=env.action_spec_unbatched,
        scalarisation=_make_scalarisation(cfg, env),
        angle=instantiate(cfg.loss.angles[cfg.loss.angle]),
        interpolator=_make_interpolator(cfg, env),
        reward_bounds=cfg.replay.reward_scale * env.reward_bounds if cfg.loss.get("bounded") else None,
        guidance=guides,
    )
    loss.make_value_estimator(ValueEstimators.TD0, gamma=final_discount(cfg, env))
    dtype = product_dtype(cfg.trainer.products, env.device)
    for network in (loss.actor_network, loss.qvalue_network, *guides):
        round_products(network, dtype)
    return loss.to(env.device)


def _make_interpolator(cfg: DictConfig, env: NavigationEnv) -> nn.Module | None:
    node = cfg.loss.get("interpolator")
    if node is None:
        return None
    return instantiate(
        node,
        num_objectives=len(env.objectives),
        num_static=env.num_static,
        steps=node.get("steps", cfg.evaluation.during.steps),  # every evaluation measures each key
    ).to(env.device)


def product_dtype(name: str, device: torch.device) -> torch.dtype:
    """The type in which hidden layers multiply while learning: ``auto`` is bfloat16 where ``device`` is made for it.

    Raises:
        ValueError: if it is none of auto, float32 and bfloat16.
    """
    if name == "auto":
        capabilities = getattr(torch.cpu, "get_capabilities", dict)()
        fast = torch.cuda.is_bf16_supported() if device.type == "cuda" else capabilities.get("avx512_bf16", False)
        return torch.bfloat16 if fast else torch.float32
    if name not in ("float32", "bfloat16"):
        raise ValueError(f"trainer.products must be one of auto, float32, bfloat16, got {name}.")
    return getattr(torch, name)


def final_discount(cfg: DictConfig, env: NavigationEnv) -> float | list[float]:
    """The discount at the end of the training: one for all, or one per entry of the reward ``[m]``.

    Raises:
        ValueError: if ``loss.gamma`` names entries but has no ``default`` for those that it does not name.
    """
    return _by_name("loss.gamma", cfg.loss.gamma, env.rewards)


def _by_name(key: str, value: Any, names: Collection[str]) -> float | list[float]:
    """A config's number, or one per name, where it names them; ``default`` serves those that it does not name."""
    if not OmegaConf.is_dict(value):
        return float(value)
    missing = [name for name in names if name not in value and "default" not in value]
    if missing:
        raise ValueError(f"{key} names no value for {', '.join(missing)}, and no default.")
    return [float(value.get(name, value.get("default"))) for name in names]


def _make_scalarisation(cfg: DictConfig, env: NavigationEnv) -> nn.Module:
    node = cfg.loss.scalarisation
    named = {
        name: _by_name(f"loss.scalarisation.{name}", node[name], env.objectives)
        for name in ("scale", "tie_break")
        if name in node
    }
    return build(node, **named)


def _make_guidance(cfg: DictConfig, env: NavigationEnv, name: str, clone: nn.Module) -> Guidance:
    guide = TensorDictModule(clone.to(env.device), ["observation"], ["action"])
    return build(cfg.loss.guidance, guide=guide, entry=env.objectives.index(name))


def make_replay(cfg: DictConfig, num_objectives: int) -> PickleFreeReplayBuffer:
    """Replay that stores each transition once and redraws its preference whenever it is sampled."""
    relabel = build(cfg.replay.relabel, sampler=make_preferences(cfg, num_objectives))
    scale = RewardScaling(loc=0.0, scale=cfg.replay.reward_scale, in_keys=[("next", "reward")])
    # Without one, PrioritizedSampler draws by NumPy on a CPU; the state of one on a GPU TorchRL cannot load.
    generator = torch.Generator().manual_seed(cfg.seed) if torch.device(cfg.device).type == "cpu" else None
    return PickleFreeReplayBuffer(
        storage=LazyTensorStorage(int(cfg.replay.capacity), device=cfg.device),
        sampler=build(cfg.replay.sampler),
        batch_size=cfg.trainer.batch_size,
        transform=Compose(relabel, scale),
        generator=generator,
        checkpointer=FilledRows(),
    )
