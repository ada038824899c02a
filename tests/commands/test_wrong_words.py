"""What a command line gets wrong is refused in one sentence, whatever the command, and nothing is written."""

import shlex
import shutil
import sys
from pathlib import Path

import pytest

from morlnav.commands import audit, clone, compare, evaluate, record, report
from morlnav.deployment import export

COMMANDS = {"audit": audit, "clone": clone, "compare": compare, "evaluate": evaluate, "export": export}
COMMANDS |= {"record": record, "report": report}
DEFAULT = Path(__file__).parents[2] / "results" / "default"

# RUN is a finished run, and BLOCKED one where files stand in the place of its folders. In the present folder lie
# rooms.yaml, nan.yaml, drive.csv, folders `empty`, `full` and `full.gif`, and a file `taken`.
EVALUATE = """
nowhere                                  | nowhere is not a run directory: it holds no config.yaml.
empty                                    | empty is not a run directory
taken                                    | taken is not a run directory
''                                       | is not a run directory
RUN/policy.pt                            | is not a run directory
RUN --episodes 0                         | evaluation.episodes must be at least 1, got 0
RUN --episodes -3                        | evaluation.episodes must be at least 1, got -3
RUN --episodes 1.5                       | argument --episodes: invalid int value: '1.5'
RUN --episodes many                      | argument --episodes: invalid int value: 'many'
RUN --episodes                           | argument --episodes: expected one argument
RUN --world unity                        | There is no world/unity; choose from: pymunk, tensor
RUN --steps 0                            | evaluation.steps must be at least 1, got 0
RUN --steps -1                           | evaluation.steps must be at least 1, got -1
RUN --steps nan                          | argument --steps: invalid int value
RUN --seed -1                            | evaluation.seed must be a whole number from 0
RUN --seed 99999999999                   | evaluation.seed must be a whole number from 0
RUN --seed 0.5                           | argument --seed: invalid int value
RUN --reference 1                        | evaluation.reference needs 4 numbers
RUN --reference 1 2 3 4 5                | evaluation.reference needs 4 numbers
RUN --reference nan 0 0 0                | must be a finite number, got nan
RUN --reference 0 0 0 inf                | must be a finite number, got inf
RUN --reference low                      | argument --reference: invalid float value
RUN --threads 0                          | threads must be from 1 to 1024, got 0
RUN --threads -2                         | threads must be from 1 to 1024, got -2
RUN --threads 1000000                    | threads must be from 1 to 1024
RUN --threads two                        | argument --threads: invalid int value
RUN --output taken                       | taken
RUN --output taken/deeper                | taken
RUN --scene 0                            | --scene belongs to --animate
RUN --animate out.mp4                    | give it a name such as out.gif, not out.mp4
RUN --animate out                        | give it a name such as out.gif, not out
RUN --animate out.gif --scene 1000       | The scene must be an index below evaluation.episodes
RUN --animate out.gif --scene -1         | The scene must be an index below evaluation.episodes
RUN --animate out.gif --scene x          | argument --scene: invalid int value
RUN --animate out.gif --contexts rooms.yaml --route 0:hall | --contexts changes nothing beside --animate; leave it out
RUN --animate out.gif --output new       | --output changes nothing beside --animate
RUN --animate out.gif --steps 3          | --steps changes nothing beside --animate
RUN --animate out.gif --reference 1 2 3 4 | --reference changes nothing beside --animate
RUN --animate taken/out.gif              | taken is a file, and no folder for results
RUN --animate full.gif                   | full.gif is a folder; name a file in it
RUN --contexts rooms.yaml --route 0:hall --steps 3 | --steps changes nothing beside --contexts
RUN --contexts rooms.yaml --route 0:hall --reference 1 2 3 4 | --reference changes nothing beside --contexts
BLOCKED                                  | blocked/evaluation is a file, and no folder for results
BLOCKED --contexts rooms.yaml --route 0:hall | blocked/evaluation is a file, and no folder for results
RUN --contexts rooms.yaml                | --contexts and --route go together
RUN --route 0:hall                       | --contexts and --route go together
RUN --contexts nowhere.yaml --route 0:hall | There is no file of contexts nowhere.yaml
RUN --contexts empty --route 0:hall      | There is no file of contexts empty
RUN --contexts taken --route 0:hall      | must map rooms to weights
RUN --contexts drive.csv --route 0:hall  | must map rooms to weights
RUN --contexts RUN/policy.pt --route 0:hall | is not readable as YAML
RUN --contexts nan.yaml --route 0:hall   | gives demo the weight nan; weights are numbers of at least 0
RUN --contexts rooms.yaml --route 0:attic | There is no room attic; choose from: hall, kitchen
RUN --contexts rooms.yaml --route 0:hall inf:attic | goes on at finite ones
RUN --contexts rooms.yaml --route 0:hall 999999:attic | There is no room attic
RUN --contexts rooms.yaml --route 0:hall nan:hall | goes on at finite ones
RUN --contexts rooms.yaml --route 3:hall | A route begins at 0 seconds
RUN --contexts rooms.yaml --route -1:hall | expected at least one argument
RUN --contexts rooms.yaml --route 0:hall 0:kitchen | --route enters two rooms at once
RUN --contexts rooms.yaml --route hall   | hall is no SECOND:ROOM, such as 6:kitchen
RUN --contexts rooms.yaml --route 0:     | 0: is no SECOND:ROOM
RUN --contexts rooms.yaml --route x:hall | x:hall is no SECOND:ROOM
RUN --contexts rooms.yaml --route        | argument --route: expected at least one argument
RUN --epsiodes 3                         | unrecognized arguments: --epsiodes 3
RUN more                                 | unrecognized arguments: more
RUN env.max_steps=3                      | unrecognized arguments: env.max_steps=3
                                         | the following arguments are required: RUN_DIR
"""

