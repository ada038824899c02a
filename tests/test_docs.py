"""The pages' code runs, and what they say on the command line is understood."""

import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from tensordict.nn import TensorDictModule

import morlnav
from morlnav.cli import conf_dir
from morlnav.data import PreferenceSampler
from morlnav.train import main as morlnav_train
from morlnav.trainers import make_base_env, make_loss, make_networks, make_preferences

ROOT = Path(__file__).parents[1]
FENCE = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
EXTENDING = (ROOT / "docs" / "extending.md").read_text()


def blocks(text, language, titled=False):
    found = [match.groups() for match in FENCE.finditer(text)]
    return [(title, code) for kind, title, code in found if kind == language and bool(title) is titled]


def commands(text):
    lines = "".join(code for _, code in blocks(text, "bash")).replace("\\\n", "").splitlines()
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("morlnav-train")]


@pytest.fixture
def my_parts(tmp_path, monkeypatch):
    """A folder with the files that the page tells to write."""
    for title, code in [*blocks(EXTENDING, "python", titled=True), *blocks(EXTENDING, "yaml", titled=True)]:
        (tmp_path / title).parent.mkdir(parents=True, exist_ok=True)
        with (tmp_path / title).open("a") as file:
            file.write(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("my_parts", None)


@pytest.mark.parametrize("page", ["quickstart", "concepts"])
def test_the_code_of_a_page_runs(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    code = "\n".join(code for _, code in blocks((ROOT / "docs" / f"{page}.md").read_text(), "python"))
    assert code
    exec(compile(code, f"{page}.md", "exec"), {})


def test_the_config_reference_tells_every_choice_and_what_its_arguments_mean():
    page = runpy.run_path(str(ROOT / "docs" / "hooks.py"))["_config_page"]()
    for file in ROOT.glob("conf/*/*.yaml"):
        assert f"### {file.parent.name}={file.stem}" in page
    assert "### world=tensor (default)" in page
    assert "| `goal_radius` | `0.35` | `0.35` | the goal counts as reached within this distance in metres. |" in page
    inherited = page[page.index("### world=pymunk") : page.index("## env")]
    assert "| `step_time` |  | `0.2` | one control step in seconds (5 Hz). |" in inherited


def test_parts_of_ones_own_work_without_the_command_line(my_parts):
    exec("\n".join(code for _, code in blocks(EXTENDING, "python")), {})


@pytest.mark.parametrize("words", commands(EXTENDING)[:-1], ids=lambda words: words[-1])
def test_parts_of_ones_own_are_found_by_their_target(words, my_parts):
    if "--config-dir" in words:
        words = [*words[2:], f"hydra.searchpath=[file://{my_parts}/{words[1]}]"]
    if not any(word.startswith("objectives=") for word in words):
        words = ["objectives=[baseline,distance,efficiency]", *words]
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        cfg = compose("train", words)
    env = make_base_env(cfg, num_envs=2)
    actor, critics = make_networks(cfg, env)
    loss = make_loss(cfg, env, TensorDictModule(actor, ["observation", "preference"], ["action"]), critics)
    preferences = make_preferences(cfg, len(env.objectives))
    parts = [env.world, loss, preferences, *env.rewards.values()]
    ours = {f"{type(part).__module__}.{type(part).__name__}" for part in parts}
    named = {target for word in words if (target := word.split("=")[-1]).startswith("my_parts.")}
    assert named <= ours
    assert isinstance(preferences, PreferenceSampler)
    assert env.rollout(2)["next", "reward"].shape == (2, 2, len(env.rewards))


def test_all_of_them_train_together_and_load_if_trusted(my_parts, monkeypatch):
    words = [*commands(EXTENDING)[-1], "threads=1", "trainer.progress_bar=false"]
    monkeypatch.setattr(sys, "argv", ["morlnav-train", *words])
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    morlnav_train()
    with pytest.raises(ValueError, match="foreign class my_parts"):
        morlnav.load("outputs/mine")
    exec(compile((my_parts / "later.py").read_text(), "later.py", "exec"), {})
