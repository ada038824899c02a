"""The config groups say what their classes take, with the classes' own defaults, and serve other projects."""

import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from morlnav.cli import conf_dir
from morlnav.config import Part, _signature

CHECKOUT = Path(__file__).parents[1]
CONF = Path(conf_dir())
CHANGES = ("recipe", "ablation", "brief", "domain")  # what differs from the other groups' values

LIVE = {
    "rewards",
    "objectives",
    "num_rewards",
    "num_objectives",
    "num_static",
    "reward_bounds",
    "action_spec",
    "action_low",
    "action_high",
    "size",
    "max_steps",
    "world",
    "scenes",
    "robot",
    "step_time",
    "observe_human",
    "sectors",
    "lidar_range",
    "max_turn",
    "seed",
    "device",
    "sampler",
    "make_env",
    "offset",
    "actor_network",
    "qvalue_network",
    "clones",
    "loss",
    "actor",
    "total_updates",
    "spec",
    "std",
    "annealing_num_steps",
    "generator",
    "collector",
    "loss_module",
    "optimization_stepper",
    "replay_buffer",
    "logger",
    "directory",
    "components",
    "trainer",
    "policy",
    "exploration",
    "evaluation",
    "total_frames",
    "demonstrators",
    "scalarisation",
    "inputs",
    "epsilon",
    "cache",
    "config",
    "progress_bar",
}
LEFT_OUT = {  # arguments that have a default and no place in a file
    "bounds": "the action's, in place of its spec",
    "preference_key": "keys are those of the training",
    "next_key": "keys are those of the training",
    "action_key": "keys are those of the training",
    "safe": "actions are clamped",
    "mean": "of a noise",
    "preferences": "keys of the interpolator, a grid by default",
    "values": "of the keys",
    "weights": "the loss attaches its scalarisation",
    "preference_scale": "a clone sees no preference",
    "max_tries": "of the scene sampler",
    "comparisons": "ranking=compared brings them",
}
ANOTHER_VALUE = {  # where a class serves twice, or Python wants something else than the command line
    "env/mo_gymnasium:.num_envs": "a training drives several, a user of the class one",
    "env/navigation:.num_envs": "one environment without a batch, as TorchRL's",
    "collector/ray:.init_random_frames": "TorchRL's own defaults",
    "collector/ray:.num_collectors": "TorchRL's own defaults",
    "collector/ray:.sync": "TorchRL's own defaults",
    "collector/ray:.update_after_each_batch": "TorchRL's own defaults",
    "train:.cache": "a folder of the command line's",
    "objectives/baseline:.env.objectives.baseline.static": "sums are tuneable, but for the baseline",
    "preferences/balanced:.corner": "another choice of the same class",
    "preferences/balanced:.edge": "another choice of the same class",
    "preferences/keys:.noise": "another choice of the same class",
    "critic/navigation:.afterstate.lookahead": "looks at a lidar, which not every robot has",
    "demonstrations/slow_pass:.policy.clockwise": "the other side",
    "demonstrations/wait:.policy.clockwise": "the other side",
    "clone/mlp:.fit.weight_decay": "Fit serves the ranking too",
    "clone/mlp:.fit.interval": "Fit serves the ranking too",
    "ranking/recommended:.fit.patience": "Fit serves the clone too",
    "ranking/recommended:.model.features.use_lidar": "boxes are no part of a demonstration",
    "ranking/recommended:.model.features.octaves": "features serve the actor too",
}


def nodes(value, where=""):
    """Every node of a file, and where it is."""
    if isinstance(value, dict):
        if value.get("_target_", "???") != "???":
            yield where, value
        value = {f".{name}": child for name, child in value.items()}
    elif isinstance(value, list):
        value = {f"[{i}]": child for i, child in enumerate(value)}
    else:
        return
    for name, child in value.items():
        yield from nodes(child, f"{where}{name}")


