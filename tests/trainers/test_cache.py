"""What the cache gives is what was kept there: changed, cut and unfinished files are noticed."""

import json

import pytest
import torch
from tensordict import TensorDict

from morlnav.modules import Actor
from morlnav.trainers.cache import Cache

CONFIG = {"demonstrations": {"num": 4}, "clone": {"depth": 1}, "audit": {"plans": 0}}
SENTENCE = r"The cache holds damaged files \(.*\); delete {path}, and they are made anew\.$"


@pytest.fixture
def cache(tmp_path):
    return Cache(tmp_path, CONFIG, seed=0, show=False)


def data():
    return TensorDict({"observation": torch.rand(500, 34), "action": torch.rand(500, 2)}, [500])


def keep(cache, make=data):
    return cache.keep(
        "demonstrations",
        lambda path: make().memmap(path, copy_existing=True),
        lambda path: TensorDict.load_memmap(path).clone(),
    )


def keep_module(cache):
    return cache.keep_module("clone", lambda: (Actor(0, [-1.0], [1.0], features=34, depth=1), {"loss": 0.5}))


def keep_report(cache, make=lambda path: (path.mkdir(), (path / "audit.json").write_text('{"passed": true}'))):
    return cache.keep("audit", make, lambda path: (path / "audit.json").read_text())


def never(path=None):
    raise AssertionError("It is in the cache.")


def overwrite(file, damage):
    content = bytearray(file.read_bytes())
    if damage == "4 KiB":
        content[4096:8192] = bytes(min(4096, len(content) - 4096))
    if damage == "a bit":
        content[len(content) // 2] ^= 1
    file.write_bytes({"cut": content[:-100], "empty": b""}.get(damage, content))


@pytest.mark.parametrize("name", ["observation.memmap", "action.memmap"])
@pytest.mark.parametrize("damage", ["4 KiB", "a bit", "cut", "empty"])
def test_changed_demonstrations_are_noticed(cache, tmp_path, name, damage):
    if (name, damage) == ("action.memmap", "4 KiB"):
        damage = "a bit"  # it has less
    keep(cache)
    (path,) = tmp_path.glob("demonstrations-*[0-9a-f]/")
    overwrite(path / name, damage)
    with pytest.raises(ValueError, match=SENTENCE.format(path=path)):
        keep(cache, never)


@pytest.mark.parametrize("change", ["missing", "added"])
def test_files_that_are_missing_or_added_are_noticed(cache, tmp_path, change):
    keep(cache)
    (path,) = tmp_path.glob("demonstrations-*[0-9a-f]/")
    (path / "action.memmap").unlink() if change == "missing" else (path / "more.memmap").write_bytes(b"more")
    with pytest.raises(ValueError, match=SENTENCE.format(path=path)):
        keep(cache, never)


@pytest.mark.parametrize("suffix", [".pt", ".json"])
@pytest.mark.parametrize("damage", ["a bit", "cut", "empty"])
def test_a_changed_module_is_noticed(cache, tmp_path, suffix, damage):
    keep_module(cache)
    (path,) = tmp_path.glob("clone-*.pt")
    if (suffix, damage) == (".json", "a bit"):  # of the hash
        content = json.loads(path.with_suffix(".json").read_text())
        path.with_suffix(".json").write_text(json.dumps(content | {"sha256": "0" * 64}))
    else:
        overwrite(path.with_suffix(suffix), damage)
    with pytest.raises(ValueError, match=SENTENCE.format(path=path)):
        cache.keep_module("clone", never)


def test_a_module_without_its_description_is_noticed(cache, tmp_path):
    keep_module(cache)
    (path,) = tmp_path.glob("clone-*.pt")
    path.with_suffix(".json").unlink()
    with pytest.raises(ValueError, match=SENTENCE.format(path=path)):
        cache.keep_module("clone", never)


@pytest.mark.parametrize("damage", ["a bit", "cut", "empty", "missing"])
def test_a_changed_hash_is_noticed(cache, tmp_path, damage):
    keep(cache)
    (path,) = tmp_path.glob("demonstrations-*[0-9a-f]/")
    file = path.with_suffix(".sha256")
    file.unlink() if damage == "missing" else overwrite(file, damage)
    with pytest.raises(ValueError, match=SENTENCE.format(path=path)):
        keep(cache, never)


def test_a_changed_report_is_noticed(cache, tmp_path):
    keep_report(cache)
    (path,) = tmp_path.glob("audit-*[0-9a-f]/")
    (path / "audit.json").write_text('{"passed": false}')
    with pytest.raises(ValueError, match=SENTENCE.format(path=path)):
        keep_report(cache, never)


def test_what_was_deleted_is_made_anew(cache, tmp_path):
    first = keep(cache)
    (path,) = tmp_path.glob("demonstrations-*[0-9a-f]/")
    for file in path.iterdir():
        file.unlink()
    path.rmdir()
    again = keep(cache)
    assert (again["observation"] != first["observation"]).any()
    assert (keep(cache, never) == again).all()


def test_what_is_whole_comes_from_the_cache(cache):
    assert (keep(cache) == keep(cache, never)).all()
    actor, facts = keep_module(cache)
    same, same_facts = cache.keep_module("clone", never)
    assert torch.equal(actor(torch.ones(34)), same(torch.ones(34)))
    assert facts == same_facts == {"loss": 0.5}
    assert keep_report(cache) == keep_report(cache, never)


def test_what_a_killed_process_left_half_done_is_swept_away(cache, tmp_path):
    for name, suffix in {"demonstrations": "", "audit": "", "clone": ".pt"}.items():
        unfinished = tmp_path / f"{name}-{cache.digest(name)}{suffix}.part"
        if suffix:
            unfinished.write_bytes(b"half")
        else:
            unfinished.mkdir()
            (unfinished / "observation.memmap").write_bytes(b"half")
    (tmp_path / f"demonstrations-{cache.digest('demonstrations')}.sha256").write_text("of what never came")
    first = keep(cache)
    keep_module(cache)
    keep_report(cache)
    assert (keep(cache, never) == first).all()
    assert not list(tmp_path.glob("*.part"))


def test_without_a_cache_everything_is_made_and_nothing_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cache = Cache(None, CONFIG, seed=0, show=False)
    assert len(keep(cache)) == 500
    assert keep_module(cache)[1] == {"loss": 0.5}
    assert keep_report(cache) == '{"passed": true}'
    assert not list(tmp_path.iterdir())
