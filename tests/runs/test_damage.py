"""Every file that a run, or a recording, is made of is missed when it changes: cut, emptied, flipped or deleted."""

import json
import shutil

import pytest
import torch

import morlnav
from morlnav.modules import load_module, read_facts, write_facts
from morlnav.navigation.demonstrations import (
    demonstration_settings,
    load_demonstrations,
    record_demonstrations,
    save_demonstrations,
)
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import SceneSampler

DAMAGES = {
    "cut": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "emptied": lambda file: file.write_bytes(b""),
    "flipped": lambda file: file.write_bytes(flipped(file.read_bytes())),
    "deleted": lambda file: file.unlink(),
}


def flipped(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", ["policy.pt", "policy.json", "reward.pt", "reward.json"])
def test_a_network_is_not_taken_for_another(kept_run, name, damage):
    path = (kept_run / name).with_suffix(".pt")
    write_facts(path, read_facts(path))  # the kept run is older than the hash of a description
    use = {"policy": lambda: morlnav.load(kept_run), "reward": lambda: load_module(path)}[path.stem]
    use()
    DAMAGES[damage](kept_run / name)
    with pytest.raises((ValueError, FileNotFoundError), match=name.replace(".", r"\.")) as error:
        use()
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded") / "drives"
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 1, num_envs=4)
    save_demonstrations(data, folder)
    return folder


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize(
    "name", ["demonstrations.json", "data/meta.json", "data/action.memmap", "data/scene/boxes.memmap"]
)
def test_a_recording_is_not_taken_for_another(recording, tmp_path, name, damage):
    folder = shutil.copytree(recording, tmp_path / "drives")
    assert torch.equal(load_demonstrations(folder)["action"], load_demonstrations(recording)["action"])
    DAMAGES[damage](folder / name)
    with pytest.raises((ValueError, FileNotFoundError), match=str(folder)) as error:
        load_demonstrations(folder)
    assert "\n" not in str(error.value)


def test_one_flipped_bit_of_a_header_is_noticed(recording, tmp_path):
    folder = shutil.copytree(recording, tmp_path / "drives")
    header = (recording / "demonstrations.json").read_bytes()
    for place in range(0, len(header), 3):
        changed = bytearray(header)
        changed[place] ^= 1
        (folder / "demonstrations.json").write_bytes(changed)
        with pytest.raises(ValueError, match=str(folder)):
            demonstration_settings(folder)


@pytest.mark.parametrize(
    "change",
    [{"settings": None}, {"settings": {"world": "flat"}}, {"episodes": 99}, {"more": 1}, [1], "[" * 10**5],
    ids=range(6),
)
def test_a_header_of_other_content_is_refused(recording, tmp_path, change):
    folder = shutil.copytree(recording, tmp_path / "drives")
    header = json.loads((folder / "demonstrations.json").read_text())
    changed = json.dumps(header | change if isinstance(change, dict) else change)
    (folder / "demonstrations.json").write_text(change if isinstance(change, str) else changed)
    with pytest.raises(ValueError, match="is damaged"):
        demonstration_settings(folder)
