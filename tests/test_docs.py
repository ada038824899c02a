"""The pages' code runs, and what they say on the command line is understood."""

import argparse
import re
import runpy
import shlex
import sys
import tomllib
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.utils import get_object

from morlnav.cli import conf_dir
from morlnav.commands.train import main as morlnav_train
from morlnav.config import check, plain
from morlnav.runs.run import OF_THE_COMMAND, make_training

ROOT = Path(__file__).parents[1]
FENCE = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
PAGES = {page.stem: page.read_text() for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))}
EXTENDING = PAGES.pop("extending")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SCRIPTS = PROJECT["scripts"] | {"benchmarks": "benchmarks.__main__:main"}


def blocks(text, language, titled=False):
    found = [match.groups() for match in FENCE.finditer(text)]
    return [(title, code) for kind, title, code in found if kind == language and bool(title) is titled]


def commands(text):
    """Program and arguments of every command of ours."""
    lines = "".join(code for _, code in blocks(text, "bash")).replace("\\\n", "")
    found = re.findall(
        r"^(?:uv run (?:--(?:extra|group) [\w-]+ )?)?(morlnav-.*|python -m benchmarks(?: .*)?)$", lines, re.M
    )
    return [tuple(shlex.split(line.removeprefix("python -m "), comments=True)) for line in found]


def runs(words):
    """The overrides of the first and the last run of a sweep; of an interval, its ends."""
    first, last = [], []
    for override in OverridesParser.create().parse_overrides(words):
        choices = [override.input_line]
        if override.is_sweep_override():
            sweep = override.value()
            values = override.sweep_string_iterator() if override.is_discrete_sweep() else (sweep.start, sweep.end)
            choices = [f"{override.get_key_element()}={value}" for value in values]
        first.append(choices[0])
        last.append(choices[-1])
    return [first] if first == last else [first, last]


class Parsed(Exception):
    """Holds the arguments of a command that is not carried out."""


@pytest.fixture
def my_parts(tmp_path, monkeypatch):
    """A folder with the files that the page tells to write."""
    for title, code in [*blocks(EXTENDING, "python", titled=True), *blocks(EXTENDING, "yaml", titled=True)]:
        (tmp_path / title).parent.mkdir(parents=True, exist_ok=True)
        with (tmp_path / title).open("a") as file:
            file.write(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.syspath_prepend(ROOT / "tests" / "foreign")
    yield tmp_path
    sys.modules.pop("my_parts", None)


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(PAGES[page], "python") and page != "reuse"])
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    for folder in ("results", "examples"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    code = "\n".join(code for _, code in blocks(PAGES[page], "python"))
    exec(compile(code, page, "exec"), {})


@pytest.mark.parametrize("words", sorted(set(commands("\n".join(PAGES.values())))), ids=shlex.join)
def test_a_command_of_a_page_is_understood(words, monkeypatch):
    program, *overrides = words
    if program != "morlnav-train":
        parse = argparse.ArgumentParser.parse_intermixed_args

        def stop(parser, words=None):
            raise Parsed(parse(parser, words))

        monkeypatch.setattr(sys, "argv", list(words))
        for name in ("parse_args", "parse_intermixed_args"):
            monkeypatch.setattr(argparse.ArgumentParser, name, stop)
        with pytest.raises(Parsed) as parsed:
            get_object(SCRIPTS[program].replace(":", "."))()
        overrides = getattr(parsed.value.args[0], "overrides", [])
    for run in runs([word for word in overrides if word not in ("-m", "--help")]):
        check_as_a_run(composed(run))


def composed(words):
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return compose("train", words)


def check_as_a_run(cfg):
    """As a run does before it begins; classes that a page only imagines are left out."""
    config = {name: node for name, node in plain(cfg).items() if name not in OF_THE_COMMAND}
    if not any(name in str(config) for name in ("my_package.", "my_task.")):
        check(config)


def test_the_config_reference_tells_every_choice_and_what_its_arguments_mean():
    page = runpy.run_path(str(ROOT / "docs" / "hooks.py"))["_config_page"]()
    for file in ROOT.glob("conf/*/*.yaml"):
        assert f"### {file.parent.name}={file.stem}" in page
    assert "### world=tensor (default)" in page
    assert "| `goal_radius` | `0.35` | `0.35` | the goal counts as reached within this distance in metres. |" in page
    inherited = page[page.index("### world=pymunk") :]
    assert "| `step_time` |  | `0.2` | one control step in seconds (5 Hz). |" in inherited[: inherited.index("\n## ")]
    assert "| [`world`](#world) | `env.world` | pymunk, **tensor** |" in page
    assert ":class:" not in page


def test_the_tables_show_what_the_kept_runs_measured():
    tables = runpy.run_path(str(ROOT / "docs" / "tables.py"))
    for page in tables["TABLES"]:
        assert (ROOT / page).read_text() == tables["renewed"](page), "regenerate them: python docs/tables.py"


def test_the_quickstart_tells_every_extra():
    told = re.findall(r"^\| `([\w-]+)` \|", PAGES["quickstart"], re.MULTILINE)
    assert sorted(told) == sorted(PROJECT["optional-dependencies"])


def test_parts_of_ones_own_work_without_the_command_line(my_parts):
    exec("\n".join(code for _, code in blocks(EXTENDING, "python")), {})


@pytest.mark.parametrize("words", commands(EXTENDING)[:-1], ids=lambda words: words[-1])
def test_parts_of_ones_own_are_found_by_their_target(words, my_parts, tmp_path):
    words = words[1:]
    if "--config-dir" in words:
        words = [*words[2:], f"hydra.searchpath=[file://{my_parts}/{words[1]}]"]
    if not any(word.startswith(("objectives=", "env=")) for word in words):
        words = ["objectives=[baseline,distance,efficiency]", *words]
    cfg = composed([*words, "trainer=smoke"])
    check_as_a_run(cfg)
    make_training(cfg).rehearse(tmp_path)
    named = {target for word in words if (target := word.split("=")[-1]).startswith("my_parts.")}
    assert all(name in str(plain(cfg)) for name in named)


def test_all_of_them_train_together_and_load_if_trusted(my_parts, monkeypatch):
    monkeypatch.setattr(sys, "argv", [*commands(EXTENDING)[-1], "threads=1", "trainer.progress_bar=false"])
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    morlnav_train()
    monkeypatch.setattr(sys, "argv", ["morlnav-train", "resume=outputs/mine"])
    with pytest.raises(ValueError, match="foreign swapper"):
        morlnav_train()
    exec(compile((my_parts / "later.py").read_text(), "later.py", "exec"), {})
