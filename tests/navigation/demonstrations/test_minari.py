"""Minari data sets, made by us or by its own collector, come back as demonstrations."""

import sys

import gymnasium
import pytest
import torch

minari = pytest.importorskip("minari")

from morlnav.commands import record
from morlnav.navigation.demonstrations import from_minari, load_demonstrations, record_demonstrations, to_minari
from morlnav.navigation.modules import CircumnavigationOracle
from morlnav.navigation.world import DifferentialDrive, SceneSampler, TensorWorld


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))


def test_what_goes_out_comes_in(tmp_path, monkeypatch, capsys):
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 2, num_envs=4)
    to_minari(data, "navigation/oracle-v0")
    again = from_minari("navigation/oracle-v0")
    assert set(data.keys(True, True)) - set(again.keys(True, True)) == {("next", "reward")}
    for key, value in again.items(True, True):
        assert torch.equal(value, data[key]), key
    with pytest.raises(ValueError, match="is a Minari data set navigation/oracle-v0 already"):
        to_minari(data, "navigation/oracle-v0")
    with pytest.raises(ValueError, match=r"oracle-v0 drive up to 0.50 m/s, the world's robot 0.3"):
        from_minari("navigation/oracle-v0", TensorWorld(robot=DifferentialDrive(max_speed=0.3)))
    monkeypatch.setattr(
        sys, "argv", ["morlnav-record", str(tmp_path / "mine"), "--import", "minari:navigation/oracle-v0"]
    )
    record.main()
    assert "mine holds 2 demonstrations" in capsys.readouterr().out
    assert len(load_demonstrations(tmp_path / "mine")) == len(data)


def test_what_the_collector_saw_is_learned_from(capsys):
    pytest.importorskip("jax")  # which Minari's collector asks for
    env = minari.DataCollector(gymnasium.make("morlnav/SocialNavigation-v0"), record_infos=True)
    oracle = CircumnavigationOracle()
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        for _ in range(200 if seed else 5):
            observation, _, terminated, truncated, _ = env.step(oracle(torch.as_tensor(observation)).numpy())
            if terminated or truncated:
                break
    env.create_dataset("navigation/collected-v0")
    data = from_minari("navigation/collected-v0")
    assert data["next", "outcome", "goal"].sum() == data["episode"].max() + 1
    assert "that do not arrive left out" in capsys.readouterr().out
    assert torch.allclose(oracle(data["observation"]), data["action"], atol=1e-5)


@pytest.mark.parametrize("name", ["mine", "", "../mine-v0", "mine v0", "a//b-v0", "mine-v", "/etc/passwd", "ümlaut-v0"])
def test_names_that_no_data_set_has_are_refused_and_leave_nothing(name, tmp_path):
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 1, num_envs=4)
    for call in (lambda: to_minari(data, name), lambda: from_minari(name)):
        with pytest.raises(ValueError, match="has a name such as navigation/mine-v0, with a version, got"):
            call()
    assert not list(tmp_path.rglob("*-v0"))


DAMAGES = {
    "cut": lambda data: data[: len(data) // 2],
    "emptied": lambda data: b"",
    "flipped": lambda data: bytes(byte ^ 255 for byte in data[:64]) + data[64:],
    "deleted": None,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_named_in_one_sentence(damage, tmp_path):
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 2, num_envs=4)
    to_minari(data, "mine-v0")
    for file in [path for path in (tmp_path / "minari").rglob("*") if path.suffix in (".hdf5", ".json")]:
        content = file.read_bytes()
        file.unlink() if DAMAGES[damage] is None else file.write_bytes(DAMAGES[damage](content))
        with pytest.raises(ValueError, match="The Minari data set mine-v0 is damaged: ") as caught:
            from_minari("mine-v0")
        assert "\n" not in str(caught.value)
        file.write_bytes(content)
    assert len(from_minari("mine-v0")) == len(data)


def test_what_is_not_finite_is_refused():
    data, _ = record_demonstrations(CircumnavigationOracle(), SceneSampler(), 1, num_envs=4)
    data["observation"][7, 3] = torch.nan
    to_minari(data, "mine-v0")
    with pytest.raises(ValueError, match=r"is damaged: its .*observation.* is not finite"):
        from_minari("mine-v0")


def test_other_data_sets_are_refused():
    with pytest.raises(ValueError, match="There is no local Minari data set navigation/none-v0"):
        from_minari("navigation/none-v0")
    pytest.importorskip("jax")
    env = minari.DataCollector(gymnasium.make("morlnav/SocialNavigation-v0"))
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.create_dataset("navigation/bare-v0")
    with pytest.raises(ValueError, match=r"bare-v0 keeps no pose in its infos; collect with DataCollector"):
        from_minari("navigation/bare-v0")
