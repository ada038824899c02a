"""Every command and every package can be the first that is imported."""

import os
import pkgutil
import subprocess
import sys

import pytest

import morlnav

FIRST = """
import importlib, os, sys
import gymnasium, hydra, matplotlib.figure, pandas, pymunk, torchrl.trainers  # once, for they take long

for name in sys.argv[1:]:
    if os.fork() == 0:
        importlib.import_module(name)
        os._exit(0)
    if os.wait()[1]:
        print(name)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a fork for each of them saves a start of Python")
def test_any_of_them_may_come_first():
    modules = [
        *pkgutil.iter_modules(morlnav.__path__, "morlnav."),
        *pkgutil.walk_packages(morlnav.__path__, "morlnav."),
    ]
    names = {
        module.name for module in modules if module.ispkg or module.name.count(".") == 1 or ".commands." in module.name
    }
    assert {"morlnav.config", "morlnav.commands.audit", "morlnav.navigation.evaluation"} <= names
    result = subprocess.run([sys.executable, "-c", FIRST, *names], capture_output=True, text=True, check=True)
    assert result.stdout == "", result.stderr
