"""What a class or function takes, and with which annotations."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from typing import Any


class Signature:
    """What a class or function takes. One that passes ``**settings`` on to its base takes what the base takes.

    Args:
        target: the class or function.
        name: what messages call it; by default its own.

    Attributes:
        parameters: by name.
        hints: annotations by the name of the parameter, and of what is returned by ``"return"``.
        required: names of parameters without a default.
        open: whether it takes more by names that nothing tells.

    Examples:
        >>> signature = Signature(dict.fromkeys)
        >>> signature.name, signature.open
        ('dict.fromkeys', False)
    """

    def __init__(self, target: Callable[..., Any], name: str = "") -> None:
        self.name, self.target, self.open = name or getattr(target, "__qualname__", repr(target)), target, True
        self.parameters: dict[str, inspect.Parameter] = {}
        self.hints: dict[str, Any] = {}
        own = [vars(cls)["__init__"] for cls in getattr(target, "__mro__", ()) if "__init__" in vars(cls)]
        for callee in own if inspect.isclass(target) else [target]:
            if self.open:
                self._add(callee, skip=inspect.isclass(target))
        self.required = [name for name, p in self.parameters.items() if p.default is p.empty]

    def _add(self, callee: Callable[..., Any], skip: bool) -> None:
        if callee is object.__init__:
            return
        parameters, hints = list(inspect.signature(callee).parameters.values())[skip:], _hints(callee)
        self.open = any(p.kind is p.VAR_KEYWORD for p in parameters)
        for p in parameters:
            if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL) and p.name not in self.parameters:
                hint = hints.get(p.name, Any)
                self.parameters[p.name], self.hints[p.name] = p, hint | None if p.default is None else hint
        self.hints.setdefault("return", hints.get("return", Any))


def _hints(callee: Callable[..., Any]) -> dict[str, Any]:
    try:
        return typing.get_type_hints(callee)
    except Exception:  # some of the names are there for type checkers alone
        scope, found = getattr(inspect.unwrap(callee), "__globals__", {}), {}
        for name, annotation in getattr(callee, "__annotations__", {}).items():
            try:
                found[name] = eval(annotation, scope) if isinstance(annotation, str) else annotation
            except Exception:
                found[name] = Any
        return found
