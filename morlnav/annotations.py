"""Whether what a config holds is what an annotation asks for, and annotations in words."""

from __future__ import annotations

import collections.abc
import inspect
import math
import types
import typing
from collections.abc import Callable
from os import PathLike
from typing import Any, TypeVar

WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "a word", type(None): "null"}


def members(hint: Any) -> tuple[Any, ...]:
    """The alternatives of a union, or the one that there is.

    >>> members(int | None), members(int)
    ((<class 'int'>, <class 'NoneType'>), (<class 'int'>,))
    """
    if isinstance(hint, TypeVar):
        return members(hint.__bound__) if hint.__bound__ else hint.__constraints__ or (Any,)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return tuple(inner for member in typing.get_args(hint) for inner in members(member))
    return (type(None) if hint is None else hint,)


def is_kind(hint: Any, kind: type) -> bool:
    """Whether an annotation, which is no union, asks for a ``kind`` or what is derived from it.

    >>> is_kind(dict[str, int], collections.abc.Mapping), is_kind(int, collections.abc.Mapping)
    (True, False)
    """
    origin = typing.get_origin(hint) or hint
    return inspect.isclass(origin) and issubclass(origin, kind)


def _holds(hint: Any, kind: type) -> bool:
    """Whether an annotation, which is no union, is of a ``kind`` of container that a file has."""
    origin = typing.get_origin(hint) or hint
    return is_kind(hint, kind) and not is_kind(hint, str) and origin.__module__ in ("builtins", "collections.abc")


def fits(value: float | str | None, hint: Any) -> bool:
    """Whether a value that holds no others is what an annotation asks for; numbers must be finite.

    >>> fits(1, float), fits(1.5, int), fits(True, int), fits(None, int | None), fits(float("nan"), float)
    (True, False, False, True, False)
    """
    if isinstance(value, float) and not math.isfinite(value):
        return False
    return any(_fits_one(value, member) for member in members(hint))


def _fits_one(value: float | str | None, hint: Any) -> bool:
    if typing.get_origin(hint) is typing.Literal:
        return any(value == choice and type(value) is type(choice) for choice in typing.get_args(hint))
    kind = typing.get_origin(hint) or hint
    if kind in (bool, str, type(None)):
        return isinstance(value, kind)
    if kind in (int, float):
        return isinstance(value, int if kind is int else int | float) and not isinstance(value, bool)
    if kind is Any or kind is object or not inspect.isclass(kind):
        return True
    if kind.__name__ in ("Tensor", "ndarray"):
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, str) and (kind.__name__ == "device" or issubclass(kind, PathLike))


def held_by(value: dict | list, hint: Any) -> list[Any] | None:
    """What an annotation asks of each value in a mapping or list; ``None`` if it asks for something else.

    >>> held_by([1, 2], tuple[int, float]), held_by({"a": 1}, dict[str, int] | None), held_by([1], dict)
    ([<class 'int'>, <class 'float'>], [<class 'int'>], None)
    """
    wanted = collections.abc.Mapping if isinstance(value, dict) else collections.abc.Collection
    for member in members(hint):
        inner = typing.get_args(member)
        if member is Any or member is object or getattr(member, "__name__", "") in ("Tensor", "ndarray"):
            return [Any] * len(value)
        if not _holds(member, wanted) or (isinstance(value, list) and _holds(member, collections.abc.Mapping)):
            continue
        if is_kind(member, tuple) and inner and inner[-1] is not Ellipsis:
            if len(inner) == len(value):
                return list(inner)
            continue
        of_each = inner[1] if len(inner) == 2 and isinstance(value, dict) else inner[0] if inner else Any
        return [of_each] * len(value)
    return None


def makes(target: Callable[..., Any], returns: Any, hint: Any) -> str | None:
    """The name of what a target makes if an annotation surely asks for something else.

    >>> makes(dict, None, collections.abc.Sequence), makes(list, None, collections.abc.Sequence)
    ('dict', None)
    """
    made = target if inspect.isclass(target) else typing.get_origin(returns) or returns
    if not inspect.isclass(made) or any(_may_be(made, member) for member in members(hint)):
        return None
    return made.__name__


def _may_be(made: type, hint: Any) -> bool:
    kind = typing.get_origin(hint) or hint
    if not inspect.isclass(kind) or Any in (kind, made):
        return True
    if getattr(kind, "_is_protocol", False):
        return "__call__" not in vars(kind) or issubclass(made, collections.abc.Callable)
    return issubclass(made, kind)


def describe(hint: Any) -> str:
    """An annotation in words.

    >>> describe(float | None), describe(list[int]), describe(tuple[float, float])
    ('a number or null', 'a list (each a whole number)', 'a list of 2 (each a number)')
    """
    return " or ".join(dict.fromkeys(_describe_one(member) for member in members(hint)))


def _describe_one(hint: Any) -> str:
    kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if hint in WORDS:
        return WORDS[hint]
    if kind is typing.Literal:
        return f"one of {', '.join(map(str, inner))}"
    if _holds(kind, collections.abc.Mapping):
        return "a mapping" + (f" (each {describe(inner[1])})" if inner and inner[1] is not Any else "")
    if _holds(kind, collections.abc.Collection):
        number = f" of {len(inner)}" if kind is tuple and inner and inner[-1] is not Ellipsis else ""
        return f"a list{number}" + (f" (each {describe(inner[0])})" if inner and inner[0] is not Any else "")
    if getattr(kind, "is_lazy", False):
        return describe(inner[0]) if inner else "a node with a _target_"
    return with_article(getattr(kind, "__name__", str(kind)))


def with_article(name: str) -> str:
    """A noun with its article.

    >>> with_article("Actor"), with_article("Linear")
    ('an Actor', 'a Linear')
    """
    return f"a{'n' if name[0] in 'AEIOU' else ''} {name}"
