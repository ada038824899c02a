"""Reward models on disk: weights without pickled code, and their facts as readable JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from morlnav.modules.networks import NavigationFeatures
from morlnav.modules.reward_model import NormalisedReward, RewardEnsemble, RewardModel
from morlnav.modules.weights import check_weights

CLASSES = {cls.__name__: cls for cls in (RewardModel, RewardEnsemble, NormalisedReward)}


def save_reward(model: nn.Module, path: str | Path, facts: Mapping[str, Any] | None = None) -> None:
    """Write a reward model as two files: its weights into ``path`` and what it is into the same name with ``.json``.

    Args:
        model: a :class:`RewardModel`, or any nesting of ensembles and normalisations of them.
        path: of the weights, such as ``reward.pt``; its directory is made.
        facts: anything worth knowing that JSON can hold, such as the result of an audit.

    Raises:
        ValueError: for a model made of other classes, or weights that are not finite.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "reward.pt"
        >>> save_reward(NormalisedReward(RewardModel(depth=1), low=0.25), path, {"audit": {"passed": True}})
        >>> load_reward(path).low
        tensor(0.2500)
        >>> read_facts(path)["facts"]
        {'audit': {'passed': True}}
    """
    check_weights(model, "This reward")
    description = {"inputs": list(getattr(model, "inputs", ())), "model": _describe(model), "facts": dict(facts or {})}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _describe_file(path, description)
    unfinished = path.with_name(f"{path.name}.part")
    torch.save(model.state_dict(), unfinished)
    unfinished.replace(path)  # last, and at once: where the weights are, they are whole, and so is the rest


def write_facts(path: str | Path, facts: Mapping[str, Any]) -> None:
    """Replace the facts of a saved reward model; its weights stay as they are.

    Raises:
        FileNotFoundError: if one of the two files is missing.
        ValueError: if the description is damaged.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "reward.pt"
        >>> save_reward(RewardModel(depth=1), path)
        >>> write_facts(path, {"audit": {"passed": True}})
        >>> read_facts(path)["facts"]
        {'audit': {'passed': True}}
    """
    _describe_file(Path(path), read_facts(path) | {"facts": dict(facts)})


def _describe_file(path: Path, description: Mapping[str, Any]) -> None:
    text = json.dumps(description, indent=2)  # first, for it may fail
    path.with_suffix(".json").write_text(text + "\n")


def load_reward(path: str | Path, device: torch.device | str = "cpu") -> nn.Module:
    """The reward model of :func:`save_reward`, frozen: in evaluation mode, without gradients for its weights.

    Only classes of this package are built and nothing is unpickled, so files of strangers do no harm.

    Args:
        path: of the weights.
        device: where to put them.

    Raises:
        FileNotFoundError: if one of the two files is missing.
        ValueError: if a file is damaged, names another class, or the two do not belong together.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "reward.pt"
        >>> save_reward(RewardModel(depth=1), path)
        >>> load_reward(path)(torch.zeros(4, 34), torch.zeros(4, 2)).shape
        torch.Size([4])
    """
    model = _build(read_facts(path)["model"], path)
    return load_weights(model, path, device).requires_grad_(False)


def load_weights(model: nn.Module, path: str | Path, device: torch.device | str = "cpu") -> nn.Module:
    """The model with the weights that a file holds, in evaluation mode; nothing is unpickled.

    Args:
        model: takes the weights.
        path: of a ``state_dict``.
        device: where to put the model.

    Raises:
        ValueError: if the file is damaged, holds the weights of another model, or weights that are not finite.

    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "linear.pt"
        >>> torch.save(nn.Linear(2, 1).state_dict(), path)
        >>> load_weights(nn.Linear(2, 1), path)
        Linear(in_features=2, out_features=1, bias=True)
    """
    try:
        model.load_state_dict(torch.load(path, weights_only=True, map_location=device))
    except Exception as error:  # a damaged file may raise anything in torch's reader
        raise ValueError(f"{path} does not hold the weights of this {type(model).__name__}.") from error
    check_weights(model, str(path))
    return model.to(device).eval()


def read_facts(path: str | Path) -> dict[str, Any]:
    """What is known of a saved reward model: ``inputs``, ``model`` (with its normalisation) and ``facts``.

    Raises:
        FileNotFoundError: if one of the two files is missing.
        ValueError: if the description is damaged.
    """
    description = Path(path).with_suffix(".json")
    for file in (Path(path), description):
        if not file.is_file():
            raise FileNotFoundError(f"There is no {file}; a reward model is two files, {path} and {description.name}.")
    try:
        facts = json.loads(description.read_text())
        return {key: facts[key] for key in ("inputs", "model", "facts")}
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{description} does not describe a reward model; save the model again.") from error


def _describe(model: nn.Module) -> dict[str, Any]:
    if type(model) not in CLASSES.values():
        raise ValueError(f"A saved reward is made of {', '.join(CLASSES)}, got {type(model).__name__}.")
    config = model.config()
    if "model" in config:
        config["model"] = _describe(config["model"])
    if "models" in config:
        config["models"] = [_describe(member) for member in config["models"]]
    return {"class": type(model).__name__, **config}


def _build(node: Mapping[str, Any], path: str | Path) -> nn.Module:
    try:
        config = dict(node)
        cls = CLASSES[config.pop("class")]
        if "features" in config:
            config["features"] = NavigationFeatures(**config["features"])
        if "model" in config:
            config["model"] = _build(config["model"], path)
        if "models" in config:
            config["models"] = [_build(member, path) for member in config["models"]]
        return cls(**config)
    except (KeyError, TypeError) as error:
        raise ValueError(f"The .json of {path} describes no reward model made of {', '.join(CLASSES)}.") from error