AUDIT = """
nowhere                                  | There is no reward model in nowhere; expected reward.pt there.
empty                                    | There is no reward model in empty
taken                                    | a saved module is two files
''                                       | There is no reward model
RUN --scale nan                          | scale must be positive and offset a finite number, got nan
RUN --scale 0                            | scale must be positive
RUN --scale -1                           | scale must be positive
RUN --scale inf                          | scale must be positive
RUN --scale big                          | argument --scale: invalid float value
RUN --offset nan                         | offset a finite number, got 10.0 and nan
RUN --offset inf                         | offset a finite number
RUN --offset -inf                        | expected one argument
RUN --scenes 0                           | rewards.audit.num_scenes must be at least 1, got 0
RUN --scenes -1                          | rewards.audit.num_scenes must be at least 1
RUN --scenes 1.5                         | argument --scenes: invalid int value
RUN --plans -1                           | rewards.audit.plans must not be negative
RUN --plans 0 --bare                     | --bare is about planned scenes
BLOCKED                                  | blocked/audit is a file, and no folder for results
RUN --plans x                            | argument --plans: invalid int value
RUN --scene-seed -1                      | rewards.audit.scene_seed must not be negative
RUN --scene-seed 1e3                     | argument --scene-seed: invalid int value
RUN --seed -1                            | rewards.audit.seed must not be negative
RUN --seed x                             | argument --seed: invalid int value
RUN --threads 0                          | threads must be from 1 to 1024
RUN --threads 1000000                    | threads must be from 1 to 1024
RUN --objective demi                     | The run learned no reward of demi; it learned ['demo']
RUN --objective distance                 | The run learned no reward of distance
RUN --output taken                       | taken
RUN --output taken/deeper                | taken
RUN/reward.pt --scale 0                  | scale must be positive
RUN/reward.pt --scenes 0                 | num_scenes must be at least 1
RUN/reward.pt --objective demo           | --objective belongs to a run
RUN/config.yaml                          | a saved module is two files
RUN/policy.pt                            | holds an Actor, and no reward
RUN --scail 3                            | unrecognized arguments: --scail 3
RUN more                                 | unrecognized arguments: more
                                         | the following arguments are required: RUN_DIR
"""

