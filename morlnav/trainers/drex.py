"""D-REX (Sec. III-C): demonstrations, clone, ranked roll-outs, reward model and audit, each cached by its config."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from filelock import FileLock
from omegaconf import DictConfig
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.record.loggers import Logger

from morlnav.cli import stage
from morlnav.data import SnippetPairs, load_demonstrations, roll_out_ranked, save_demonstrations
from morlnav.envs import NavigationEnv, default_objectives
from morlnav.evaluation import Thresholds, evaluate_policy, frechet_distance
from morlnav.modules import NormalisedReward, RewardEnsemble, load_reward, load_weights, read_facts, save_reward
from morlnav.objectives import BehaviourCloningLoss, RankingLoss
from morlnav.trainers.auditing import audit_run
from morlnav.trainers.builders import bounds_of, build, make_base_env, make_features
from morlnav.trainers.origins import (
    STAGES,
    WORLD,
    digest,
    origin,
    parts_of,
    refuse_other_rewards,
    saved_rewards,
    use_own_offsets,
)
from morlnav.trainers.styles import (
    CLONE_FILE,
    make_clone,
    style_directory,
    style_of,
)
from morlnav.trainers.supervised import fit
from morlnav.world import Scene


def stage_directory(cfg: DictConfig, *groups: str) -> Path:
    """Where a stage keeps its result: named by a hash of every part of the config it depends on."""
    content = parts_of(cfg, *groups) | {"threads": cfg.threads}  # a seed's result holds for a number of threads
    content |= {name: version(name) for name in ("morlnav", "torch")}  # ... and for a version of the code
    return Path(cfg.cache) / f"{groups[-1]}-{digest(content)}"


@contextmanager
def _stage(cfg: DictConfig, name: str, path: Path) -> Iterator[bool]:
    """One stage, whose result goes to ``path``; gives whether it is there. Parallel runs wait for one of them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path.with_suffix(".lock")):
        done = path.exists()
        with stage(_label(cfg, name), cfg.trainer.progress_bar, done):
            yield done


def learn_demonstration_rewards(cfg: DictConfig, directory: Path, logger: Logger | None = None) -> None:
    """Learn and audit the reward of every demonstrated objective that has no model yet; copy those that have one.

    Puts ``reward.pt`` and ``audit/`` into :func:`style_directory`, and the model's place into ``cfg``. What lies there
    already is not taken, for it may be older than what it came from; what was learned before comes from the cache.

    Raises:
        ValueError: if a reward fails its audit and ``audit.required``, or if one of another config lies there.
    """
    use_own_offsets(cfg)
    refuse_other_rewards(cfg, directory)
    for path, view in saved_rewards(cfg, directory).items():
        reward = view.objectives[style_of(view)].reward
        if reward.path is None:
            _learn_reward(view, directory, path, logger)
        elif reward.path != str(path):
            facts = read_facts(reward.path)["facts"]
            save_reward(load_reward(reward.path), path, {**facts, "origin": origin(view)})
        cfg.objectives[style_of(view)].reward.path = str(path)


def _learn_reward(cfg: DictConfig, directory: Path, path: Path, logger: Logger | None) -> None:
    demonstrations = make_demonstrations(cfg)
    clone = train_clone(cfg, demonstrations, logger)
    model = train_reward(cfg, clone, logger)
    reasons, facts = [], {}
    if "policy" not in cfg.demonstrations:  # the clone stands in for whoever was recorded
        path.parent.mkdir(parents=True, exist_ok=True)
        torch.save(clone.state_dict(), path.parent / CLONE_FILE)
        facts, reasons = judge_clone(cfg, clone, demonstrations)
    verdict = audit(cfg, directory)
    reasons += verdict["reasons"]
    if cfg.audit.required and reasons:
        raise ValueError(
            f"The learned reward fails its audit ({reasons[0]} See {path.parent / 'audit'}); change the "
            f"pipeline, or train on this reward with audit.required=false."
        )
    save_reward(
        model, path, {**read_facts(_reward_file(cfg))["facts"], "audit": verdict, **facts, "origin": origin(cfg)}
    )


