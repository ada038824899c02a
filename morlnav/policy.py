"""Trained policies: saving and loading them without pickled code."""

from __future__ import annotations

from pathlib import Path

import torch
from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn
from yaml import YAMLError

from morlnav.envs.checks import require
from morlnav.modules import check_weights, load_reward, load_weights
from morlnav.trainers.builders import make_base_env, make_networks
from morlnav.trainers.styles import demonstrated_objectives, style_config, style_directory

POLICY_FILE = "policy.pt"
CONFIG_FILE = "config.yaml"
SUM_TOLERANCE = 1e-3
HARMLESS = ("morlnav.world.", "morlnav.envs.", "morlnav.modules.")
BUILT_ON_LOADING = ("world", "env", "objectives", "networks", "demonstrations.policy", "clone.actor")


class Policy(nn.Module):
    """A trained actor: ``policy(observation[..., 34], preference[..., n]) -> action[..., 2]`` in SI units.

    Inputs that make no sense are refused, though not once it is compiled or exported.

    Args:
        actor: the network.
        objectives: names of the preference's entries, in order.

    Examples:
        >>> from morlnav.modules import Actor
        >>> policy = Policy(Actor(2, [0.0, -3.14], [0.5, 3.14]), ("distance", "efficiency"))
        >>> policy(torch.zeros(8, 34), torch.tensor([0.5, 0.5])).shape
        torch.Size([8, 2])
    """

    def __init__(self, actor: nn.Module, objectives: tuple[str, ...]) -> None:
        super().__init__()
        self.actor = actor
        self.objectives = tuple(objectives)

    def forward(self, observation: Tensor, preference: Tensor) -> Tensor:
        """Actions ``(v, ω)`` in m/s and rad/s for raw observations; the preference broadcasts over them.

        Raises:
            ValueError: if the observation is not finite, or the preference no point of the simplex with one entry per
                objective.
        """
        if preference.shape[-1] != len(self.objectives):
            raise ValueError(f"A preference needs {len(self.objectives)} entries {self.objectives}.")
        if not (torch.compiler.is_compiling() or torch.jit.is_tracing()):
            _check_inputs(observation, preference)
        return self.actor(observation, preference.expand(*observation.shape[:-1], -1))


def _check_inputs(observation: Tensor, preference: Tensor) -> None:
    finite = observation.isfinite()
    require(
        finite.all(),
        "Observations must be finite",
        lambda: f"{observation[~finite][0].item()} in entry {int((~finite).nonzero()[0, -1])}",
    )
    point = ((preference >= 0).all(-1)) & ((preference.sum(-1) - 1).abs() <= SUM_TOLERANCE)  # NaN fails both
    require(
        point.all(),
        "The entries of a preference must be at least 0 and add up to 1",
        lambda: str([round(entry, 4) for entry in preference[~point].reshape(-1, preference.shape[-1])[0].tolist()]),
    )


def save(actor: nn.Module, directory: str | Path) -> None:
    """Write the actor's weights into a run directory.

    Raises:
        ValueError: if they are not finite.
    """
    check_weights(actor, "This policy")
    torch.save(actor.state_dict(), Path(directory) / POLICY_FILE)


def load_config(directory: str | Path, device: str = "cpu") -> DictConfig:
    """The config of a run, for use on ``device`` wherever it was trained.

    Raises:
        FileNotFoundError: if the directory holds no run.
        ValueError: if its config is damaged.

    Examples:
        >>> import tempfile
        >>> run = Path(tempfile.mkdtemp())
        >>> OmegaConf.save({"seed": 3, "device": "cuda"}, run / "config.yaml")
        >>> load_config(run)
        {'seed': 3, 'device': 'cpu'}
    """
    path = Path(directory) / CONFIG_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{directory} is not a run directory: it holds no {CONFIG_FILE}.")
    try:
        cfg = OmegaConf.load(path)
    except YAMLError as error:
        raise ValueError(f"{path} is damaged: it is no YAML.") from error
    cfg.device = device
    for name in demonstrated_objectives(cfg):
        if "device" in cfg.objectives[name].reward:
            cfg.objectives[name].reward.device = device
        reward = style_directory(path.parent, name) / "reward.pt"
        if reward.is_file():
            cfg.objectives[name].reward.path = str(reward)  # the run directory may have moved
    return cfg


def load(directory: str | Path, trust: bool = False, device: str = "cpu") -> Policy:
    """Load the policy of a run directory.

    Args:
        directory: where a run wrote its ``config.yaml`` and ``policy.pt``.
        trust: also build classes from outside ``morlnav`` that the config names. Only for runs of your
            own: building a class runs its code.
        device: where to put it, wherever it was trained.

    Returns:
        The averaged actor in evaluation mode.

    Raises:
        FileNotFoundError: if the run or its policy is missing.
        ValueError: if the config names foreign classes and is not trusted, or a file is damaged.

    Examples:
        >>> policy = load("results/default")  # doctest: +SKIP
        >>> policy.objectives  # doctest: +SKIP
        ('demo', 'distance', 'efficiency')
    """
    cfg = load_config(directory, device)
    if not trust:
        check_targets(cfg)
    path = Path(directory) / POLICY_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{directory} holds no {POLICY_FILE}: the run has not finished; continue it first.")
    for name in demonstrated_objectives(cfg):
        cfg.objectives[name].reward = None  # driving needs no reward
    env = make_base_env(cfg, num_envs=1)
    actor, _ = make_networks(cfg, env)
    return Policy(load_weights(actor, path, device), env.objectives).requires_grad_(False).eval()


def check_targets(node: DictConfig) -> None:
    """Refuse a config from which loading would build classes from outside this package.

    Raises:
        ValueError: naming the foreign class.

    Examples:
        >>> check_targets(OmegaConf.create({"world": {"_target_": "elsewhere.World"}}))
        Traceback (most recent call last):
        ValueError: This run uses the foreign class elsewhere.World; if it is your own, load it with trust=True.
    """
    for name in dict.fromkeys(["demo", *demonstrated_objectives(node)]):
        view = style_config(node, name)
        for part in BUILT_ON_LOADING:
            if (value := OmegaConf.select(view, part)) is not None:
                _check(part, OmegaConf.to_container(value, resolve=False) if OmegaConf.is_config(value) else value)


def _check(key: str, value: object) -> None:
    if isinstance(value, dict):
        for name, child in value.items():
            _check(name, child)
    elif isinstance(value, list):
        for child in value:
            _check(key, child)
    elif key == "_target_" and not _is_ours(str(value)):
        raise ValueError(f"This run uses the foreign class {value}; if it is your own, load it with trust=True.")
    elif isinstance(value, str) and "${" in value:  # runs are saved resolved, and a resolver could make up a class
        raise ValueError(f"The config of a run holds no interpolation, but {key} is {value}; load it with trust=True.")


def _is_ours(path: str) -> bool:
    """Whether ``path`` names a class of the packages that policies are made of, which do nothing when they are built.

    The path alone does not tell: ``morlnav.policy.Path`` begins well and ends elsewhere.
    """
    if not path.startswith("morlnav."):
        return False
    try:
        target = get_object(path)
    except (ImportError, AttributeError, ValueError):
        return False
    if target is load_reward:  # reads weights and numbers, and builds three known classes
        return True
    return isinstance(target, type) and target.__module__.startswith(HARMLESS)
