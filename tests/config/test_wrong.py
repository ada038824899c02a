"""What a config gets wrong is refused in one sentence that names the key, before anything runs."""

# ruff: noqa: E501  (tables)

import copy
import os
import shlex
import subprocess
import sys

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from morlnav.cli import conf_dir, one_sentence_errors
from morlnav.commands.train import run

SMOKE = ("trainer=smoke", "trainer.progress_bar=false")

# Values: words of the command line, and what the sentence must hold.
NUMBERS = """
seed=-1                                             | seed must be a whole number from 0
seed=1.5                                            | seed must be a whole number, got 1.5
seed=abc                                            | seed must be a whole number, got 'abc'
threads=0                                           | threads must be from 1 to 1024, got 0
threads=abc                                         | threads must be a whole number
threads=1000000                                     | threads must be from 1 to 1024
env.num_envs=0                                      | env.num_envs must be at least 1
env.num_envs=1.5                                    | env.num_envs must be a whole number
env.inflation=abc                                   | env.inflation must be a number, got 'abc'
env.inflation=-1                                    | env.inflation must not be negative
env.observe_human=maybe                             | env.observe_human must be true or false, got 'maybe'
env.world.robot.max_turn=nan                        | env.world.robot.max_turn must be a finite number, got nan
env.world.robot.max_speed=inf                       | env.world.robot.max_speed must be a finite number
env.world.robot.max_speed=0                         | max_speed must be positive
env.world.lidar.max_range=nan                       | env.world.lidar.max_range must be a finite number
env.world.lidar.max_range=inf                       | env.world.lidar.max_range must be a finite number
env.world.lidar.rays=7                              | env.world.lidar: 30 sectors must divide 7 rays
env.world.check_interval=10                         | env.world.check_interval must be at most the step_time
env.world.step_time=0                               | env.world.step_time must be positive
env.scenes.distance=[1]                             | env.scenes.distance must be a list of 2
env.scenes.distance=[12,6]                          | env.scenes.distance needs 0 < low <= high
env.scenes.num_boxes=-1                             | env.scenes.num_boxes must not be negative
env.objectives.efficiency.penalty=abc               | env.objectives.efficiency.penalty must be a number
env.objectives.efficiency.penalty=nan               | env.objectives.efficiency.penalty must be a finite number
transforms.time_limit.max_steps=0                   | transforms.time_limit.max_steps
preferences.corner=2                                | preferences.corner and edge must be shares
actor.num_cells=0                                   | actor: A network needs
actor.features.octaves=-1                           | actor.features.octaves must not be negative
actor.features.use_lidar=1                          | actor.features.use_lidar must be true or false
critic.afterstate.lookahead=[abc]                   | critic.afterstate.lookahead[0] must be a number
loss.policy_noise=nan                               | loss.policy_noise must be a finite number
loss.policy_noise=-1                                | loss.policy_noise must not be negative
loss.loss_function=l3                               | loss.loss_function must be one of l2, l1, smooth_l1
loss.num_qvalue_nets=0                              | loss.num_qvalue_nets must be at least 1
loss.scalarisation.scale=-1                         | loss.scalarisation.scale must not be negative
loss.scalarisation.tie_break=abc                    | loss.scalarisation.tie_break must be a number or a list
loss.terms.proposals.guidance.margin=nan            | loss.terms.proposals.guidance.margin must be a finite number
loss.terms.proposals.guidance.coefficient=nan       | loss.terms.proposals.guidance.coefficient must be a finite
loss.terms.proposals.search.proposals=0             | loss.terms.proposals.search.proposals must be at least 1
loss.terms.angle.eps=0                              | loss.terms.angle.eps must be positive
loss.terms.angle.interpolator.decay=2               | loss.terms.angle.interpolator.decay must be above 0
stepper.policy_update_delay=0                       | stepper.policy_update_delay must be at least 1
stepper.average_decay=1                             | stepper.average_decay must be from 0 to below 1
stepper.optimizer_actor.lr=-1                       | stepper.optimizer_actor: Invalid learning rate: -1
stepper.schedule.start=2                            | stepper.schedule.start must be from 0 to below 1
stepper.schedule.end=-1                             | stepper.schedule.end must be from 0 to 1
stepper.target_net_updater.tau=0                    | stepper.target_net_updater.tau must be above 0
stepper.target_net_updater.tau=-1                   | stepper.target_net_updater.tau must be above 0
exploration.sigma_init=nan                          | exploration.sigma_init must be a finite number
exploration.sigma_init=-1                           | exploration.sigma_init and sigma_end must fall
exploration.greedy=2                                | exploration.greedy must be a share
replay.batch_size=0                                 | replay.batch_size must be from 1
replay.batch_size=64 replay.storage.max_size=32     | replay.batch_size must be from 1 to the storage's 32, got 64
replay.storage.max_size=0                           | replay.batch_size must be from 1 to the storage's 0
replay.storage.max_size=1000000000000000            | replay.storage cannot hold a batch
replay.transforms.scale.scale=nan                   | replay.transforms.scale.scale must be a finite number
replay.transforms.relabel.share=2                   | replay.transforms.relabel.share must be between 0 and 1
replay=prioritised replay.sampler.max_capacity=3    | replay.sampler.max_capacity must be at least the storage's 720000
replay=prioritised replay.sampler.alpha=nan         | replay.sampler.alpha must be a finite number
collector.init_random_frames=-1                     | collector.init_random_frames must not be negative
collector.frames_per_batch=0                        | collector.frames_per_batch (0) must be a positive multiple of the 16
collector.frames_per_batch=5                        | collector.frames_per_batch (5) must be a positive multiple of the 16
collector=processes collector.num_collectors=0      | collector.num_collectors must be at least 1
collector=processes collector.num_collectors=3      | env.num_envs (16) must be a multiple of 3
trainer.total_frames=-5                             | trainer.total_frames must be at least 1
trainer.total_frames=0                              | trainer.total_frames must be at least 1
trainer.total_frames=33.7                           | trainer.total_frames must be a whole number
trainer.total_frames=                               | trainer.total_frames must be a whole number
trainer.optim_steps_per_batch=0                     | trainer.optim_steps_per_batch must be at least 1
trainer.clip_norm=-1                                | trainer.clip_norm must be positive
trainer.checkpoint_interval=-1                      | trainer.checkpoint_interval must be at least 1
trainer.progress_bar=maybe                          | trainer.progress_bar must be true or false
evaluation.episodes=0                               | evaluation.episodes must be at least 1
evaluation.episodes=1.5                             | evaluation.episodes must be a whole number
evaluation.steps=0                                  | evaluation.steps must be at least 1
evaluation.seed=abc                                 | evaluation.seed must be a whole number
evaluation.reference=[1]                            | evaluation.reference needs 4 numbers, for baseline
evaluation.reference={foo:1}                        | evaluation.reference names foo
hooks.discount.fraction=2                           | hooks.discount.fraction must be between 0 and 1
hooks.discount.start=2                              | hooks.discount.start and end must be discounts
hooks.log_episodes.interval=0                       | hooks.log_episodes.interval must be at least 1
hooks.log_episodes.interval=nan                     | hooks.log_episodes.interval must be a finite number
hooks.evaluate.interval=-1                          | hooks.evaluate.interval must be at least 1
hooks.fit_interpolator.episodes=0                   | hooks.fit_interpolator.episodes must be at least 1
hooks.fit_interpolator.keys=/nowhere                | /nowhere holds no policy.pt
hooks.fit_interpolator.keys=results/default loss.terms.angle=null | FitInterpolator has keys, and no term
rewards.num=0                                       | rewards.num must be at least 1
rewards.scale=nan                                   | rewards.scale must be a finite number
rewards.scale=0                                     | rewards.scale must be positive
rewards.clone.batch_size=0                          | rewards.clone.batch_size must be at least 1
rewards.clone.held_out=1                            | rewards.clone.held_out must be from 0 to below 1
rewards.clone.held_out=nan                          | rewards.clone.held_out must be a finite number
rewards.clone.fit.interval=0                        | rewards.clone.fit.interval must be at least 1
rewards.clone.fit.patience=0                        | rewards.clone.fit.patience must be at least 1
rewards.ranking.snippet=-1                          | rewards.ranking.snippet must be at least 1
rewards.ranking.snippet=0                           | rewards.ranking.snippet must be at least 1
rewards.ranking.snippet=100000                      | rewards.ranking.snippet and burn_in must be at most the 250 steps
rewards.ranking.burn_in=-1                          | rewards.ranking.burn_in must not be negative, got -1
rewards.ranking.burn_in=246                         | snippet and burn_in must be at most the 250 steps of an episode
rewards.ranking.snippet=null                        | Whole roll-outs (snippet=null) have no burn-in; set burn_in=0
rewards.ranking.levels=[0,5]                        | rewards.ranking.noise.epsilon must be between 0 and 1, got [0.0, 5.0]
rewards.ranking.batch_size=0                        | rewards.ranking.batch_size must be at least 1
rewards.ranking.held_out=2                          | held_out=2 keeps none of 4 episodes
rewards.ranking.noise.hold=0                        | rewards.ranking.noise.hold must be at least 1
rewards.audit.num_scenes=0                          | rewards.audit.num_scenes must be at least 1
rewards.audit.plans=-1                              | rewards.audit.plans must not be negative
rewards.demonstrations.demo.policy.speed=9          | rewards.demonstrations.demo.policy.speed must be at most the robot's 0.5
rewards.demonstrations.demo.num_envs=0              | rewards.demonstrations.demo.num_envs must be at least 1
refinement.drives=-1                                | refinement.drives must not be negative, got -1
refinement.horizon=0                                | refinement.horizon must be at least 1, got 0
refinement.clip=0                                   | refinement.clip must be positive, got 0
refinement.average_decay=1                          | refinement.average_decay must be from 0 to below 1
refinement.optimizer.lr=-1                          | refinement.optimizer: Invalid learning rate: -1
refinement.schedule.start=2                         | refinement.schedule.start must be from 0 to below 1
"""

