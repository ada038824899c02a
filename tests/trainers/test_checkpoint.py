"""A checkpoint is whole or refused by name; a refused one runs and changes nothing, and the one before it is used."""

import hashlib
import json
import pickle
import shutil
import zipfile
from pathlib import Path

import pytest
import torch
from support import configure, trainer_for
from torchrl.checkpoint import Checkpoint, CheckpointError

from morlnav.trainers.checkpoint import (
    LISTING,
    ListedCheckpoint,
    find_checkpoints,
    load_checkpoint,
    verify,
    whole_checkpoint,
)

DAMAGES = {
    "cut": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "emptied": lambda file: file.write_bytes(b""),
    "flipped": lambda file: file.write_bytes(flipped(file.read_bytes())),
    "deleted": lambda file: file.unlink(),
}
FILES = (
    LISTING,
    "manifest.json",
    "components/*-average/state.json",
    "components/*-average/state/meta.json",
    "components/*-average/state/tensor_00000003.memmap",
    "components/*-replay_buffer/buffer_metadata.json",
    "components/*-replay_buffer/storage/meta.json",
    "components/*-replay_buffer/storage/next/observation.memmap",
    "components/*-replay_buffer/transform/state.json",
    "components/*-replay_buffer/writer/metadata.json",
    "components/*-rng/state/tensor_00000000.memmap",
)


