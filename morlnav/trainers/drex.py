"""D-REX (Sec. III-C): demonstrations, a clone, ranked roll-outs and a reward model, each stage cached by its config."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.record.loggers import Logger

from morlnav.data import SnippetPairs, load_demonstrations, roll_out_ranked, save_demonstrations
from morlnav.envs import NavigationEnv
from morlnav.modules import EpsilonGreedyNoise, NormalisedReward, RewardEnsemble, load_reward, read_facts, save_reward
from morlnav.objectives import BehaviourCloningLoss, RankingLoss
from morlnav.trainers.builders import build, make_features
from morlnav.trainers.supervised import fit


def stage_directory(cfg: DictConfig, *groups: str) -> Path:
    """Where a stage keeps its result: named by a hash of every config group it depends on."""
    content = {group: OmegaConf.to_container(OmegaConf.select(cfg, group), resolve=True) for group in groups}
    digest = hashlib.sha256(json.dumps([content, cfg.seed], sort_keys=True).encode()).hexdigest()[:12]
    return Path(cfg.cache) / f"{groups[-1]}-{digest}"


def learn_demonstration_reward(cfg: DictConfig, directory: Path, logger: Logger | None = None) -> None:
    """Learn the reward of the objective ``demo`` if it has no model yet; keep it in ``directory/reward.pt``.

    Writes the model's place into ``cfg``.
    """
    if OmegaConf.select(cfg, "objectives.demo.reward.path", default="given") is not None:
        return
    path = directory / "reward.pt"
    if not path.exists():
        clone = train_clone(cfg, make_demonstrations(cfg), logger)
        model = train_reward(cfg, clone, logger)
        save_reward(model, path, read_facts(_reward_file(cfg))["facts"])
    cfg.objectives.demo.reward.path = str(path)


STAGES = ("world", "env", "demonstrations", "networks.features", "clone", "ranking")


def _reward_file(cfg: DictConfig) -> Path:
    return stage_directory(cfg, *STAGES) / "reward.pt"


def make_demonstrations(cfg: DictConfig) -> TensorDict:
    """Record the demonstrator, or take the recording from the cache."""
    path = stage_directory(cfg, *STAGES[:3])
    if not path.exists():
        data, tries = build(
            cfg.demonstrations, sampler=build(cfg.env.scenes), world=build(cfg.world, device=cfg.device)
        )
        unfinished = path.with_suffix(".part")
        save_demonstrations(data, unfinished, {"tries": tries})
        unfinished.rename(path)
    return load_demonstrations(path)


def train_clone(cfg: DictConfig, demonstrations: TensorDict, logger: Logger | None = None) -> nn.Module:
    """Clone the demonstrator by regression on its clean actions, or load the clone from the cache."""
    path = stage_directory(cfg, *STAGES[:5]).with_suffix(".pt")
    torch.manual_seed(cfg.seed)  # the same clone whether or not an earlier stage came from the cache
    env = make_bare_env(cfg, 1)
    low, high = env.world.robot.action_low, env.world.robot.action_high
    actor = build(
        cfg.clone.actor,
        num_preferences=0,
        action_low=low.tolist(),
        action_high=high.tolist(),
        features=make_features(cfg, env),
    )
    if path.exists():
        actor.load_state_dict(torch.load(path, weights_only=True))
        return actor.eval()
    loss = BehaviourCloningLoss(
        TensorDictModule(actor, ["observation"], ["action"]), bounds=(low, high), loss_function=cfg.clone.loss_function
    )
    rows = demonstrations.select("observation", "action")
    last = demonstrations["episode"] >= int((1 - cfg.clone.held_out) * (demonstrations["episode"].max() + 1))
    train, held_out = rows[~last], rows[last]
    fit(
        loss,
        lambda: train[torch.randint(len(train), (cfg.clone.batch_size,))],
        held_out,
        name="clone",
        logger=logger,
        progress_bar=cfg.trainer.progress_bar,
        **cfg.clone.fit,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(actor.state_dict(), path)
    return actor.eval()


def make_bare_env(cfg: DictConfig, num_envs: int, seed: int | None = None) -> NavigationEnv:
    """The environment with the analytical objectives, in which demonstrations and roll-outs are made."""
    return NavigationEnv(
        world=build(cfg.world, device=cfg.device),
        scenes=build(cfg.env.scenes),
        num_envs=num_envs,
        observe_human=cfg.env.observe_human,
        seed=seed,
    )


def make_ranked_rollouts(cfg: DictConfig, clone: nn.Module) -> TensorDict:
    """Roll the clone out under every noise level of the config."""
    robot = make_bare_env(cfg, 1).world.robot
    return roll_out_ranked(
        clone,
        lambda count: make_bare_env(cfg, count, seed=cfg.seed + 1),
        lambda levels: EpsilonGreedyNoise(levels, robot.action_low, robot.action_high, hold=cfg.ranking.hold),
        list(cfg.ranking.levels),
        cfg.ranking.episodes,
        cfg.env.max_steps,
    )


def train_reward(cfg: DictConfig, clone: nn.Module, logger: Logger | None = None) -> nn.Module:
    """Learn a reward model from ranked roll-outs, or load it from the cache."""
    path = _reward_file(cfg)
    if path.exists():
        return load_reward(path)
    torch.manual_seed(cfg.seed)
    rollouts = make_ranked_rollouts(cfg, clone)
    settings, env = cfg.ranking, make_bare_env(cfg, 1)
    split = max(1, int((1 - settings.held_out) * settings.episodes))
    train = SnippetPairs(rollouts[:, :split], settings.snippet)
    held_out = SnippetPairs(rollouts[:, split:], settings.snippet).sample(512)
    robot = env.world.robot
    members = [
        build(
            settings.model,
            inputs=list(inputs),
            action_low=robot.action_low.tolist(),
            action_high=robot.action_high.tolist(),
            features=make_features(cfg, env),
        )
        for inputs in settings.members
    ]
    networks = [TensorDictModule(member, ["observation", "action"], ["reward"]) for member in members]
    loss = RankingLoss(networks, aggregate=settings.aggregate, temperature=settings.temperature)
    scores = fit(
        loss,
        lambda: torch.stack([train.sample(settings.batch_size) for _ in members]),
        held_out,
        name="ranking",
        logger=logger,
        progress_bar=cfg.trainer.progress_bar,
        **settings.fit,
    )
    model = RewardEnsemble(members, reduce=settings.reduce) if len(members) > 1 else members[0]
    mask = rollouts["mask"]
    if settings.normalise:
        clean = torch.zeros_like(mask)
        clean[0] = True
        model = NormalisedReward(model).fit(rollouts["observation"][mask], rollouts["action"][mask], clean[mask])
    save_reward(model, path, {"held_out": scores})
    return load_reward(path)