KEYS = """
+foo=1                                              | foo is no argument of morlnav.trainers.Training
+trainer.totl_frames=5                              | trainer.totl_frames is no argument of morlnav.trainers.MORLTrainer; did you mean total_frames?
+env.transforms=[a]                                 | env.transforms is no argument of morlnav.navigation.envs.NavigationEnv; did you mean transforms at the root?
+env.foo=1                                          | env.foo is no argument
+replay.foo=1                                       | replay.foo is no argument
+evaluation.metrics=3                               | evaluation.metrics is no argument
+collector.foo=3                                    | collector.foo is no argument
+collector.total_frames=5                           | collector.total_frames is trainer.total_frames
hooks.evalute.interval=5                            | There is no evalute in hooks; did you mean evaluate?
critic.features.octave.low=1                        | There is no octave in critic.features; did you mean octaves?
resume.at=3                                         | There is no resume.at in the config, for resume is None
hydra.foo=1                                         | There is no hydra.foo; see --hydra-help
hooks.discount.end={demo:0.9}                       | hooks.discount.end must be
+loss.scalarisation.scale.foo=2                     | loss.scalarisation.scale names foo
+env.objectives.x.foo=1                             | env.objectives.x must be an Objective, got a mapping without _target_
compile={foo:1}                                     | compile.foo is no argument of torch.compile
compile={fullgraph:maybe}                           | compile.fullgraph must be true or false, got 'maybe'
compile={mode:nonsense}                             | compile must be null or arguments of torch.compile
loss.sharpness=3                                    | There is no sharpness in loss
trainer.totl_frames=5                               | There is no totl_frames in trainer; did you mean total_frames?
ranking.snippet=0                                   | There is no ranking.snippet in the config; did you mean rewards.ranking.snippet?
foo.bar=1                                           | There is no foo in the config; choose from
refinement.drifes=3                                 | There is no drifes in refinement; did you mean drives?
+refinement.foo=1                                   | refinement.foo is no argument of morlnav.trainers.PathwiseRefinement
+refinement.scalarisation.scale.foo=2               | refinement.scalarisation.scale names foo
rewards.demonstrations.dmeo.policy.radius=1         | There is no dmeo in rewards.demonstrations; did you mean demo?
"""