def all_nodes():
    for path in sorted(CONF.rglob("*.yaml")):
        name = str(path.relative_to(CONF).with_suffix(""))
        content = OmegaConf.load(path)
        for where, node in nodes(OmegaConf.to_container(content)):
            if name == "train" and not where:
                node = {key: child for key, child in node.items() if key not in COMMAND}
            yield pytest.param(name, where, node, "defaults" in content, id=f"{name}:{where}")


COMMAND = ("defaults", "threads", "resume", "trust", "hydra")


def alike(given, default):
    if isinstance(given, list) and isinstance(default, list | tuple):
        return len(given) == len(default) and all(map(alike, given, default))
    return given == default


@pytest.mark.parametrize(("name", "where", "node", "inherits"), all_nodes())
def test_a_node_holds_arguments_of_its_class_with_their_defaults(name, where, node, inherits):
    part = _signature(Part(node, where))
    given = {key: value for key, value in node.items() if key not in ("_target_", "_recursive_", "defaults")}
    assert set(given) <= set(part.parameters)
    if not node["_target_"].startswith("morlnav.") or name.split("/")[0] in CHANGES:
        return
    defaults = {key: p.default for key, p in part.parameters.items() if p.default is not p.empty}
    other = {
        key: (value, defaults[key])
        for key, value in given.items()
        if key in defaults and not isinstance(value, dict) and f"{name}:{where}.{key}" not in ANOTHER_VALUE
        if not alike(value, defaults[key])
    }
    assert not other
    if not inherits and name not in ("train", "collector/ray"):
        assert set(defaults) - set(given) <= LIVE | set(LEFT_OUT)


def test_what_is_excepted_is_there():
    found = {f"{name}:{where}.{key}" for name, where, node, _ in (p.values for p in all_nodes()) for key in node}
    assert set(ANOTHER_VALUE) <= found


@pytest.mark.parametrize("recipe", ["none", "analytical", "paper"])
def test_every_recipe_can_be_tried_in_seconds(recipe):
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        assert compose("train", [f"recipe={recipe}", "trainer=smoke"]).trainer.total_frames == 512


def test_the_papers_recipe_trains_on_a_reward_that_fails_its_audit():
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        cfgs = [compose("train", [f"recipe={recipe}"]) for recipe in ("paper", "none")]
    assert [cfg.rewards.audit.required for cfg in cfgs] == [False, True]


def test_an_objective_brings_its_own_scale():
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        cfg = compose("train", ["objectives=[baseline,distance]"])
    assert cfg.loss.scalarisation.scale == {"distance": 2.0, "default": 1.0}


