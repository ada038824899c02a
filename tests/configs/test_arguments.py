"""Every config against the signature of what it builds, by inspection."""

import inspect
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore
from hydra.utils import get_object
from omegaconf import MISSING, OmegaConf
from torch import nn
from torchrl.trainers import OptimizationStepper, TrainerHookBase

import morlnav.configs
from morlnav import data, envs, modules, objectives, trainers, transforms, world
from morlnav.cli import conf_dir
from morlnav.configs import CONFIGS

TARGETS = {key: OmegaConf.structured(config)._target_ for key, config in CONFIGS.items()}
OURS = {key: inspect.unwrap(get_object(target)) for key, target in TARGETS.items() if target.startswith("morlnav.")}
KINDS = (nn.Module, data.PreferenceSampler, world.World, OptimizationStepper, TrainerHookBase)
PARTS = {
    part
    for package in (data, envs, modules, objectives, trainers, transforms, world)
    for part in map(package.__dict__.get, getattr(package, "__all__", dir(package)))
    if inspect.isclass(part) and issubclass(part, KINDS) and not inspect.isabstract(part)
} - {objectives.LossTerm}  # which is there to be inherited from


@pytest.mark.parametrize("key", OURS, ids="/".join)
def test_a_config_has_every_argument_with_its_default(key):
    constructor = OURS[key].__init__ if inspect.isclass(OURS[key]) else OURS[key]
    arguments = {
        name: MISSING if parameter.default is parameter.empty else parameter.default
        for name, parameter in inspect.signature(constructor).parameters.items()
        if name != "self"
    }
    fields = OmegaConf.to_container(OmegaConf.structured(CONFIGS[key]))
    fields = {name: default for name, default in fields.items() if not name.startswith("_")}
    assert fields == OmegaConf.to_container(OmegaConf.create(arguments))


@pytest.mark.parametrize("part", sorted(PARTS, key=str), ids=lambda part: part.__name__)
def test_every_part_has_a_config(part):
    assert part in OURS.values()


@pytest.mark.parametrize("key", CONFIGS, ids="/".join)
def test_importing_the_package_registers_a_config_and_exports_it(key):
    config = CONFIGS[key]
    assert ConfigStore.instance().load(f"{'/'.join(key)}.yaml").node == OmegaConf.structured(config)
    assert getattr(morlnav.configs, config.__name__) is config
    assert config.__name__ in morlnav.configs.__all__


@pytest.mark.parametrize("key", CONFIGS, ids="/".join)
def test_no_config_is_taken_for_the_schema_of_a_file_of_that_name(key):
    assert not (Path(conf_dir()) / f"{'/'.join(key)}.yaml").exists()