EXPORT = """
nowhere                                  | nowhere holds no policy.pt: no run has finished there
empty                                    | empty holds no policy.pt
taken                                    | taken holds no policy.pt
RUN/policy.pt                            | holds no policy.pt
RUN --format tflite                      | argument --format: invalid choice: 'tflite'
RUN --format                             | argument --format: expected one argument
RUN --output taken                       | taken
RUN --output taken/deeper                | taken
BLOCKED                                  | blocked/export is a file, and no folder for results
RUN --size 3                             | unrecognized arguments: --size 3
RUN more                                 | unrecognized arguments: more
                                         | the following arguments are required: RUN_DIR
"""

CLONE = """
                                         | the following arguments are required: study
silence                                  | argument study: invalid choice: 'silence'
noise --episodes 0                       | episodes must be at least 1, got 0
noise --episodes x                       | argument --episodes: invalid int value
noise --hold 0                           | hold must be at least 1, got 0
noise --hold 1.5                         | argument --hold: invalid int value
number --hold 3                          | --hold belongs to noise
noise --output taken                     | taken
noise --output taken/deeper              | taken
noise seed=-1                            | seed must be a whole number from 0
noise threads=0                          | threads must be from 1 to 1024
noise threads=null                       | threads must be a whole number, got null
noise device=nowhere                     | device=nowhere cannot be used
noise rewards.clone.fit.steps=0          | rewards.clone.fit.steps must be at least 1
noise rewards.clone.fit.lr=-1            | rewards.clone.fit.lr must be positive
noise env=nosuch                         | There is no env/nosuch; choose from
noise env=mo_gymnasium env.id=mo-hopper-2obj-v5 | choose env=navigation
noise objectives=[baseline,distance]     | nobody can be asked here
noise demonstrations=recorded rewards.demonstrations.demo.path=nowhere | nowhere holds no demonstrations
noise loss.sharpness=3                   | There is no sharpness in loss
noise +foo=1                             | foo is no argument
noise resume=RUN                         | resume and trust belong to morlnav-train
noise trust=true                         | resume and trust belong to morlnav-train
noise actor                              | actor
noise evaluation.episodes=3              | evaluation.episodes=3 changes no clone
noise trainer.total_frames=512           | trainer.total_frames=512 changes no clone
noise refinement.drives=3                | refinement.drives=3 changes no clone
noise preferences=uniform                | preferences=uniform changes no clone
noise =3                                 | =3
noise --epsiodes 3                       | unrecognized arguments: --epsiodes
"""

COMPARE = """
                                         | the following arguments are required: RUN_DIR, FOLDER
nowhere new                              | nowhere is not a run directory
RUN taken                                | taken is a file, and no folder for results
RUN taken/deeper                         | taken is a file, and no folder for results
RUN full                                 | full is not empty; name a new folder for the roll-outs
RUN full --pairs 100000                  | full is not empty
RUN new --steps 0                        | steps must be at least 1, got 0
RUN new --scenes 0                       | scenes must be at least 1, got 0
RUN new --pairs 0                        | make 1 to 150 pairs, got 0
RUN new --seed -1                        | The seed of evaluation scenes must be in [0, 2**31), got -1
RUN new --epsiodes 3                     | unrecognized arguments: --epsiodes
"""

REPORT = """
                                         | the following arguments are required: SWEEP_DIR
nowhere                                  | nowhere holds no runs
empty                                    | empty holds no runs
RUN                                      | is evaluated
RUN --scenes 0                           | scenes must be at least 1, got 0
RUN --output taken                       | taken is a file, and no folder for results
RUN --output taken/deeper                | taken is a file, and no folder for results
RUN --threads 0                          | threads must be from 1 to 1024
"""

