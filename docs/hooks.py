"""What the site generates when it is built: config reference, API pages, notebooks with their pictures, and MathML."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import griffe
import yaml
from hydra import compose, initialize_config_dir
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

ROOT = Path(__file__).resolve().parents[1]
CONF = ROOT / "conf"
CONFIG_INTRO = """# Config reference

`morlnav-train GROUP=CHOICE` swaps a part, `KEY=VALUE` changes a value. Every key has the name of the argument that it
fills, of what `_target_` names. Below each file stand these arguments, with the file's value and the constructor's own
default; what has neither is a live object, handed over by the program. `morlnav-train --cfg job` prints the whole
config of a run, `morlnav-train GROUP=CHOICE --cfg job` that of another.

| group | fills | choices, the default one in bold |
| :-- | :-- | :-- |
"""
FIRST = (
    "recipe",
    "trainer",
    "env",
    "world",
    "objectives",
    "demonstrations",
    "rewards",
    "clone",
    "ranking",
    "audit",
    "loss",
)
"""Groups that come first in the reference; the others follow in the order in which a run is composed."""
ROOMS = (
    ("Learning", ("objectives", "modules", "transforms", "data", "trainers", "evaluation")),
    ("Runs and robots", ("deployment", "runs", "analysis", "record", "config")),
    (
        "Social navigation",
        ("envs", "world", "modules", "demonstrations", "audit", "evaluation", "record", "deployment"),
    ),
)
"""Pages of the API in their order, the last group in ``morlnav.navigation``."""
BESIDE = {"deployment": ("context", "export"), "navigation.evaluation": ("sweep",)}
"""Modules whose names a room does not hand on, because most users of the room do without them."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Fill the navigation's ``API`` with a page for every room of the package."""
    api: dict[str, list] = {title: [] for title, _ in ROOMS}
    for title, name, path, _ in _api_pages():
        api[title].append({name: path})
    next(entry for entry in config.nav if "API" in entry)["API"] = [{title: pages} for title, pages in api.items()]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages: dict[str, str | bytes] = {path: content for _, _, path, content in _api_pages()}
    pages["config.md"] = _config_page()
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        pages |= _notebook_page(notebook)
    for image in ("trajectories", "metrics"):
        pages[f"images/{image}.png"] = (ROOT / "results/default/evaluation" / f"{image}.png").read_bytes()
    for image in (ROOT / "results/paper").glob("*.png"):
        pages[image.name] = image.read_bytes()  # beside the page that includes the report
    for path, content in pages.items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_content(content: str, **_: Any) -> str:
    """Turn LaTeX into MathML, which browsers draw without a script."""

    def mathml(match: re.Match) -> str:
        drawn = convert(html.unescape(match[3]), display="block" if match[2] == "[" else "inline")
        return f"<{match[1]} class='math'>{drawn}</{match[1]}>"

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


def _api_pages() -> Iterator[tuple[str, str, str, str]]:
    """Group, name, path and content of the page of every room."""
    for title, names in ROOMS:
        inner = "navigation." if title == ROOMS[-1][0] else ""
        for name in names:
            room = f"{inner}{name}"
            yield title, name, f"api/{room}.md", f"# {room}\n\n{_room(room)}"


def _room(room: str) -> str:
    path = ROOT / "morlnav" / room.replace(".", "/")
    if not path.is_dir():
        return f"::: morlnav.{room}\n"
    named = "__all__" in (path / "__init__.py").read_text()
    parts = [f"::: morlnav.{room}\n"] if named else []
    for module in BESIDE.get(room, ()) if named else sorted(file.stem for file in path.glob("[!_]*.py")):
        name = f"morlnav.{room}.{module}"
        parts.append(f"## {name}\n\n::: {name}\n    options: {{heading_level: 3}}\n")
    return "\n".join(parts)


def _config_page() -> str:
    package = griffe.load(
        "morlnav", search_paths=[str(ROOT)], extensions=griffe.load_extensions(Roles), resolve_aliases=True
    )
    defaults = _defaults()
    groups = dict.fromkeys(
        [*FIRST, *reversed(defaults), *(folder.name for folder in sorted(CONF.iterdir()) if folder.is_dir())]
    )
    found = {group: files for group in groups if (files := sorted((CONF / group).glob("*.yaml")))}
    index = [_index_row(group, files, defaults.get(group, [])) for group, files in found.items()]
    text = (CONF / "train.yaml").read_text()
    root = text[text.index("_target_:") : text.index("hydra:")].strip()
    parts = [CONFIG_INTRO + "\n".join(index), "", f"## Outside of groups\n\n```yaml\n{root}\n```\n"]
    parts.append(_arguments(package, yaml.safe_load(root)))
    for group, files in found.items():
        chosen = defaults.get(group, [])
        parts.append(f"## {group}\n")
        for file in sorted(files, key=lambda file: (file.stem not in chosen, file.stem)):
            parts.append(_config_file(package, group, file, file.stem in chosen))
    return "\n".join(parts)


def _defaults() -> dict[str, list[str]]:
    """What the default run chooses of every group, in the order in which it is composed."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        choices = compose("train", return_hydra_config=True).hydra.runtime.choices
    chosen: dict[str, list[str]] = {}
    for group, choice in choices.items():
        if not group.startswith("hydra/") and choice is not None:
            words = re.findall(r"\w+", str(choice))
            chosen.setdefault(group.split("@")[0], []).extend(words)
    return chosen


def _package(group: str, file: Path) -> str:
    """The key that a file fills."""
    match = re.match(r"# @package (\S+)", file.read_text())
    return {None: group, "_global_": "any key"}.get(match and match[1], match and match[1])


def _index_row(group: str, files: list[Path], chosen: list[str]) -> str:
    choices = [f"**{file.stem}**" if file.stem in chosen else file.stem for file in files]
    fills = ", ".join(dict.fromkeys(f"`{_package(group, file)}`" for file in files)).replace("`any key`", "any key")
    return f"| [`{group}`](#{group}) | {fills} | {', '.join(choices)} |"


def _config_file(package: griffe.Module, group: str, file: Path, default: bool) -> str:
    text = file.read_text()
    comment = re.match(r"(# @package .*\n)?((?:#.*\n)*)", text)
    body = text[comment.end() :].strip()
    parts = [f"### {group}={file.stem}{' (default)' if default else ''}\n", comment[2].replace("# ", "")]
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
    try:
        target = package[path.removeprefix("morlnav.")]
    except KeyError:
        return f"`{path}`\n"
    target = target.final_target if target.is_alias else target
    meanings = _meanings(target)
    rows = [
        f"| `{parameter.name}` | {_value(node, parameter.name)} | {_code(parameter.default)} | "
        f"{meanings.get(parameter.name, '')} |"
        for parameter in target.parameters
        if parameter.name != "self" and not str(parameter.name).startswith("*")
    ]
    link = f'<autoref identifier="{path}" optional><code>{path}</code></autoref>'  # some need an extra to be on a page
    if not rows:
        return f"{link}\n"
    head = [link, "", "| argument | here | default | meaning |", "| :-- | :-- | :-- | :-- |"]
    return "\n".join([*head, *rows, ""])


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