def _label(cfg: DictConfig, name: str) -> str:
    """What a person reads: ``clone``, and ``wide_left/clone`` for an objective of that name."""
    return name if style_of(cfg) == "demo" else f"{style_of(cfg)}/{name}"


def make_demonstrations(cfg: DictConfig) -> TensorDict:
    """Record the demonstrator, or take the recording from the cache."""
    path = stage_directory(cfg, *WORLD, "demonstrations")
    with _stage(cfg, "demonstrations", path) as done:
        if not done:
            data, tries = build(
                cfg.demonstrations, sampler=build(cfg.env.scenes), world=build(cfg.world, device=cfg.device)
            )
            unfinished = path.with_suffix(".part")
            shutil.rmtree(unfinished, ignore_errors=True)  # of a process that was killed
            save_demonstrations(data, unfinished, {"tries": tries})
            unfinished.rename(path)
        return load_demonstrations(path)


def train_clone(cfg: DictConfig, demonstrations: TensorDict, logger: Logger | None = None) -> nn.Module:
    """Clone the demonstrator by regression on its clean actions, or load the clone from the cache."""
    path = stage_directory(cfg, *STAGES[:-1]).with_suffix(".pt")
    with torch.random.fork_rng(devices=[]), _stage(cfg, "clone", path) as done:
        torch.manual_seed(cfg.seed)  # the same clone, and the same draws after it, whatever comes from the cache
        actor, robot = make_clone(cfg), build(cfg.world.robot)
        if done:
            return load_weights(actor, path)
        loss = BehaviourCloningLoss(
            TensorDictModule(actor, ["observation"], ["action"]),
            bounds=(robot.action_low, robot.action_high),
            loss_function=cfg.clone.loss_function,
        )
        rows = demonstrations.select("observation", "action")
        count = int(demonstrations["episode"].max()) + 1
        last = demonstrations["episode"] >= max(1, int((1 - cfg.clone.held_out) * count))
        train, held_out = rows[~last], rows[last] if count > 1 else rows
        fit(
            loss,
            lambda: train[torch.randint(len(train), (cfg.clone.batch_size,))],
            held_out,
            name=_label(cfg, "clone"),
            logger=logger,
            progress_bar=cfg.trainer.progress_bar,
            **cfg.clone.fit,
        )
        torch.save(actor.state_dict(), path.with_suffix(".part"))
        path.with_suffix(".part").rename(path)
        return actor.eval()


def judge_clone(
    cfg: DictConfig, clone: nn.Module, demonstrations: TensorDict, episodes: int = 100
) -> tuple[dict[str, Any], list[str]]:
    """Whether a clone drives as recorded, for it stands in for a demonstrator that cannot be asked again.

    Returns:
        Facts for the saved reward, and a reason if the median Fréchet distance to the recorded paths is too large.
    """
    first = (demonstrations["step"] == 0).nonzero().flatten()
    bounds = [*first.tolist(), len(demonstrations)]
    paths = [
        torch.cat([demonstrations["pose"][start:end], demonstrations["next", "pose"][end - 1 : end]])[:, :2]
        for start, end in pairwise(bounds[: episodes + 1])
    ]
    scenes = Scene.from_tensordict(demonstrations["scene"][first[:episodes]])
    world = build(cfg.world, device="cpu")
    rollouts = evaluate_policy(
        lambda observation, _: clone(observation),
        scenes,
        torch.zeros(1, 2),
        world=world,
        observe_human=cfg.env.observe_human,
        max_steps=cfg.env.max_steps,
    )
    median = frechet_distance(rollouts.path[0], paths).median().item()
    allowed = Thresholds().frechet
    reason = f"The clone drives {median:.2f} m off the recorded paths, at most {allowed} m is allowed."
    return {"clone": {"frechet": median, "episodes": len(paths)}}, [] if median <= allowed else [reason]


def make_ranked_rollouts(cfg: DictConfig, clone: nn.Module) -> TensorDict:
    """Roll the clone out under every noise level of the config."""
    bounds = bounds_of(_bare_env(cfg, 1))
    return roll_out_ranked(
        clone,
        lambda count: _bare_env(cfg, count, seed=cfg.seed + 1),
        lambda levels: build(cfg.ranking.noise, epsilon=levels, **bounds),
        list(cfg.ranking.levels),
        cfg.ranking.episodes,
        cfg.env.max_steps,
    )


