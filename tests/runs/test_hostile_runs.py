"""A run directory of a stranger executes nothing, whatever reads it, until it is trusted."""

import json
import sys
import textwrap

import pytest
import torch
import yaml

import morlnav
from morlnav.analysis import load_sweep
from morlnav.commands import audit, evaluate
from morlnav.deployment import export
from morlnav.files import digest
from morlnav.modules.saved import OF_THE_REST
from morlnav.record import TensorboardCSVLogger
from morlnav.runs import Run

EVIL = {"_target_": "my_evil.Evil"}
PLACES = (
    "actor._target_",
    "actor.features",
    "env._target_",
    "env.world",
    "env.scenes",
    "env.objectives.baseline.terms",
    "env.objectives.calm",
    "evaluation._target_",
    "evaluation.reference",
    "loss.scalarisation",
    "preferences",
    "rewards._target_",
    "rewards.audit",
    "rewards.demonstrations.demo.policy",
    "rewards.demonstrations.wide_left",
    "transforms.mine",
    "hooks.mine",
    "anything",
)


class Evil(torch.nn.Module):
    """What a stranger would have built: it is imported by this test alone."""


@pytest.fixture(autouse=True)
def nothing_is_executed(tmp_path, monkeypatch):
    """A module that leaves a trace when it is imported can be found, and no trace is there in the end."""
    trace = tmp_path / "executed"
    (tmp_path / "my_evil.py").write_text(
        textwrap.dedent(f"""
            import torch
            open({str(trace)!r}, "w").close()
            class Evil(torch.nn.Module): pass
        """)
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield
    assert not trace.exists()
    assert "my_evil" not in sys.modules


COMMANDS = (evaluate, audit)
"""They build what a config names."""


def read_by(commands, directory, monkeypatch):
    """The sentences with which commands refuse a run."""
    sentences = []
    for main in (command.main for command in commands):
        monkeypatch.setattr(sys, "argv", ["morlnav", str(directory)])
        with pytest.raises(SystemExit) as error:
            main()
        sentences.append(error.value.code)
    return sentences


@pytest.mark.parametrize("place", PLACES)
def test_a_foreign_class_is_refused_wherever_it_stands(place, kept_run, change_config, monkeypatch):
    value = EVIL["_target_"] if place.endswith("_target_") else EVIL
    change_config(place, [value] if place.endswith("terms") else value)
    for sentence in read_by(COMMANDS, kept_run, monkeypatch):
        assert sentence == (
            "This run uses the foreign my_evil.Evil; if it is your own, trust it (--trust, or trust=True)."
        )


@pytest.mark.parametrize(
    "target",
    [
        "os.system",
        "morlnav.commands.train.subprocess.run",
        "morlnav.deployment.policy.Path",
        "morlnav.modules.load_module",
        "morlnav.trainers.ray.RayCollector",
        "morlnav.record.TensorboardCSVLogger",
        "torchrl.record.CSVLogger",
        "torch.optim.adam.torch.load",
    ],
)
def test_a_path_to_what_acts_or_writes_is_refused(target, kept_run, change_config, monkeypatch, tmp_path):
    change_config("env.scenes", {"_target_": target, "exp_name": "x", "log_dir": str(tmp_path / "executed")})
    for sentence in read_by(COMMANDS, kept_run, monkeypatch):
        assert sentence.startswith(f"This run uses the foreign {target}")


@pytest.mark.parametrize("key", ["env.world", "_target_", "device"])
def test_a_resolver_makes_up_no_class(key, kept_run, change_config, monkeypatch):
    change_config(key, "${oc.decode:'{_target_: my_evil.Evil}'}")
    for sentence in read_by(COMMANDS, kept_run, monkeypatch):
        assert "holds no interpolation" in sentence


def test_yaml_makes_no_objects(kept_run, monkeypatch):
    (kept_run / "config.yaml").write_text("seed: !!python/object/apply:my_evil.Evil []\n")
    for sentence in read_by(COMMANDS, kept_run, monkeypatch):
        assert sentence.endswith("config.yaml is damaged: it is no YAML.")


def describe(file, change):
    content = json.loads(file.with_suffix(".json").read_text())
    change(content["model"])
    sign(file, content)


def sign(file, content):
    """Write a description as whoever made it up would: with the hash that belongs to it."""
    content.pop(OF_THE_REST, None)
    read = {"model": content["model"], "facts": content["facts"], "sha256": content.get("sha256")}
    file.with_suffix(".json").write_text(json.dumps(content | {OF_THE_REST: digest(read)}))


@pytest.mark.parametrize(
    ("target", "sentence"),
    [
        ("my_evil.Evil", r"names the foreign class my_evil\.Evil; if it is your own, load it with trust=True"),
        ("morlnav.modules.saved.import_module", "is no module of this package"),
        ("morlnav.modules.networks.nn.Linear", "is not there"),
        ("morlnav.modules.networks.Tensor", "is no module of this package"),
        ("morlnav.modules.saved.Path", "is no module of this package"),
    ],
)
def test_a_policy_is_made_of_our_modules_alone(target, sentence, kept_run, monkeypatch):
    describe(kept_run / "policy.pt", lambda model: model["features"].update(_target_=target))
    with pytest.raises(ValueError, match=sentence):
        morlnav.load(kept_run)
    monkeypatch.setattr(sys, "argv", ["morlnav-export", str(kept_run)])
    with pytest.raises(SystemExit, match=sentence):
        export.main()
    assert not (kept_run / "export").exists()


def test_a_reward_is_made_of_our_modules_alone(kept_run, monkeypatch):
    describe(kept_run / "reward.pt", lambda model: model["model"]["models"][2].update(EVIL))
    for sentence in read_by(COMMANDS, kept_run, monkeypatch):
        assert "names the foreign class my_evil.Evil" in sentence


class Pickled:
    def __reduce__(self):
        return __import__, ("my_evil",)


@pytest.mark.parametrize(("name", "commands"), [("policy.pt", [evaluate]), ("reward.pt", COMMANDS)])
def test_weights_are_not_unpickled_even_where_their_hash_is_right(name, commands, kept_run, monkeypatch):
    torch.save({"low": Pickled()}, kept_run / name)
    content = json.loads((kept_run / name).with_suffix(".json").read_text())
    del content["sha256"]
    sign(kept_run / name, content)
    for sentence in read_by(commands, kept_run, monkeypatch):
        assert "does not hold the weights of this" in sentence


def test_a_sweep_resolves_nothing_and_builds_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "hunter2")
    for seed in (0, 1):
        run = tmp_path / "sweep" / str(seed)
        TensorboardCSVLogger("logs", run).log_scalar("train/success", 0.5, step=10)
        (run / ".hydra").mkdir()
        config = {"seed": seed, "who": f"{seed} ${{oc.env:SECRET}}", "evil": EVIL}
        (run / "config.yaml").write_text(yaml.safe_dump(config))
        words = [f"who=${{oc.env:SECRET}}{seed}", f"+more=${{oc.decode:'{seed}'}}"]
        (run / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(words))
        choices = {"env": f"${{oc.env:SECRET}}{seed}"}
        (run / ".hydra" / "hydra.yaml").write_text(yaml.safe_dump({"hydra": {"runtime": {"choices": choices}}}))
    text = load_sweep(tmp_path / "sweep").to_csv()
    assert "hunter2" not in text
    assert "${oc.env:SECRET}" in text


def test_trust_builds_ones_own(kept_run, change_config, tmp_path):
    (tmp_path / "my_parts.py").write_text(
        "from morlnav.navigation.evaluation import NavigationEvaluation as Ours\n\n\nclass Mine(Ours):\n    pass\n"
    )
    change_config("evaluation._target_", "my_parts.Mine")
    with pytest.raises(ValueError, match=r"foreign my_parts\.Mine"):
        Run(kept_run)
    assert type(Run(kept_run, trust=True).evaluation).__name__ == "Mine"