TARGETS = """
logger._target_=does.not.Exist                      | logger._target_: there is no does.not.Exist (No module named 'does')
trainer._target_=torchrl.trainers.Trainr            | did you mean torchrl.trainers.Trainer?
stepper.optimizer_actor._target_=torch.optim.Foo    | stepper.optimizer_actor._target_: there is no torch.optim.Foo
env.scenes._target_=math.pi                         | env.scenes._target_: math.pi is a float, which cannot be called
actor._target_=null                                 | actor._target_ must be the name of a class or function
env._target_=torch.nn.Linear                        | env._target_ must make an EnvBase, but torch.nn.Linear makes a Linear
env.world._target_=torch.nn.Linear                  | env.world._target_ must make a World
transforms.returns._target_=torch.nn.Identity       | transforms.returns._target_ must make a Transform
preferences._target_=torch.nn.Linear                | preferences._target_ must make a PreferenceSampler
actor._target_=torch.optim.Adam                     | actor._target_ must make a Module, but torch.optim.Adam makes an Adam
loss._target_=torch.nn.Linear                       | loss._target_ must make a MORLTD3Loss
loss.terms.angle._target_=torch.nn.Identity         | loss.terms.angle._target_ must make a LossTerm
stepper.schedule._target_=torch.optim.Adam          | stepper.schedule._target_ must make a LRScheduler
exploration._target_=torch.optim.Adam               | exploration._target_ must make a Module
replay.sampler._target_=torchrl.envs.StepCounter    | replay.sampler._target_ must make a Sampler
replay.transforms.relabel._target_=torch.nn.Linear  | replay.transforms.relabel._target_ must make a Transform
collector._target_=torchrl.data.RandomSampler       | collector._target_ must make a BaseCollector
trainer._target_=morlnav.trainers.Fit               | trainer._target_ must make a Trainer
evaluation._target_=morlnav.trainers.LogEpisodes    | evaluation._target_ must make an Evaluation
hooks.evaluate._target_=morlnav.modules.Actor       | hooks.evaluate._target_ must make a TrainerHookBase
logger._target_=torch.nn.Linear                     | logger._target_ must make a Logger
rewards._target_=torch.nn.Linear                    | rewards._target_ must make a DREX
rewards.demonstrations.demo._target_=torch.nn.GELU  | rewards.demonstrations.demo._target_ must make a Demonstrations
refinement._target_=morlnav.trainers.Fit            | refinement._target_ must make a PathwiseRefinement, but morlnav.trainers.Fit makes a Fit
refinement.optimizer._target_=torch.optim.Adma      | refinement.optimizer._target_: there is no torch.optim.Adma
"""

