"""What a config may name without trust: parts that do nothing but their work."""

import json
import sys

import pytest
from hydra import compose, initialize_config_dir

from morlnav.cli import conf_dir
from morlnav.commands import audit, clone, compare, evaluate
from morlnav.config import plain
from morlnav.deployment import export
from morlnav.modules.saved import OF_THE_REST
from morlnav.runs.trust import foreign_targets, is_known, targets


@pytest.mark.parametrize(
    "path",
    [
        "morlnav.objectives.MORLTD3Loss",
        "morlnav.navigation.envs.NavigationEnv",
        "morlnav.navigation.world.PymunkWorld",
        "morlnav.trainers.linear_decay",
        "torch.optim.Adam",
        "torchrl.envs.RewardSum",
    ],
)
def test_parts_are_known(path):
    assert is_known(path)


@pytest.mark.parametrize(
    "path",
    [
        "os.system",
        "builtins.eval",
        "hydra.utils.instantiate",
        "morlnav",
        "morlnav.load",
        "morlnav.config.build",
        "morlnav.config.get_object",
        "morlnav.commands.train.subprocess",
        "morlnav.commands.train.subprocess.run",
        "morlnav.deployment.policy.Path",
        "morlnav.trainers.training.copy",
        "morlnav.trainers.training.copy.deepcopy",
        "morlnav.trainers.drex.shutil.rmtree",
        "morlnav.trainers.drex.Path",
        "morlnav.trainers.drex.TensorDict",
        "morlnav.trainers.training.build",
        "morlnav.trainers.cache.tempfile.TemporaryDirectory",
        "morlnav.modules.load_module",  # which may be told to trust what it loads
        "morlnav.modules.saved.import_module",
        "morlnav.trainers.ray.RayCollector",
        "morlnav.trainers.ray.distributed.RayCollector",
        "morlnav.navigation.nothing.Here",
        "morlnav.navigation..envs.NavigationEnv",
        "morlnav.datasets.Any",
        "torch.optim.adam.torch.load",
        "torch.optim.lr_scheduler.LambdaLR",
        "torch.load",
        "",
        ".",
    ],
)
def test_a_path_through_our_own_modules_leads_to_nothing_foreign(path):
    assert not is_known(path)


@pytest.mark.parametrize(
    "logger", ["morlnav.record.TensorboardCSVLogger", "torchrl.record.CSVLogger", "torchrl.collectors.Collector"]
)
def test_what_writes_or_starts_workers_is_known_in_its_place_alone(logger):
    node = {"_target_": logger}
    place = "collector" if logger.endswith("Collector") else "logger"
    assert foreign_targets({place: node}) == []
    assert foreign_targets({"env": {"scenes": node}}) == [logger]
    assert foreign_targets({place: {"_target_": logger, "inner": node}}) == [logger]


def test_a_task_that_names_a_package_to_import_is_foreign():
    task = {"_target_": "morlnav.envs.MOGymnasium", "id": "mo-hopper-2obj-v5"}
    assert foreign_targets({"env": task}) == []
    assert foreign_targets({"env": task | {"id": "my_evil:Task-v0"}}) == ["my_evil:Task-v0"]


def test_every_node_is_looked_at_however_deep_it_lies():
    config = {"_target_": "a.A", "b": [{"c": {"_target_": "b.B", "d": [[{"_target_": "c.C"}]]}}], "e": "text"}
    assert list(targets(config)) == foreign_targets(config) == ["a.A", "b.B", "c.C"]


def test_nothing_foreign_is_imported_to_find_out(tmp_path, monkeypatch):
    (tmp_path / "my_evil.py").write_text(f"open({str(tmp_path / 'stolen')!r}, 'w').close()\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert foreign_targets({"env": {"_target_": "my_evil.Evil"}}) == ["my_evil.Evil"]
    assert not (tmp_path / "stolen").exists()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (audit, "kept --trust"),
        (clone, "noise rewards.demonstrations.demo.policy._target_=my_own.Scenes"),
        (compare, "kept pairs --trust"),
        (evaluate, "kept --trust"),
        (export, "kept --trust"),
    ],
)
def test_every_command_looks_for_ones_own_classes_in_the_present_folder(
    command, words, kept_run, change_config, tmp_path, monkeypatch
):
    (tmp_path / "my_own.py").write_text("class Scene: ...\n")
    change_config("env.scenes", {"_target_": "my_own.Scenes"})
    policy = json.loads((kept_run / "policy.json").read_text())
    policy["model"]["features"]["_target_"] = "my_own.Scenes"
    del policy[OF_THE_REST]
    (kept_run / "policy.json").write_text(json.dumps(policy))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        sys, "path", [path for path in sys.path if path]
    )  # as a script's, and not as `python -m` has it
    monkeypatch.setattr(sys, "argv", ["morlnav", *words.split()])
    with pytest.raises(SystemExit, match=r"my_own\.Scene"):
        command.main()
    assert sys.modules.pop("my_own", None), "it was found"


def test_everything_that_a_run_names_by_default_is_known():
    for words in ([], ["recipe=analytical"], ["recipe=paper"], ["env=mo_gymnasium", "env.id=mo-hopper-2obj-v5"]):
        with initialize_config_dir(conf_dir(), version_base="1.3"):
            assert foreign_targets(plain(compose("train", words))) == []
