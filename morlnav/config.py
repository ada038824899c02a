"""From a config to parts: Hydra's ``_target_`` with live objects, and nothing that a config names is ignored.

A node of a config has a ``_target_`` and arguments of what it names. Some arguments cannot stand in a file, such as the
number of objectives or an environment: these *live objects* are handed to every part that names an argument so.
"""

from __future__ import annotations

import collections.abc
import difflib
import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Collection, Mapping
from typing import Any, Generic, TypeVar

from hydra.utils import get_object
from omegaconf import MissingMandatoryValue, OmegaConf
from torch import nn

T = TypeVar("T")
SPECIAL = ("_target_", "_partial_", "_convert_", "_recursive_")


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


def as_part(value: Any, where: str) -> Any:
    """A node, or a mapping of nodes, as :class:`Part`; anything else as it is.

    >>> as_part({"_target_": "torch.nn.Identity"}, "features")
    Part(features: torch.nn.Identity)
    """
    value = plain(value)
    if _is_node(value):
        return Part(value, where)
    if isinstance(value, Mapping):
        return {name: as_part(child, _join(where, name)) for name, child in value.items()}
    return value


def takes(part: Part | Callable[..., Any]) -> list[str]:
    """Names of the arguments that a part takes.

    >>> takes(Part({"_target_": "torch.nn.Identity"}, "features")), takes(lambda a, b: a)
    ([], ['a', 'b'])
    """
    if isinstance(part, Part):
        return _Signature.of(part.node, part.where).names
    return list(inspect.signature(part).parameters)


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
    target = _Signature.of(part.node, part.where).target if isinstance(part, Part) else part
    parameter = inspect.signature(target).parameters.get(name)
    if parameter is None or parameter.default is parameter.empty:
        where = f"{part.where}.{name}" if isinstance(part, Part) else name
        raise ValueError(f"{where} is missing.")
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


