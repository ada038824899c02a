"""From a config to parts: Hydra's ``_target_`` with live objects, and nothing that a config names is ignored.

A node of a config has a ``_target_`` and arguments of what it names. Some arguments cannot stand in a file, such as the
number of objectives or an environment: these *live objects* are handed to every part that names an argument so.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import math
import re
import typing
from collections.abc import Callable, Collection, Mapping
from typing import Any, ClassVar, Generic, TypeVar

from hydra.utils import get_object
from omegaconf import OmegaConf
from omegaconf.errors import MissingMandatoryValue

from morlnav.annotations import describe, fits, held_by, is_kind, makes, members, with_article
from morlnav.sentences import causes, first_line, nearest
from morlnav.signature import Signature

T = TypeVar("T")
SPECIAL = ("_target_", "_partial_", "_convert_", "_recursive_")


class ConfigError(ValueError):
    """What is wrong with a config, in one sentence that names the key."""


class Part(Generic[T]):
    """A node that is built when its live objects are there, and anew at each call.

    An argument that is annotated as ``Part[Kind]`` gets one in place of a built ``Kind``. Without a config any callable
    serves, such as a class.

    Args:
        node: with a ``_target_``.
        where: name of the node, for messages.

    Examples:
        >>> layer = Part({"_target_": "torch.nn.Linear", "out_features": 2}, "layer")
        >>> layer(in_features=3, device="cpu", seed=0)  # takes what it names, and leaves the rest
        Linear(in_features=3, out_features=2, bias=True)
    """

    is_lazy: ClassVar[bool] = True

    def __init__(self, node: Mapping[str, Any], where: str) -> None:
        self.node, self.where = node, where

    def __call__(self, **live: Any) -> T:
        """Build the part."""
        return build(self.node, self.where, **live)

    def replace(self, **values: Any) -> Part[T]:
        """The same part with other values in its node."""
        return Part({**self.node, **values}, self.where)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.where}: {self.node.get('_target_')})"


def part(target: Callable[..., Any], **arguments: Any) -> Part:
    """A part without a config: a class or function, and arguments that may be parts themselves.

    Live objects reach all of them, as if the whole stood in a file.

    >>> from torch import nn
    >>> part(nn.Linear, out_features=2)(in_features=3, seed=0)
    Linear(in_features=3, out_features=2, bias=True)
    """
    name = f"{target.__module__}.{target.__qualname__}"
    return Part({"_target_": name, **{key: _node(value) for key, value in arguments.items()}}, target.__qualname__)


def as_part(value: Any, where: str) -> Any:
    """A node, or a mapping of nodes, as :class:`Part`; anything else as it is.

    >>> as_part({"_target_": "torch.nn.Identity"}, "features")
    Part(features: torch.nn.Identity)
    """
    value = plain(value)
    if _is_node(value) or isinstance(value, Part):
        return Part(_node(value), where)
    if isinstance(value, Mapping):
        return {name: as_part(child, _join(where, name)) for name, child in value.items()}
    return value


def takes(part: Part | Callable[..., Any]) -> list[str]:
    """Names of the arguments that a part takes.

    >>> takes(Part({"_target_": "torch.nn.Identity"}, "features")), takes(lambda a, b: a)
    ([], ['a', 'b'])
    """
    return list(_signature(part).parameters)


def setting(part: Part | Callable[..., Any], name: str) -> Any:
    """What a part will get for an argument that no live object gives: its node's value, or the default.

    Raises:
        ValueError: if it has none.

    Examples:
        >>> setting(Part({"_target_": "torch.nn.Linear", "bias": False}, "layer"), "bias")
        False
    """
    given = part.node if isinstance(part, Part) else getattr(part, "keywords", {})
    if name in given:
        return given[name]
    parameter = _signature(part).parameters.get(name)
    if parameter is None or parameter.default is parameter.empty:
        raise ConfigError(f"{_join(part.where, name) if isinstance(part, Part) else name} is missing.")
    return parameter.default


def supply(part: Part[T] | Callable[..., T], **live: Any) -> T:
    """Build a part, or call any other factory, with those live objects that it names and has not got.

    >>> from functools import partial
    >>> supply(partial(round, ndigits=1), number=0.25, ndigits=0, seed=0)
    0.2
    """
    if isinstance(part, Part):
        return part(**live)
    names, bound = takes(part), getattr(part, "keywords", {})
    return part(**{name: value for name, value in live.items() if name in names and name not in bound})


def classes(part: Part | Callable[..., Any]) -> list[str]:
    """Full names of the classes that a part is made of, wherever its node found them.

    >>> classes(Part({"_target_": "morlnav.modules.Actor", "features": {"_target_": "morlnav.modules.Flat"}}, "actor"))
    ['morlnav.modules.networks.Actor', 'morlnav.modules.networks.Flat']
    """
    if isinstance(part, Part):
        of_children = [classes(Part(child, part.where)) for child in part.node.values() if _is_node(child)]
        return [*classes(_signature(part).target), *(name for names in of_children for name in names)]
    target = getattr(part, "func", part)
    return [f"{target.__module__}.{target.__qualname__}"]


def plain(node: Any) -> Any:
    """A config as dicts and lists, with every interpolation resolved.

    >>> plain(OmegaConf.create({"a": 1, "b": "${a}"}))
    {'a': 1, 'b': 1}
    """
    if not OmegaConf.is_config(node):
        return node
    try:
        return OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except MissingMandatoryValue as error:
        raise ConfigError(f"{error.full_key} is missing; give it as {error.full_key}=VALUE.") from error


def build(node: Any, where: str = "", /, **live: Any) -> Any:
    """Build what a node names, its children first; every part also gets the live objects that it names as arguments.

    Args:
        node: a config or part of one; values that are no nodes stay as they are.
        where: name of the node, for messages.
        live: objects by the name of the argument that takes them. What the node itself gives goes before them.

    Raises:
        ValueError: in one sentence that names the key: for unknown keys, targets that are not there, missing or wrong
            values, and whatever a constructor refuses.

    Examples:
        >>> build({"_target_": "torch.nn.Linear", "out_features": 2}, in_features=3, seed=0)
        Linear(in_features=3, out_features=2, bias=True)
        >>> build({"_target_": "torch.nn.Linear", "out_feature": 2}, "layer", in_features=3)
        Traceback (most recent call last):
        morlnav.config.ConfigError: layer.out_feature is no argument of torch.nn.Linear; did you mean out_features?
    """
    node = plain(node)
    return _Walk(live, {} if where else node, call=True)(node, where, Any)


def check(node: Any, where: str = "", live: Collection[str] = (), kind: Any = Any) -> None:
    """Refuse a config whose parts could not be built, without building any.

    Args:
        node: a config or part of one.
        where: name of the node, for messages.
        live: names of the live objects that there will be.
        kind: what the node should become.

    Raises:
        ValueError: as :func:`build` would, but for what only a constructor can tell.
    """
    node = plain(node)
    _Walk(live, {} if where else node, call=False)(node, where, kind)


class _Walk:
    """Goes through a config beside the annotations that say what becomes of each value.

    Args:
        live: live objects by name, or their names; ``None`` where they are known later.
        root: the whole config, one of whose keys a misplaced one may have meant.
        call: whether to build.
    """

    def __init__(self, live: Collection[str] | None, root: Any, call: bool) -> None:
        self.live, self.root, self.call = live, root, call

    def __call__(self, value: Any, where: str, hint: Any) -> Any:
        """What a value becomes where an annotation asks for ``hint``."""
        if _is_node(value):
            return self._node(value, where, hint)
        if value is not None and not isinstance(value, bool | int | float | str | dict | list):
            return value  # an object, which no file holds
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"{where} must be a finite number, got {value}.")
        kinds = held_by(value, hint) if isinstance(value, dict | list) else None
        if kinds is None and (isinstance(value, dict | list) or not fits(value, hint)):
            raise ConfigError(f"{where or 'A config'} must be {describe(hint)}, got {_shown(value)}.")
        if isinstance(value, dict):
            return {n: self(v, _join(where, n), kind) for (n, v), kind in zip(value.items(), kinds, strict=True)}
        if isinstance(value, list):
            return [self(v, f"{where}[{i}]", kind) for i, (v, kind) in enumerate(zip(value, kinds, strict=True))]
        return value

    def _node(self, node: dict[str, Any], where: str, hint: Any) -> Any:
        lazy = [member for member in members(hint) if is_kind(member, Part)]
        if lazy:
            _Walk(None, self.root, call=False)(node, where, (*typing.get_args(lazy[0]), Any)[0])
            return Part(node, where)
        part, partial = _signature(Part(node, where)), bool(node.get("_partial_"))
        if not partial and (made := makes(part.target, part.hints.get("return"), hint)):
            raise ConfigError(
                f"{_join(where, '_target_')} must make {describe(hint)}, but {part.name} makes {with_article(made)}."
            )
        given = {name: self(value, _join(where, name), self._hint(part, name, where))
                 for name, value in node.items() if name not in SPECIAL}  # fmt: skip
        known = part.required if self.live is None else self.live
        missing = [name for name in part.required if name not in given and name not in known]
        if missing and not partial:
            raise ConfigError(f"{_join(where, missing[0])} is missing; {part.name} needs it.")
        if not self.call:
            return None
        given |= {name: self.live[name] for name in part.parameters if name in self.live and name not in given}
        call = functools.partial(_call, part, where, **given)
        return call if partial else call()

    def _hint(self, part: Signature, name: str, where: str) -> Any:
        """What an argument asks for; unknown ones are refused."""
        if name in part.parameters or part.open:
            return part.hints.get(name, Any)
        meant = f"did you mean {name} at the root?" if where and name in self.root else nearest(name, part.parameters)
        raise ConfigError(f"{_join(where, name)} is no argument of {part.name}; {meant}")


def _signature(part: Part | Callable[..., Any]) -> Signature:
    """What a part takes; a target that cannot be had is refused."""
    if not isinstance(part, Part):
        return Signature(part)
    name, key = part.node["_target_"], _join(part.where, "_target_")
    if not isinstance(name, str):
        raise ConfigError(f"{key} must be the name of a class or function, got {_shown(name)}.")
    try:
        target = get_object(name)
    except Exception as error:
        raise ConfigError(f"{key}: there is no {name} ({first_line(causes(error)[-1])}){_beside(name)}") from error
    if not callable(target):
        raise ConfigError(f"{key}: {name} is a {type(target).__name__}, which cannot be called.")
    return Signature(target, name)


def _call(signature: Signature, where: str, /, *args: Any, **arguments: Any) -> Any:
    """Call a target; what it refuses is said with the key."""
    try:
        return signature.target(*args, **arguments)
    except (ConfigError, OSError):  # say where already
        raise
    except Exception as error:
        message = first_line(error)
        if not isinstance(error, TypeError | ValueError):
            message = f"{type(error).__name__}: {message}"
        separator = "." if re.split(r"[^\w]", message)[0] in signature.parameters else ": "
        raise ConfigError(f"{where}{separator}{message}" if where else message) from error


def _beside(name: str) -> str:
    """What a module holds whose name is nearest to one that it does not hold."""
    module, _, wanted = name.rpartition(".")
    try:
        names = [key for key, value in vars(importlib.import_module(module)).items() if callable(value)]
        close = difflib.get_close_matches(wanted, names, 1)
    except Exception:
        close = []
    return f"; did you mean {module}.{close[0]}?" if close else "."


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else str(name)


def _is_node(value: Any) -> bool:
    return isinstance(value, dict) and "_target_" in value


def _node(value: Any) -> Any:
    if isinstance(value, Part):
        return value.node
    if isinstance(value, Mapping):
        return {name: _node(child) for name, child in value.items()}
    return [_node(child) for child in value] if isinstance(value, list | tuple) else value


def _shown(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, dict):
        return f"the node of {value['_target_']}" if _is_node(value) else "a mapping without _target_"
    return repr(value)