APP = """
import sys
from pathlib import Path

import hydra
import morlnav
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict.nn import TensorDictModule

@hydra.main(version_base="1.3", config_path=".", config_name="app")
def main(cfg):
    OmegaConf.save(cfg, "composed.yaml")
    print(morlnav.__file__)
    assert "matplotlib" not in sys.modules, "who only takes parts should not wait for what draws"
    env = instantiate(cfg.my.env, _convert_="all")  # lists and objects of dataclasses as they are
    sampler = instantiate(cfg.my.sampler)
    replay = instantiate(cfg.my.replay)
    def make(node, **live):  # what stands in no file is given later, as Hydra has it
        return instantiate(node, _partial_=True, _convert_="all")(**live)

    shape = {"action_low": env.action_spec.low[0].tolist(), "action_high": env.action_spec.high[0].tolist()}
    actor = TensorDictModule(make(cfg.my.actor, **shape), ["observation", "preference"], ["action"])
    keys = ["observation", "preference", "action"]
    critics = [TensorDictModule(make(cfg.my.critic, **shape), keys, ["state_action_value"]) for _ in range(2)]
    spec = env.action_spec_unbatched
    loss = make(cfg.my.loss, actor_network=actor, qvalue_network=critics, action_spec=spec)
    preference = sampler(*env.batch_size)
    first = env.reset().set("preference", preference)
    step = env.step(actor(first)).set(("next", "preference"), preference)
    replay.extend(step)
    assert loss(replay.sample())["loss_qvalue"].isfinite().all()
    training = instantiate(cfg.my.training)
    training.rehearse(Path("scratch"))
    print(type(training).__name__)

main()
"""
CONFIG = """
defaults:
  - env@my.env: navigation
  - objectives@my: [baseline, distance, efficiency]
  - world@my.env.world: tensor
  - preferences@my.sampler: corners
  - replay@my.replay: hindsight
  - actor@my.actor: mlp
  - critic@my.critic: mlp
  - loss@my.loss: morl_td3
  - env@my.training.env: navigation
  - objectives@my.training: [baseline, distance, efficiency]
  - transforms@my.training.transforms: navigation
  - preferences@my.training.preferences: corners
  - actor@my.training.actor: navigation
  - critic@my.training.critic: navigation
  - loss@my.training.loss: morl_td3
  - stepper@my.training.stepper: delayed
  - exploration@my.training.exploration: gaussian
  - replay@my.training.replay: hindsight
  - collector@my.training.collector: single
  - trainer@my.training.trainer: default
  - refinement@my.training.refinement: pathwise
  - evaluation@my.training.evaluation: navigation
  - hooks@my.training.hooks: default
  - _self_
my:
  num_objectives: 2
  env: {num_envs: 4}
  sampler: {num_objectives: 2}
  replay:
    batch_size: 4
    storage: {max_size: 100}
    transforms: {relabel: {sampler: "${my.sampler}"}}
  actor: {num_objectives: 2, features: {size: 34}}
  critic: {num_objectives: 2, num_rewards: 3, features: {size: 34}}
  loss:
    scalarisation: {scale: 1.0, tie_break: 0.0}
    terms: {angle: {interpolator: {num_objectives: 2}}}
  training:
    _target_: morlnav.trainers.Training
    _recursive_: false
    loss: {scalarisation: {scale: {default: 1.0}, tie_break: {default: 0.0}}}
    refinement: {num_envs: 4, horizon: 5}
hydra:
  searchpath: [pkg://morlnav.conf]
  run: {dir: .}
  output_subdir: null
"""


def unpacked_wheel(directory):
    """The package as others install it."""
    pytest.importorskip("hatchling", reason="hatchling builds the wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(directory)]
    subprocess.run(build, cwd=CHECKOUT, capture_output=True, check=True)
    (wheel,) = directory.glob("*.whl")
    with ZipFile(wheel) as file:
        file.extractall(directory)
    return directory


def configs(directory):
    return {path.relative_to(directory) for path in directory.rglob("*.yaml")}


@pytest.mark.parametrize("installed", ["checkout", "wheel"])
def test_another_project_builds_our_parts_from_our_groups_under_its_own_names(installed, tmp_path):
    package = unpacked_wheel(tmp_path / "wheel") if installed == "wheel" else CHECKOUT
    (tmp_path / "app.py").write_text(APP)
    (tmp_path / "app.yaml").write_text(CONFIG)
    overrides = ["my.loss.noise_clip=0.9", "preferences@my.sampler=dirichlet"]
    command = [sys.executable, "-W", "error::UserWarning:hydra", "app.py", *overrides]  # it warns of a missing package
    environment = os.environ | {"PYTHONPATH": str(package)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    file, *_, training = done.stdout.splitlines()
    assert Path(file).parent == package / "morlnav"
    assert training == "Training"
    assert configs(Path(file).parent / "conf") == configs(CHECKOUT / "conf")
    mine = OmegaConf.load(tmp_path / "composed.yaml").my
    assert mine.loss._target_ == "morlnav.objectives.MORLTD3Loss"
    assert mine.loss.noise_clip == 0.9
    assert mine.sampler._target_ == "morlnav.data.DirichletPreferences"