KINDS = """
device=null                                         | device must be a word, got null
device=nowhere                                      | device=nowhere cannot be used
device=meta                                         | device=meta holds no numbers
products=float16                                    | products must be one of auto, float32, bfloat16
seed=null                                           | seed must be a whole number, got null
cache=3                                             | cache must be a word or null, got 3
resume=3                                            | resume must be a word or null
trust=maybe                                         | trust must be true or false
threads=null                                        | threads must be a whole number, got null
compile=fast                                        | compile must be a mapping or null
loss.terms.angle.interpolator=linear                | loss.terms.angle.interpolator must be a Module or null, got 'linear'
actor.features=lidar                                | actor.features must be a Module or a whole number, got 'lidar'
rewards.audit=3                                     | rewards.audit must be a Judge or null, got 3
replay.storage=memory                               | replay.storage must be a TensorStorage, got 'memory'
loss.terms=3                                        | loss.terms must be a mapping
loss.terms.angle=3                                  | loss.terms.angle must be a LossTerm or null, got 3
loss.terms.proposals.search=3                       | loss.terms.proposals.search must be a Search or null
hooks.evaluate=3                                    | hooks.evaluate must be a TrainerHookBase or null
transforms.time_limit=3                             | transforms.time_limit must be a Transform or null
transforms.preference=null                          | transforms must draw a preference
replay.transforms=3                                 | replay.transforms must be a mapping
replay.storage=null                                 | replay.storage must be
replay.sampler=null                                 | replay.sampler must be a Sampler, got null
stepper.optimizer_actor=null                        | stepper.optimizer_actor must be an Optimizer, got null
stepper.target_net_updater=null                     | stepper.target_net_updater must be a TargetNetUpdater
actor.features=null                                 | actor.features must be a Module or a whole number, got null
trainer.total_frames=null                           | trainer.total_frames must be a whole number, got null
collector.frames_per_batch=null                     | collector.frames_per_batch must be a whole number, got null
evaluation.reference=3                              | evaluation.reference must be a list
rewards.clone=null                                  | rewards.clone must be a Cloning, got null
rewards.ranking=null                                | rewards.ranking must be a Ranking, got null
rewards.demonstrations={demo:3}                     | rewards.demonstrations.demo must be a Demonstrations or null, got 3
~actor                                              | actor is missing; morlnav.trainers.Training needs it
~loss                                               | loss must be a MORLTD3Loss, got a mapping without _target_
~trainer.total_frames                               | trainer.total_frames is missing
refinement.schedule=3                               | refinement.schedule must be a LRScheduler or null, got 3
"""