def plain(node: Any) -> Any:
    """A config as dicts and lists, with every interpolation resolved.

    Raises:
        ValueError: if a value is missing.

    >>> plain(OmegaConf.create({"a": 1, "b": "${a}"}))
    {'a': 1, 'b': 1}
    """
    if not OmegaConf.is_config(node):
        return node
    try:
        return OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except MissingMandatoryValue as error:
        raise ValueError(f"{error.full_key} is missing; it has no default.") from error


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
        ValueError: layer.out_feature is no argument of torch.nn.Linear; did you mean out_features?
    """
    node = plain(node)
    if isinstance(node, list):
        return [build(child, f"{where}[{i}]", **live) for i, child in enumerate(node)]
    if not isinstance(node, dict):
        return node
    if "_target_" not in node:
        return {name: build(child, _join(where, name), **live) for name, child in node.items()}
    signature = _Signature.of(node, where)
    given: dict[str, Any] = {}
    for name, value in node.items():
        if name not in SPECIAL:
            given[name] = signature.take(name, value, where, lambda child, key: build(child, key, **live))
    given |= {name: live[name] for name in signature.names if name in live and name not in given}
    if node.get("_partial_"):
        return lambda *args, **more: signature.call(where, *args, **(given | more))
    return signature.call(where, **given)


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
    if isinstance(node, list):
        for i, child in enumerate(node):
            check(child, f"{where}[{i}]", live, _inner(kind))
    if not isinstance(node, dict):
        return
    if "_target_" not in node:
        for name, child in node.items():
            check(child, _join(where, name), live, _inner(kind))
        return
    signature = _Signature.of(node, where)
    signature.check_kind(kind, where)
    for name, value in node.items():
        if name not in SPECIAL:
            signature.take(
                name, value, where, lambda child, key, hint=signature.hint(name): check(child, key, live, hint)
            )
    missing = [name for name in signature.required if name not in node and name not in live]
    if missing and not node.get("_partial_"):
        raise ValueError(f"{_join(where, missing[0])} is missing; {signature.name} needs it.")


class _Signature:
    """What a target takes."""

    def __init__(self, name: str, target: Callable[..., Any]) -> None:
        self.name, self.target = name, target
        callee = target.__init__ if inspect.isclass(target) else target
        parameters = list(inspect.signature(callee).parameters.values())[inspect.isclass(target) :]
        self.open = any(p.kind is p.VAR_KEYWORD for p in parameters)
        parameters = [p for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
        self.names = [p.name for p in parameters]
        self.required = [p.name for p in parameters if p.default is p.empty]
        try:
            self.hints = typing.get_type_hints(callee)
        except Exception:  # names that exist for type checkers alone
            self.hints = {}

    @classmethod
    def of(cls, node: Mapping[str, Any], where: str) -> _Signature:
        name = node["_target_"]
        try:
            target = get_object(name)
        except Exception as error:
            raise ValueError(f"{_join(where, '_target_')}: there is no {name} ({_cause(error)}).") from error
        if not callable(target):
            raise ValueError(
                f"{_join(where, '_target_')}: {name} is a {type(target).__name__}, which cannot be called."
            )
        return cls(name, target)

    def hint(self, name: str) -> Any:
        return self.hints.get(name, Any)

    def take(self, name: str, value: Any, where: str, descend: Callable[[Any, str], Any]) -> Any:
        """The argument that a value of the config becomes."""
        key, hint = _join(where, name), self.hint(name)
        if name not in self.names and not self.open:
            raise ValueError(f"{key} is no argument of {self.name}; {nearest(name, self.names)}")
        if _is_node(value) and _is_part(hint):
            check(value, key, _ANY, _inner(hint))
            return Part(value, key)
        if isinstance(value, dict) and _is_part(_inner(hint)):
            for child, node in value.items():
                if _is_node(node):
                    check(node, _join(key, child), _ANY, _inner(_inner(hint)))
            return {child: Part(node, _join(key, child)) if _is_node(node) else node for child, node in value.items()}
        if not _holds_node(value) and not fits(value, hint):
            raise ValueError(f"{key} must be {describe(hint)}, got {value!r}.")
        return descend(value, key)

    def check_kind(self, kind: Any, where: str) -> None:
        made = self.target if inspect.isclass(self.target) else self.hints.get("return", Any)
        members = _members(kind)
        wanted = [typing.get_origin(cls) or cls for cls in members]
        known = all(inspect.isclass(cls) and cls is not Any and not getattr(cls, "_is_protocol", 0) for cls in wanted)
        if made is Any or not inspect.isclass(made) or not known:
            return
        if not any(issubclass(made, cls) for cls in wanted if cls is not collections.abc.Callable) and not (
            collections.abc.Callable in wanted and "__call__" in dir(made)
        ):
            raise ValueError(
                f"{_join(where, '_target_')} must make {describe(kind)}, but {self.name} makes a {made.__name__}."
            )

    def call(self, where: str, *args: Any, **arguments: Any) -> Any:
        missing = [name for name in self.required[len(args) :] if name not in arguments]
        if missing:
            raise ValueError(f"{_join(where, missing[0])} is missing; {self.name} needs it.")
        try:
            return self.target(*args, **arguments)
        except (TypeError, ValueError) as error:
            if not where or re.match(rf"{re.escape(where)}\b", str(error)):  # a child of it was named
                raise ValueError(str(error)) from error
            raise ValueError(f"{where}: {error}") from error


class _Any:
    """Every name is there: which live objects a part is built with is known later."""

    def __contains__(self, _: object) -> bool:
        return True


_ANY: Any = _Any()


def nearest(name: str, names: Collection[str]) -> str:
    """What may have been meant by a name that is none of ``names``.

    >>> nearest("totl_frames", ["total_frames", "seed"]), nearest("foo", ["a", "b"])
    ('did you mean total_frames?', 'choose from: a, b.')
    """
    close = difflib.get_close_matches(name, names, 1)
    return f"did you mean {close[0]}?" if close else f"choose from: {', '.join(names) or 'nothing'}."


def fits(value: Any, hint: Any) -> bool:
    """Whether a value of a config is what an argument's annotation asks for; numbers must be finite.

    >>> fits(1, float), fits(1.5, int), fits(True, int), fits(None, int | None), fits([0.5, 1], tuple[float, float])
    (True, False, False, True, True)
    """
    if isinstance(value, float) and not math.isfinite(value):
        return False
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, member) for member in inner)
    if origin is typing.Literal:
        return value in inner
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint in (bool, str):
        return isinstance(value, hint)
    if hint in (None, type(None)):
        return value is None
    kind = origin or hint
    if inspect.isclass(kind) and kind is not str and issubclass(kind, collections.abc.Mapping):
        return isinstance(value, dict) and all(fits(child, inner[1]) for child in value.values() if inner)
    if inspect.isclass(kind) and issubclass(kind, collections.abc.Sequence | collections.abc.Set):
        if not isinstance(value, list):
            return False
        fixed = kind is tuple and inner and inner[-1] is not Ellipsis
        wanted = inner if fixed else [inner[0] if inner else Any] * len(value)
        return len(wanted) == len(value) and all(map(fits, value, wanted))
    if hint is Any or isinstance(hint, TypeVar) or not inspect.isclass(kind):
        return True
    if kind.__module__.startswith(("torch", "numpy")) and kind.__name__ in ("Tensor", "ndarray"):
        return isinstance(value, int | float | list) and not isinstance(value, bool)
    if kind.__name__ in ("Path", "PurePath", "device"):
        return isinstance(value, str)
    ours = kind.__module__.startswith("morlnav") or issubclass(kind, nn.Module)
    return not ours or isinstance(value, kind)  # other libraries know what else they take


def describe(hint: Any) -> str:
    """An annotation in words.

    >>> describe(float | None), describe(list[int])
    ('a number or null', 'a list (each a whole number)')
    """
    names = {float: "a number", int: "a whole number", bool: "true or false", str: "a word", type(None): "null"}
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if hint in names:
        return names[hint]
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(describe, inner)))
    if origin is typing.Literal:
        return f"one of {', '.join(map(str, inner))}"
    kind = origin or hint
    if kind is Part:
        return f"a node that makes {describe(inner[0])}"
    if inspect.isclass(kind) and issubclass(kind, collections.abc.Mapping):
        return "a mapping" + (f" (each {describe(inner[1])})" if inner else "")
    if inspect.isclass(kind) and issubclass(kind, collections.abc.Sequence):
        return "a list" + (f" (each {describe(inner[0])})" if inner and inner[0] is not Any else "")
    return f"a {getattr(kind, '__name__', kind)}"


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _is_node(value: Any) -> bool:
    return isinstance(value, dict) and "_target_" in value


def _holds_node(value: Any) -> bool:
    children = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return _is_node(value) or any(map(_holds_node, children))


def _members(hint: Any) -> list[Any]:
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return [member for member in (typing.get_args(hint) if union else [hint]) if member is not type(None)]


def _is_part(hint: Any) -> bool:
    return any((typing.get_origin(member) or member) is Part for member in _members(hint))


def _inner(hint: Any) -> Any:
    """Of what kind the members of a container are, or what a part makes."""
    for member in _members(hint):
        if inner := typing.get_args(member):
            return inner[-1] if inner[-1] is not Ellipsis else inner[0]
    return Any


def _cause(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    return str(error).splitlines()[0] if str(error) else type(error).__name__
