"""The default training in Python, without Hydra, is that of the config."""

import re
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from support import assert_identical

from morlnav.cli import conf_dir
from morlnav.config import Part, _signature, plain
from morlnav.runs import make_training

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text()
CODE = dict(re.findall(r'^```python title="(\w+.py)"\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE))
TINY = {  # sizes of the page, and of a run in seconds
    "num_envs=128": "num_envs=16",
    "frames_per_batch=128, init_random_frames=5120": "frames_per_batch=16, init_random_frames=64",
    "part(DREX,": "part(DREX, num=4,",
    "total_frames=200_000": "total_frames=128, optim_steps_per_batch=2, checkpoint_interval=64, progress_bar=False",
    "steps=3000": "steps=2",
    "part(RewardAudit)": "None",
    "drives=200": "drives=1, num_envs=4, horizon=5",
    "part(Ranking,": "part(Ranking, episodes=2, held_out=0.5, members=[['observation'], ['observation', 'action']],",
    "steps=1500": "steps=2",
    "max_steps=250": "max_steps=100",
    "720_000": "4096",
    "part(NavigationEnv,": "part(NavigationEnv, scenes=part(SceneSampler, distance=[5, 6]),",
}
WORDS = (
    "env.num_envs=16",
    "env.scenes.distance=[5,6]",
    "collector.frames_per_batch=16",
    "collector.init_random_frames=64",
    "trainer.total_frames=128",
    "trainer.optim_steps_per_batch=2",
    "trainer.checkpoint_interval=64",
    "trainer.progress_bar=false",
    "rewards.num=4",
    "rewards.clone.fit.steps=2",
    "rewards.audit=null",
    "refinement={drives: 1, num_envs: 4, horizon: 5}",
    "rewards.ranking.episodes=2",
    "rewards.ranking.held_out=0.5",
    "rewards.ranking.members=[[observation],[observation,action]]",
    "rewards.ranking.fit.steps=2",
    "cache=null",
    "transforms.time_limit.max_steps=100",
    "replay.storage.max_size=4096",
)


def configured(words):
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return make_training(plain(compose("train", list(words))))


def by_hand(code):
    scope = {}
    exec(code, scope)
    return scope["training"]


def filled(node):
    """A node with its class and all defaults, so that what is left out counts as what it stands for."""
    if isinstance(node, Part):
        return filled(node.node)
    if isinstance(node, list | tuple):
        return [filled(child) for child in node]
    if not isinstance(node, dict):
        return node
    children = {name: filled(child) for name, child in node.items()}
    if "_target_" not in node:
        return {name: child for name, child in children.items() if child is not None}
    part = _signature(Part(node, ""))
    defaults = {name: filled(p.default) for name, p in part.parameters.items() if p.default is not p.empty}
    return defaults | children | {"_target_": f"{part.target.__module__}.{part.target.__qualname__}"}


BUILT_BY_DEFAULT = {
    "env": ("world", "scenes", "objectives"),
    "stepper": ("optimizer_actor", "optimizer_critic", "target_net_updater", "schedule"),
}
PARTS = "transforms preferences actor critic loss exploration replay collector trainer hooks rewards evaluation logger"


def test_it_takes_twenty_lines():
    assert len(CODE["training.py"].split("\n\n", 1)[1].strip().splitlines()) <= 20


@pytest.mark.parametrize("name", [*PARTS.split(), "env", "stepper"])
def test_its_parts_are_those_of_the_config(name):
    mine, theirs = filled(getattr(by_hand(CODE["training.py"]), name)), filled(getattr(configured([]), name))
    for built in BUILT_BY_DEFAULT.get(name, ()):
        mine.pop(built), theirs.pop(built)
    assert mine == theirs


def test_its_first_checkpoint_is_that_of_the_config_bit_for_bit(tmp_path):
    code = "from morlnav.navigation.world import SceneSampler\n" + CODE["training.py"]
    for size, tiny in TINY.items():
        assert size in code
        code = code.replace(size, tiny)
    weights, policies = [], []
    for name, training in (("python", by_hand(code)), ("config", configured(WORDS))):
        directory = tmp_path / name
        learned = training.learn_rewards(directory)
        trainer = training.make_trainer(directory, learned, None)
        trainer.train()
        trainer.collector.shutdown()
        weights.append([file.read_bytes() for file in sorted((directory / "checkpoints").rglob("*.memmap"))])
        policies.append(training.finish(trainer, learned).state_dict())
    assert weights[0]
    assert weights[0] == weights[1]
    assert_identical(*policies)