CHOICES = """
env=foo                                             | There is no env/foo; choose from: mo_gymnasium, navigation, own
trainer=defalt                                      | There is no trainer/defalt; did you mean default?
objectives=[baseline,foo]                           | There is no objectives/foo; choose from: baseline, demo, distance
objectives=[baseline]                               | Every objective is static, so that λ has none to weigh
objectives=[]                                       | env: The environment needs at least one objective
objectives=[distance,baseline]                      | Static objectives must come before tuneable ones
objectives=[baseline,distance] +loss.scalarisation.scale.efficiency=1 | loss.scalarisation.scale names efficiency
preferences=fixed                                   | preferences.value is missing
preferences=fixed preferences.value=[1]             | preferences: A fixed preference must be one number for each of 3
preferences=grid preferences.steps=0                | preferences.steps must be at least 1
preferences=keys preferences.noise=0.5              | preferences.noise must be at least 0 and below 1
preferences=segments preferences.segments=0         | preferences.segments must be at least 1
demonstrations=recorded                             | rewards.demonstrations.demo.path is missing
demonstrations=recorded rewards.demonstrations.demo.path=/nowhere | /nowhere holds no demonstrations
env=mo_gymnasium                                    | env.id is missing; give it as env.id=VALUE
env=mo_gymnasium env.id=mo-hopper-2obj-v5 objectives=[distance] | The group objectives (baseline, demo, distance
env=mo_gymnasium env.id=mo-hopper-2obj-v5 critic=navigation | loss, with actor and critic: Expected observations [..., 34]
env=mo_gymnasium env.id=mo-hopper-2obj-v5 evaluation=navigation | evaluation: NavigationEvaluation measures a NavigationEnv
env._target_=morlnav.navigation.envs.GymNavigation  | did you mean morlnav.navigation.envs.NavigationEnv?
env=own                                             | env._target_ is missing
env=own env._target_=nobody.Here                    | env._target_: there is no nobody.Here (No module named 'nobody')
ablation=foo                                        | There is no ablation/foo
world=pymunk env.world.lidar.sectors=0              | env.world.lidar: 0 sectors must divide
evaluation=front evaluation.episodes=0              | evaluation.episodes must be at least 1
refinement=pathwies                                 | There is no refinement/pathwies; did you mean pathwise?
ranking=compared                                    | rewards.ranking.comparisons.path is missing
ranking=compared rewards.ranking.comparisons.path=/nowhere | There is no file of comparisons /nowhere/comparisons.jsonl
ranking=bonn rewards.ranking.comparisons.path=/nowhere | rewards.ranking.comparisons: The study of Bonn had 60 sectors
"""


