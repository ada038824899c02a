"""A run of this version that learned from demonstrations, to be changed by a test."""

import shutil
from pathlib import Path

import pytest
import yaml

DEFAULT = Path(__file__).parents[2] / "results" / "default"
FILES = ("config.yaml", "policy.pt", "policy.json", "reward.pt", "reward.json")


@pytest.fixture
def kept_run(tmp_path):
    directory = tmp_path / "kept"
    (directory / ".hydra").mkdir(parents=True)
    for name in (*FILES, ".hydra/overrides.yaml"):
        shutil.copy(DEFAULT / name, directory / name)
    return directory


@pytest.fixture
def change_config(kept_run):
    """``change_config("env.world._target_", "os.system")`` in the copied run."""

    def change(key, value):
        config = yaml.safe_load((kept_run / "config.yaml").read_text())
        node, *names = config, *key.split(".")
        for name in names[:-1]:
            node = node.setdefault(name, {})
        node[names[-1]] = value
        (kept_run / "config.yaml").write_text(yaml.safe_dump(config))

    return change