class Bomb:
    """A pickle that leaves a file behind when it is read."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def flipped(data):
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


def state_of(folder):
    """Of every file its content and when it was written."""
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}


def list_anew(checkpoint):
    """What an attacker does who knows our listing: whatever lies there is listed, with its true hash."""
    files = {
        path.relative_to(checkpoint).as_posix(): {
            "size": path.stat().st_size,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        }
        for path in checkpoint.rglob("*")
        if path.is_file() and path.name != LISTING
    }
    digest = hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest()
    text = json.dumps({"files": files, "sha256": digest}, indent=1, sort_keys=True)
    (checkpoint / LISTING).write_text(text)


@pytest.fixture
def checkpoints(smoke_run, tmp_path):
    """The two checkpoints of a run, to be spoiled."""
    shutil.copytree(smoke_run / "checkpoints", tmp_path / "checkpoints")
    return find_checkpoints(tmp_path)


# Damage


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("pattern", FILES)
def test_a_damaged_file_is_named_and_the_checkpoint_before_is_used(pattern, damage, checkpoints, capsys):
    before, last = checkpoints
    file = next(last.glob(pattern))
    DAMAGES[damage](file)
    state = state_of(last)

    assert whole_checkpoint(last) == before
    said = capsys.readouterr().out
    assert said.startswith(f"{file} is {'missing' if damage == 'deleted' else 'damaged'}")
    assert said.endswith(f"; going on from {before} instead.\n")
    assert said.count("\n") == 1
    assert state_of(last) == state


def test_an_added_file_is_named(checkpoints):
    added = checkpoints[1] / "components" / "more.memmap"
    added.write_bytes(b"0000")
    with pytest.raises(CheckpointError, match=r"more\.memmap does not belong to its checkpoint: files\.json"):
        verify(checkpoints[1])


def test_a_trainer_goes_on_from_the_checkpoint_before_a_damaged_one(checkpoints, tmp_path, capsys):
    before, last = checkpoints
    DAMAGES["cut"](next(last.glob("components/*-policy/state/tensor_00000003.memmap")))
    trainer = trainer_for(configure(), tmp_path / "resumed")
    assert load_checkpoint(trainer, last) == before
    assert trainer.collected_frames == int(before.name.split("-")[1]) < int(last.name.split("-")[1])
    assert "instead." in capsys.readouterr().out


def test_two_damaged_checkpoints_are_both_named_and_refused(checkpoints, tmp_path):
    for checkpoint in checkpoints:
        DAMAGES["cut"](next(checkpoint.glob("components/*-loss_module/state/tensor_00000010.memmap")))
    state = state_of(tmp_path / "checkpoints")
    trainer = trainer_for(configure(), tmp_path / "resumed")
    began = {name: value.clone() for name, value in trainer.loss_module.state_dict().items()}
    with pytest.raises(CheckpointError) as error:
        load_checkpoint(trainer, checkpoints[1])
    assert all(f"{checkpoint}/components" in str(error.value) for checkpoint in checkpoints)
    assert "no whole checkpoint is left there, and nothing was loaded" in str(error.value)
    assert state_of(tmp_path / "checkpoints") == state
    assert all(torch.equal(value, began[name]) for name, value in trainer.loss_module.state_dict().items())


@pytest.mark.parametrize("listing", ["[]", '{"files": 1}', '{"files": {"manifest.json": 1}}', "\xff"])
def test_a_listing_of_another_shape_is_named(listing, checkpoints):
    (checkpoints[1] / LISTING).write_text(listing, encoding="latin-1")
    with pytest.raises(CheckpointError, match=r"files\.json is damaged: expected a listing"):
        verify(checkpoints[1])


# What may lie in a checkpoint


def behind_a_link(average, bomb):
    state = average.parents[3] / "elsewhere"
    (average / "state").rename(state)
    (state / "other.pickle").write_bytes(bomb)
    (average / "state").symlink_to(state)
    return "state is a link"


def as_linked_file(average, bomb):
    file = average / "state" / "meta.json"
    file.rename(average.parents[3] / "meta.json")
    file.symlink_to(average.parents[3] / "meta.json")
    return "meta.json is a link"


def as_archive(average, bomb):
    with zipfile.ZipFile(average / "state.tdz", "w") as archive:
        archive.writestr("meta.json", '{"_type": "<class \'tensordict.tensorclass.NonTensorData\'>"}')
        archive.writestr("other.pickle", bomb)
    shutil.rmtree(average / "state")
    return "state.tdz is an archive"


def as_torch_file(average, bomb):
    (average / "state.pt").write_bytes(bomb)
    return "state.pt is a file of another kind"


def as_transforms(average, bomb):
    next(average.parent.glob("*replay_buffer")).joinpath("transform.t").write_bytes(bomb)
    return "transform.t is a file of another kind"


def as_pickle(average, bomb):
    (average / "state" / "other.pickle").write_bytes(bomb)
    return "other.pickle is a pickle"


def as_prefetched_batches(average, bomb):
    next(average.parent.glob("*replay_buffer")).joinpath("prefetch.pkl").write_bytes(bomb)
    return "prefetch.pkl is a pickle"


@pytest.mark.parametrize("listed", [False, True], ids=["unlisted", "listed"])
@pytest.mark.parametrize(
    "hide",
    [behind_a_link, as_linked_file, as_archive, as_torch_file, as_transforms, as_pickle, as_prefetched_batches],
)
def test_code_in_a_checkpoint_is_refused_by_name_and_never_runs(hide, listed, checkpoints, tmp_path):
    bomb = pickle.dumps(Bomb(tmp_path / "ran"))
    words = hide(next(checkpoints[1].glob("components/*-average")), bomb)
    if listed:
        list_anew(checkpoints[1])
    with pytest.raises(ValueError, match=f"{words}, but a checkpoint is a plain folder of .json and .memmap files"):
        load_checkpoint(None, checkpoints[1])  # it does not come to the trainer
    assert not (tmp_path / "ran").exists()


def test_an_archive_in_place_of_a_checkpoint_is_refused(checkpoints, tmp_path):
    folder = checkpoints[1]
    archive = Path(shutil.make_archive(str(folder), "zip", folder)).rename(folder.with_suffix(".torchrl"))
    assert Checkpoint.is_checkpoint(archive)
    assert find_checkpoints(tmp_path)[-1] == archive
    with pytest.raises(ValueError, match=r"checkpoint-0+512\.torchrl is an archive"):
        whole_checkpoint(archive)


def test_a_checkpoint_behind_a_link_is_refused(checkpoints, tmp_path):
    link = checkpoints[1].with_name("checkpoint-000000001024")
    link.symlink_to(checkpoints[1])
    with pytest.raises(ValueError, match=f"{link} is a link"):
        whole_checkpoint(find_checkpoints(tmp_path)[-1])


def test_a_checkpoint_that_is_listed_but_not_torchrls_is_refused(checkpoints):
    (checkpoints[1] / "manifest.json").write_text("{}")
    list_anew(checkpoints[1])
    with pytest.raises(CheckpointError, match="does not contain a TorchRL checkpoint"):
        verify(checkpoints[1])


# What is written


def test_only_the_rows_that_the_replay_holds_are_written(smoke_run):
    checkpoint = find_checkpoints(smoke_run)[-1]
    storage = next(checkpoint.glob("components/*-replay_buffer/storage"))
    frames, capacity = 512, configure().replay.storage.max_size
    assert frames < capacity
    assert (storage / "action.memmap").stat().st_size == frames * 2 * 4  # bytes
    assert (storage / "next" / "terminated.memmap").stat().st_size == frames
    assert sum(file.stat().st_size for file in checkpoint.rglob("*") if file.is_file()) < 1e6


def test_a_smaller_replay_than_the_checkpoints_is_refused(checkpoints, tmp_path):
    trainer = trainer_for(configure("replay.storage.max_size=256"), tmp_path / "resumed")
    with pytest.raises(
        CheckpointError, match=r"holds 512 transitions; expected a replay\.storage\.max_size of at least"
    ):
        load_checkpoint(trainer, checkpoints[1])


class Growing:
    """A component that outgrows every disk once it has been saved."""

    size = 1

    def state_dict(self):
        return {"weight": torch.zeros(1).expand(self.size)}

    def load_state_dict(self, state):
        self.size = len(state["weight"])


def test_a_checkpoint_that_the_disk_cannot_hold_is_refused_and_the_last_one_stays(tmp_path):
    growing = Growing()
    checkpoint = ListedCheckpoint(net=torch.nn.Linear(2, 1), growing=growing)
    saved = checkpoint.save(tmp_path / "checkpoint-1")
    state = state_of(tmp_path)
    growing.size = 10**15
    with pytest.raises(OSError, match=r"MB free, but 40000000\d+\.\d MB are needed; make room and resume"):
        checkpoint.save(tmp_path / "checkpoint-2")
    assert state_of(tmp_path) == state
    verify(saved)


def test_what_a_killed_process_left_of_a_checkpoint_is_cleaned(tmp_path):
    left = tmp_path / ".checkpoint-000000000128.stage-0123"
    left.mkdir()
    (left / "part.memmap").write_bytes(b"0")
    ListedCheckpoint(net=torch.nn.Linear(2, 1)).save(tmp_path / "checkpoint-000000000256")
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint-000000000256"]


def test_a_file_that_could_not_be_loaded_is_refused_when_it_is_written(tmp_path):
    class Writer:
        def dump(self, path):
            (path / "state.pt").write_bytes(b"")

        def load(self, path):
            pass

    with pytest.raises(ValueError, match=r"state\.pt is a file of another kind"):
        ListedCheckpoint(writer=Writer()).save(tmp_path / "checkpoint-1")
    assert not list(tmp_path.iterdir())
