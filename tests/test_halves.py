"""The library's halves: what serves any task knows nothing of navigation, and imports run one way."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import morlnav
from morlnav.deployment import save
from morlnav.modules import Actor

PACKAGE = Path(morlnav.__file__).parent
FILES = sorted(file for file in PACKAGE.rglob("*.py") if file.relative_to(PACKAGE).parts[0] != "conf")
OF_NAVIGATION = ("navigation", "commands", "__init__.py")  # the root brings the environment when it is asked for
GENERIC = [file for file in FILES if file.relative_to(PACKAGE).parts[0] not in OF_NAVIGATION]


def imports(file):
    """What a source imports of ours when it runs, also inside of functions; imports for type checkers are left out."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    typing = [node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)]
    left_out = {id(node) for block in typing for node in ast.walk(block)}
    for node in ast.walk(tree):
        if id(node) in left_out:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == "morlnav")
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "morlnav":
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file} imports relatively, which this test does not follow"


def room(name):
    """The room that a dotted name lies in, such as ``morlnav.navigation.world``; ``morlnav`` itself for its root."""
    parts = name.split(".")
    return ".".join(parts[: 3 if parts[1:2] == ["navigation"] else 2])


def of(file):
    return ".".join(("morlnav", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


@pytest.mark.parametrize("file", GENERIC, ids=of)
def test_what_serves_any_task_imports_nothing_of_navigation(file):
    assert not [name for name in imports(file) if name.startswith("morlnav.navigation")]


def test_imports_run_one_way():
    rooms = {}
    for file in FILES:
        here = rooms.setdefault(room(of(file)), set())
        here |= {room(name) for name in imports(file)} - {room(of(file))}
    root = {name for name in rooms if len(name.split(".")) < 2} | {"morlnav.navigation"}
    order = [name for name in TopologicalSorter(rooms).static_order() if name not in root]  # raises for a circle
    assert order.index("morlnav.navigation.world") < order.index("morlnav.navigation.envs")
    assert order.index("morlnav.modules") < order.index("morlnav.objectives") < order.index("morlnav.trainers")
    assert order.index("morlnav.trainers") < order.index("morlnav.runs") < order.index("morlnav.commands")


LOADS = """
import sys, morlnav

policy = morlnav.load(sys.argv[1])
print(*sorted({name.partition(".")[0] for name in sys.modules} & set(sys.argv[2].split(","))))
print(*sorted(name for name in sys.modules if name.startswith("morlnav.") and "env" in name))
"""


def test_a_robot_that_loads_a_policy_waits_for_nothing_else(tmp_path):
    save(Actor(2, [0.0, -3.14], [0.5, 3.14], features=34, depth=1, num_cells=8), ["distance", "efficiency"], tmp_path)
    heavy = "torchrl,gymnasium,pandas,pymunk,scipy,matplotlib,hydra,pygame,shapely"
    words = [sys.executable, "-c", LOADS, str(tmp_path), heavy]
    result = subprocess.run(words, capture_output=True, text=True, check=True)
    assert result.stdout == "\n\n"


IMPORTS = {
    "gymnasium first": "import gymnasium, morlnav",
    "the environments": "import morlnav, morlnav.navigation.envs, gymnasium",
    "the environments alone": "import morlnav.navigation.envs, gymnasium",
    "both": "import gymnasium, morlnav, morlnav.navigation.envs",
}


@pytest.mark.parametrize("line", IMPORTS.values(), ids=IMPORTS)
def test_gymnasium_knows_the_environment(line):
    make = 'gymnasium.make("morlnav/SocialNavigation-v0").reset(seed=0)'
    words = [sys.executable, "-W", "error::UserWarning:gymnasium", "-c", f"{line}; {make}"]
    result = subprocess.run(words, capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")


def test_to_be_known_to_gymnasium_costs_nothing():
    line = "import gymnasium, morlnav, sys; assert 'morlnav/SocialNavigation-v0' in gymnasium.registry"
    words = [sys.executable, "-c", f"{line}; print(*{{'torch', 'torchrl', 'pymunk'}} & {{*sys.modules}})"]
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout == "\n"
