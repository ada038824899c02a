"""Demonstrated objectives: each learns its reward from demonstrations of the run, or of its own."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn

from morlnav.modules import load_weights
from morlnav.navigation.demonstrations import demonstrations_digest
from morlnav.navigation.envs import default_objectives
from morlnav.navigation.evaluation import reference_paths
from morlnav.navigation.world import Scene, World, without_human
from morlnav.trainers.builders import bounds_of, build, make_base_env, make_features

# In a config, so that stages come from the cache only as long as the recording is the same.
OmegaConf.register_new_resolver("demonstrations_digest", demonstrations_digest, replace=True)
# A recording may be used as it is, with no number asked for.
OmegaConf.register_new_resolver("or", lambda value, other: other if value is None else value, replace=True)

CLONE_FILE = "clone.pt"
DEMONSTRATED = "morlnav.navigation.envs.DemonstrationObjective"


def demonstrated_objectives(cfg: DictConfig) -> list[str]:
    """Names of the objectives that come from demonstrations, in order.

    Raises:
        ValueError: for a name that is no identifier, since folders and config groups go by it.
    """
    names = [name for name, node in cfg.get("objectives", {}).items() if node.get("_target_") == DEMONSTRATED]
    for name in names:
        if not name.isidentifier():
            raise ValueError(f"The name of a demonstrated objective must be an identifier, got {name}.")
    return names


def style_config(cfg: DictConfig, name: str) -> DictConfig:
    """The config as the objective ``name`` sees it, which is told by its ``style``.

    The groups in ``styles.name`` take the place of those of the run; whatever learns ``demo`` learns any objective.
    Rewards are learned on the CPU, for their networks are small.
    """
    view = copy.deepcopy(cfg)
    OmegaConf.set_struct(view, False)
    view.style = name
    view.device = "cpu"
    own = (cfg.get("styles") or {}).get(name)
    for group, node in (OmegaConf.to_container(own, resolve=True) if own else {}).items():
        view[group] = node
    return view


def style_of(cfg: DictConfig) -> str:
    """The objective that a config is seen by; ``demo`` sees that of the run."""
    return OmegaConf.select(cfg, "style", default="demo")


def style_directory(directory: str | Path, name: str) -> Path:
    """Where a run keeps reward, audit and clone of an objective: ``demo`` in the run directory, others below it."""
    return Path(directory) if name == "demo" else Path(directory) / "styles" / name


def make_clone(cfg: DictConfig) -> nn.Module:
    """The untrained network that clones a demonstrator."""
    env = make_base_env(cfg, 1, objectives=default_objectives())
    features = make_features(cfg.networks.features, env)
    return build(cfg.clone.actor, num_preferences=0, **bounds_of(env), features=features)


def make_demonstrator(cfg: DictConfig, directory: Path) -> Callable[[Tensor], Tensor] | None:
    """Who drives as demonstrated: the policy that was recorded or, where none was, the clone that the run keeps.

    Args:
        cfg: of the run, as the objective sees it.
        directory: of the run.

    Returns:
        A policy on raw observations, ``None`` if there is neither.
    """
    policy = OmegaConf.select(cfg, "demonstrations.policy")
    if policy is not None:
        return build(policy)
    weights = style_directory(directory, style_of(cfg)) / CLONE_FILE
    if not weights.is_file():
        return None
    clone = load_weights(make_clone(cfg), weights).requires_grad_(False)
    return on_whole_observations(cfg, lambda observation: clone.to(observation.device)(observation))


def on_whole_observations(cfg: DictConfig, policy: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """The policy on observations that hold the human's position, whether it sees that or not."""
    return policy if cfg.env.observe_human else lambda observation: policy(without_human(observation))


def demonstrated_paths(
    cfg: DictConfig, scenes: Scene, world: World, directory: Path, names: Sequence[str] | None = None
) -> dict[str, list[Tensor]]:
    """A demonstrator's path ``[L, 2]`` in each scene, to measure Fréchet distances to, where it can drive there.

    Args:
        cfg: of the run.
        scenes: batched ``[S]``.
        world: where to drive.
        directory: of the run.
        names: objectives; by default ``demo``, whether it is one or not, and all demonstrated ones.

    Returns:
        Paths by the name of the objective.
    """
    paths = {}
    for name in dict.fromkeys(["demo", *demonstrated_objectives(cfg)] if names is None else names):
        demonstrator = make_demonstrator(style_config(cfg, name), directory)
        if demonstrator is None:
            continue
        try:
            paths[name] = reference_paths(scenes, demonstrator, world=world, max_steps=cfg.env.max_steps)
        except ValueError as error:
            print(f"No Fréchet distances to the demonstration of {name}: {error}")
    return paths