def cases(text):
    lines = [line.split(" | ") for line in text.strip().splitlines()]
    return [pytest.param(shlex.split(words), said.strip(), id=words.strip()) for words, said in lines]


@pytest.fixture(scope="module")
def smoke():
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return compose("train", list(SMOKE))


def composed(words, smoke):
    """What Hydra composes, which takes half a second; values alone are set as Hydra does, on what was composed before."""
    words_of = OverridesParser.create().parse_overrides(words)
    cfg, known = copy.deepcopy(smoke), all(word.is_add() or _has(smoke, word.key_or_group) for word in words_of)
    if not known or any(word.is_delete() or _group(word) for word in words_of):
        with initialize_config_dir(conf_dir(), version_base="1.3"):
            return compose("train", [*SMOKE, *words])
    for word in words_of:
        OmegaConf.update(cfg, word.key_or_group, word.value(), merge=True, force_add=word.is_add())
    return cfg


def _has(cfg, key):
    parent, _, name = key.rpartition(".")
    node = OmegaConf.select(cfg, parent, throw_on_missing=False) if parent else cfg
    return OmegaConf.is_dict(node) and name in node


def _group(word):
    return os.path.isdir(os.path.join(conf_dir(), word.key_or_group))


@pytest.mark.parametrize(("words", "said"), cases(NUMBERS + KEYS[1:] + TARGETS[1:] + KINDS[1:] + CHOICES[1:]))
def test_what_is_wrong_ends_in_one_sentence_that_names_it(words, said, smoke, tmp_path):
    with pytest.raises(SystemExit) as refused, one_sentence_errors():
        run(composed(words, smoke), tmp_path / "run")
    sentence = refused.value.code
    assert said in sentence
    assert "\n" not in sentence
    assert "Traceback" not in sentence
    assert not (tmp_path / "run").exists(), "nothing is written"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["loss=null"], "loss=null is no choice of the group loss: morl_td3; ~loss leaves it out."),
        (["~env"], "~env leaves out what others depend on; choose another with env=NAME."),
        (["logger.interval=0"], "There is no interval in logger."),
        (["hooks=3"], "hooks=3 is no choice of the group hooks: default; ~hooks leaves it out."),
        (["objectives=[baseline,distance,distance]"], "objectives names distance twice."),
        (["objectives=[baseline,3]"], "objectives names 3; choose from: baseline, demo, distance"),
        (["env.objectives=[distance]"], "env.objectives cannot become [distance]; --cfg job shows what it is."),
        (["env=mo_gymnasium", "env.foo=1"], "There is no foo in env; choose from: id, num_envs."),
        (["env.objectives={}"], "env.objectives={} would change nothing"),
        (["+trainer.totl_frames=5"], "did you mean total_frames?"),
        (["seed=0,1"], "seed=0,1 names several values; morlnav-train -m trains with each"),
        (["trainer=[smoke,paper]"], "trainer is one of default, paper, smoke, and not several."),
        (["hydra/sweeper=optuna"], "hydra/sweeper=optuna is about sweeps; add -m."),
        (["hydra.sweep.dir=here"], "hydra.sweep.dir=here is about sweeps; add -m."),
        (["-m", "hydra.run.dir=here"], "hydra.run.dir=here is about a single run; a sweep takes hydra.sweep.dir."),
        (["-m", "seed=0,1", "trainer=smoke,fast"], "There is no trainer/fast; choose from: default, paper, smoke."),
        (["-m", "seed=0,1", "foo=3"], "There is no foo in the config"),
        (["-m", "seed=0,-1", "threads=0"], "threads must be from 1 to 1024, got 0"),
    ],
)
def test_the_command_line_refuses_it_too(words, said, train_command, tmp_path):
    with pytest.raises(SystemExit) as refused:
        train_command(*SMOKE, *words)
    assert said in refused.value.code
    assert not list(tmp_path.iterdir()), "nothing is written"