RECORD = """
                                         | the following arguments are required: FOLDER
new --import nowhere.csv                 | nowhere.csv
new --import taken                       | taken
new --import RUN/policy.pt               | policy.pt
new --import drive.csv                   | drive.csv
new --import                             | argument --import: expected
new --seed x                             | argument --seed: invalid int value
new --seed -1                            | --seed must not be negative
new --size 10 10                         | at least
new --import drive.csv --seed 3          | --seed and --size are about driving by hand
new --import drive.csv --size 300 300    | --seed and --size are about driving by hand
full --import drive.csv                  | full holds no demonstrations
new --size 1000                          | argument --size: expected 2 arguments
new --size a b                           | argument --size: invalid int value
new env=nosuch                           | There is no env/nosuch
new env=mo_gymnasium env.id=mo-hopper-2obj-v5 | env._target_ must make a NavigationEnv
new +env.foo=1                           | env.foo is no argument
new env.world.step_time=0                | env.world.step_time must be positive
new env.scenes.distance=[9,3]            | env.scenes.distance needs 0 < low <= high
new foo=1                                | There is no foo in the config
new world.robot.max_speed=3              | in the config; did you mean env.world.robot.max_speed?
new trainer.total_frames=5               | trainer.total_frames=5 changes no recording
new seed=3                               | seed=3 changes no recording
new env.objectives={}                    | env.objectives={} would change nothing
new --frame-rate 3                       | unrecognized arguments: --frame-rate
taken                                    | taken
taken/deeper                             | taken
RUN                                      | holds no demonstrations
"""


def cases():
    for command, table in (
        ("evaluate", EVALUATE),
        ("audit", AUDIT),
        ("export", EXPORT),
        ("clone", CLONE),
        ("record", RECORD),
        ("compare", COMPARE),
        ("report", REPORT),
    ):
        for line in table.strip("\n").splitlines():
            words, _, said = line.partition(" | ")
            yield pytest.param(command, shlex.split(words), said.strip(), id=f"{command} {words.strip()}")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a run in it, and what somebody may take for one."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "run").mkdir()
    for name in ("config.yaml", "policy.pt", "policy.json", "reward.pt", "reward.json"):
        shutil.copy(DEFAULT / name, folder / "run" / name)
    shutil.copytree(folder / "run", folder / "blocked")
    for name in ("evaluation", "audit", "export"):
        (folder / "blocked" / name).write_text("a file\n")
    for name in ("empty", "full", "full/inside", "full.gif"):
        (folder / name).mkdir()
    (folder / "taken").write_text("a file\n")
    (folder / "rooms.yaml").write_text("hall: {efficiency: 1}\nkitchen: {distance: 1}\n")
    (folder / "nan.yaml").write_text("hall: {demo: .nan}\n")
    (folder / "drive.csv").write_text("x,y\n0,0\n1,0\n")
    return folder


def contents(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.parametrize(("command", "words", "said"), list(cases()))
def test_it_is_refused_in_one_sentence(command, words, said, place, monkeypatch, capsys):
    monkeypatch.chdir(place)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    words = [word.replace("RUN", "run").replace("BLOCKED", "blocked") for word in words]
    monkeypatch.setattr(sys, "argv", [f"morlnav-{command}", *words])
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = contents(place)
    with pytest.raises(SystemExit) as refused:
        COMMANDS[command].main()
    shown = capsys.readouterr()
    if refused.value.code == 2:  # argparse's, after a line of usage
        sentence = shown.err.splitlines()[-1]
        assert sentence.startswith(f"morlnav-{command}: error: ")
    else:
        sentence = refused.value.code
        assert isinstance(sentence, str)
        assert "\n" not in sentence
    assert said in sentence
    assert "Traceback" not in shown.err
    assert contents(place) == before, "nothing is written"
