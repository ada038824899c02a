"""What the site generates when it is built: config reference, API pages, notebooks with their pictures, and MathML."""

from __future__ import annotations

import html
import inspect
import json
import re
import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import griffe
import yaml
from hydra.utils import get_object
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter
from omegaconf import OmegaConf

with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # TorchRL's about itself
    from morlnav.configs import CONFIGS

ROOT = Path(__file__).parents[1]
CONF = ROOT / "conf"
CONFIG_INTRO = """# Config reference

`morlnav-train GROUP=CHOICE KEY=VALUE` swaps parts and changes values; the defaults of a group come first. Every key has
the name of the argument that it fills, of the class or function that `_target_` names; below each file stand those
arguments, with the value of the file and the constructor's own default. What has neither is filled in by the program.
The configs [for TorchRL's trainers](#for-torchrls-trainers) follow at the end.
"""
REGISTERED_INTRO = """## For TorchRL's trainers

`import morlnav.configs` registers the following in TorchRL's Hydra groups and in groups of our own, for use in
[its trainers](reuse.md#by-config-in-torchrls-trainers): `+GROUP=NAME` on the command line, or `GROUP@KEY: NAME` in a
defaults list. Values of `???` must be given. `_partial_: true` leaves a part unbuilt, as a callable.
"""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Fill the navigation's ``API`` with a page for every room of the package."""
    next(entry for entry in config.nav if "API" in entry)["API"] = [{name: path} for name, path, _ in _api_pages()]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages: dict[str, str | bytes] = {path: content for _, path, content in _api_pages()}
    pages["config.md"] = _config_page()
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        pages |= _notebook_page(notebook)
    for image in ("trajectories", "metrics"):
        pages[f"images/{image}.png"] = (ROOT / "results/default/evaluation" / f"{image}.png").read_bytes()
    for path, content in pages.items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_content(content: str, **_: Any) -> str:
    """Turn LaTeX into MathML, which browsers draw without a script."""

    def mathml(match: re.Match) -> str:
        return convert(html.unescape(match[3]), display="block" if match[2] == "[" else "inline")

    return re.sub(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', mathml, content, flags=re.DOTALL)


class Roles(griffe.Extension):
    """Docstrings name things by Sphinx's roles, :class:`X`; links take their place where the target is on the site."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite one docstring."""

        def link(match: re.Match) -> str:
            name = match[2]
            short = name.rsplit(".", 1)[-1] if match[1] else name
            with suppress(griffe.NameResolutionError):
                name = obj.resolve(name)
            return f'<autoref identifier="{name}" optional><code>{short}</code></autoref>'

        if obj.docstring:
            obj.docstring.value = re.sub(r":\w+:`(~?)([\w.]+)`", link, obj.docstring.value)


def _notebook_page(notebook: Path) -> dict[str, str | bytes]:
    exporter = MarkdownExporter()
    text, resources = exporter.from_filename(str(notebook), {"output_files_dir": notebook.stem})
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)
    text = text.replace('<table border="1" class="dataframe">', "<table>")  # the theme's tables
    return {f"notebooks/{notebook.stem}.md": text} | {
        f"notebooks/{name}": image for name, image in resources["outputs"].items()
    }


def _api_pages() -> list[tuple[str, str, str]]:
    """Name, path and content of a page for each package, and of one for the modules beside them."""
    package = ROOT / "morlnav"
    folders = [path.parent for path in sorted(package.glob("*/__init__.py"))]
    pages = [
        (folder.name, f"::: morlnav.{folder.name}" if (folder / "__init__.py").read_text() else _modules(folder))
        for folder in folders
    ]
    pages.append(("tools", _modules(package)))
    return [(name, f"api/{name}.md", f"# {name}\n\n{content}") for name, content in pages]


def _modules(folder: Path) -> str:
    paths = [path.relative_to(ROOT).with_suffix("") for path in sorted(folder.glob("[!_]*.py"))]
    names = [".".join(path.parts) for path in paths]
    return "\n".join(f"## {name}\n\n::: {name}\n    options: {{heading_level: 3}}\n" for name in names)