FILES = {
    "preferences/mine": "_target_: morlnav.data.CornerWeightedPreferences\ncorners: 0.5\n",
    "experiment/typo": "# @package _global_\ntrainer: {totl_frames: 3}\n",
    "experiment/deep": "# @package _global_\nloss: {terms: {angle: {actr: 0.1}}}\n",
    "experiment/broken": "# @package _global_\nloss: {terms: [\n",
    "experiment/nowhere": "trainer: {total_frames: 3}\n",
    "experiment/list": "- 1\n- 2\n",
}


@pytest.mark.parametrize(
    ("word", "said"),
    [
        (
            "preferences=mine",
            "preferences.corners is no argument of morlnav.data.CornerWeightedPreferences; did you mean corner?",
        ),
        ("preferences=mien", "There is no preferences/mien; did you mean mine?"),
        (
            "+experiment=typo",
            "trainer.totl_frames is no argument of morlnav.trainers.MORLTrainer; did you mean total_frames?",
        ),
        (
            "+experiment=deep",
            "loss.terms.angle.actr is no argument of morlnav.objectives.AngleTerm; did you mean actor?",
        ),
        (
            "+experiment=broken",
            "experiment/broken.yaml is no YAML: expected the node content, but found '<stream end>' in line 3.",
        ),
        ("+experiment=nowhere", "experiment is no argument of morlnav.trainers.Training"),
        ("+experiment=list", "experiment is no argument of morlnav.trainers.Training"),
        ("+experiment=nosuch", "There is no experiment/nosuch"),
    ],
)
def test_a_file_of_the_users_own_is_refused_too(word, said, train_command, tmp_path):
    for name, text in FILES.items():
        (tmp_path / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mine" / f"{name}.yaml").write_text(text)
    with pytest.raises(SystemExit) as refused:
        train_command(*SMOKE, "objectives=[baseline,distance]", word, "--config-dir", "mine")
    assert said in refused.value.code
    assert [path.name for path in tmp_path.iterdir()] == ["mine"], "nothing is written"


OWN = """
class Fails:
    def __init__(self, penalty=1.0):
        raise RuntimeError(f"no room: {penalty} is in the way")

    def __call__(self, transition):
        return transition.goal_distance
"""


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("import pandaz\n", "env.objectives.own._target_: there is no my_parts.Fails (No module named 'pandaz')."),
        ("class Fails\n", "(expected ':' (my_parts.py, line 1))"),
        ("class Fail: ...\n", "did you mean my_parts.Fail?"),
    ],
    ids=["import", "syntax", "name"],
)
def test_a_module_of_the_users_own_that_fails_is_named_with_its_cause(module, said, train_command, tmp_path):
    (tmp_path / "my_parts.py").write_text(module)
    with pytest.raises(SystemExit) as refused:
        train_command(*SMOKE, "objectives=[baseline,distance]", "+env.objectives.own._target_=my_parts.Fails")
    assert said in refused.value.code
    sys.modules.pop("my_parts", None)


def test_a_constructor_of_the_users_own_that_fails_is_all_that_a_terminal_shows(tmp_path):
    (tmp_path / "my_parts.py").write_text(OWN)
    words = [*SMOKE, "objectives=[baseline,distance]", "+env.objectives.own._target_=my_parts.Fails"]
    command = [sys.executable, "-m", "morlnav.commands.train", *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "env.objectives.own: RuntimeError: no room: 1.0 is in the way\n"
    assert done.stdout == ""
    assert {path.name for path in tmp_path.iterdir()} <= {"my_parts.py", "__pycache__"}