def train_reward(cfg: DictConfig, clone: nn.Module, logger: Logger | None = None) -> nn.Module:
    """Learn a reward model from ranked roll-outs, or load it from the cache."""
    path = _reward_file(cfg)
    with _stage(cfg, "reward", path) as done:
        if not done:
            model, scores = _fit_reward(cfg, clone, logger)
            save_reward(model, path, {"held_out": scores})
        return load_reward(path)


def _fit_reward(cfg: DictConfig, clone: nn.Module, logger: Logger | None) -> tuple[nn.Module, dict[str, float]]:
    settings = cfg.ranking
    if settings.normalise and settings.levels[0] > 0:
        raise ValueError(
            f"ranking.normalise needs roll-outs without noise; begin ranking.levels with 0, not {settings.levels[0]}."
        )
    torch.manual_seed(cfg.seed)
    rollouts, env = make_ranked_rollouts(cfg, clone), _bare_env(cfg, 1)
    split = max(1, int((1 - settings.held_out) * settings.episodes))
    if split >= settings.episodes:
        raise ValueError(
            f"ranking.held_out={settings.held_out} keeps none of ranking.episodes={settings.episodes} per level to "
            f"choose the reward by; raise one of them."
        )
    train = SnippetPairs(rollouts[:, :split], settings.snippet)
    held_out = SnippetPairs(rollouts[:, split:], settings.snippet).sample(512)
    members = [
        build(
            settings.model,
            inputs=[key for key in inputs if key != "action" or settings.action],
            **bounds_of(env),
            features=make_features(settings.features, env),
        )
        for inputs in settings.members
    ]
    networks = [TensorDictModule(member, ["observation", "action"], ["reward"]) for member in members]
    loss = RankingLoss(networks, aggregate=settings.aggregate, temperature=settings.temperature)
    scores = fit(
        loss,
        lambda: torch.stack([train.sample(settings.batch_size) for _ in members]),
        held_out,
        name=_label(cfg, "reward"),
        logger=logger,
        progress_bar=cfg.trainer.progress_bar,
        **settings.fit,
    )
    model = RewardEnsemble(members, reduce=settings.reduce) if len(members) > 1 else members[0]
    if settings.normalise:
        mask = rollouts["mask"]
        clean = torch.zeros_like(mask)
        clean[0] = True
        model = NormalisedReward(model).fit(rollouts["observation"][mask], rollouts["action"][mask], clean[mask])
    return model, scores


def audit(cfg: DictConfig, directory: Path) -> dict[str, Any]:
    """Judge the reward in the cache, unless that was done; puts the report beside the run's reward."""
    report = stage_directory(cfg, *STAGES, f"objectives.{style_of(cfg)}", "audit")
    with _stage(cfg, "audit", report) as done:
        if not done:
            unfinished = report.with_suffix(".part")
            settings = {"num_scenes": cfg.audit.scenes, "scene_seed": cfg.audit.scene_seed, "plans": cfg.audit.plans}
            try:
                settings |= {"cfg": cfg, "directory": directory, "seed": cfg.seed}
                audit_run(_reward_file(cfg), unfinished, record=False, **settings)  # other runs share the reward
            except ValueError as error:  # a clone that never arrives cannot stand in for anybody
                unfinished.mkdir(parents=True, exist_ok=True)
                (unfinished / "audit.json").write_text(json.dumps({"passed": False, "reasons": [str(error)]}))
            unfinished.rename(report)
        shutil.copytree(report, style_directory(directory, style_of(cfg)) / "audit", dirs_exist_ok=True)
        return json.loads((report / "audit.json").read_text())


def _reward_file(cfg: DictConfig) -> Path:
    return stage_directory(cfg, *STAGES) / "reward.pt"


def _bare_env(cfg: DictConfig, num_envs: int, seed: int | None = None) -> NavigationEnv:
    """The environment with the analytical objectives, in which demonstrations and roll-outs are made."""
    return make_base_env(cfg, num_envs, seed, default_objectives())