def _config_page() -> str:
    extensions = griffe.load_extensions(Roles)
    package = griffe.load("morlnav", search_paths=[str(ROOT)], extensions=extensions, resolve_aliases=True)
    train = (CONF / "train.yaml").read_text()
    top = train[train.index("seed:") : train.index("hydra:")]
    parts = [CONFIG_INTRO, f"## Values outside of groups\n\n```yaml\n{top.strip()}\n```\n"]
    for entry in yaml.safe_load(train)["defaults"]:
        if entry == "_self_":
            continue
        ((group, default),) = entry.items()
        default = default if isinstance(default, list) else [default]
        parts.append(f"## {group}\n")
        for file in sorted((CONF / group).glob("*.yaml"), key=lambda file: (file.stem not in default, file.stem)):
            parts.append(_config_file(package, group, file, file.stem in default))
    parts.append(REGISTERED_INTRO)
    parts += [_registered(package, *key, CONFIGS[key]) for key in sorted(CONFIGS)]
    return "\n".join(parts)


def _config_file(package: griffe.Module, group: str, file: Path, default: bool) -> str:
    text = file.read_text()
    comment = re.match(r"(# @package .*\n)?((?:#.*\n)*)", text)[2]
    body = text.replace(comment, "", 1).strip()
    parts = [f"### {group}={file.stem}{' (default)' if default else ''}\n", comment.replace("# ", "")]
    parts += [f"```yaml\n{body}\n```\n"] if body else []
    for node in _targets(yaml.safe_load(body)):
        parts.append(_arguments(package, node))
    return "\n".join(parts)


def _targets(node: Any) -> Iterator[dict[str, Any]]:
    """Every mapping in a config that names a ``_target_``, the outer one first."""
    if isinstance(node, dict):
        if "_target_" in node:
            yield node
        node = list(node.values())
    if isinstance(node, list):
        for child in node:
            yield from _targets(child)


def _arguments(package: griffe.Module, node: dict[str, Any]) -> str:
    """A table of the arguments of a ``_target_``, unless it is another package's."""
    path = node["_target_"]
    if not path.startswith("morlnav."):
        return ""
    target = package[path.removeprefix("morlnav.")]
    target = target.final_target if target.is_alias else target
    meanings = _meanings(target)
    rows = [
        f"| `{parameter.name}` | {_value(node, parameter.name)} | {_code(parameter.default)} | "
        f"{meanings.get(parameter.name, '')} |"
        for parameter in target.parameters
        if parameter.name != "self"
    ]
    link = f'<autoref identifier="{path}" optional><code>{path}</code></autoref>'  # some need an extra to be on a page
    if not rows:
        return f"{link}\n"
    head = [link, "", "| argument | here | default | meaning |", "| :-- | :-- | :-- | :-- |"]
    return "\n".join([*head, *rows, ""])


def _registered(package: griffe.Module, group: str, name: str, config: type) -> str:
    """A table of the fields of a dataclass in Hydra's ``ConfigStore``."""
    node = OmegaConf.to_container(OmegaConf.structured(config))
    target = inspect.unwrap(get_object(node["_target_"]))
    meanings = _meanings(_ours(package, target)) if target.__module__.startswith("morlnav.") else {}
    rows = [
        f"| `{field.name}` | `{field.type}` | {_value(node, field.name)} | {meanings.get(field.name, '')} |"
        for field in fields(config)
        if not field.name.startswith("_")
    ]
    summary = _ours(package, config).docstring.parse("google")[0].value
    head = ["| field | type | default | meaning |", "| :-- | :-- | :-- | :-- |"]
    return "\n".join([f"### {group}={name}", "", summary, "", *head, *rows, ""])


def _ours(package: griffe.Module, target: type) -> griffe.Class | griffe.Function:
    return package[f"{target.__module__}.{target.__qualname__}".removeprefix("morlnav.")]


def _meanings(target: griffe.Class | griffe.Function) -> dict[str, str]:
    """What the docstrings of a function, or of a class and those that it inherits from, say of their arguments."""
    meanings: dict[str, str] = {}
    for part in [target, *(target.mro() if target.is_class else [])]:
        for section in part.docstring.parse("google") if part.docstring else []:
            if section.kind is griffe.DocstringSectionKind.parameters:
                for entry in section.value:
                    meanings.setdefault(entry.name, " ".join(entry.description.split()))
    return meanings


def _value(node: dict[str, Any], name: str) -> str:
    """What a config gives for an argument; an ellipsis where that has a table of its own."""
    if name not in node:
        return ""
    value = node[name]
    if isinstance(value, dict) or (isinstance(value, list) and any(isinstance(item, dict) for item in value)):
        return "…"
    return _code(value if isinstance(value, str) else json.dumps(value))


def _code(text: str | None) -> str:
    return "" if text is None else f"`{text}`"
