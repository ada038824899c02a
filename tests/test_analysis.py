import shutil

import pandas as pd
import pytest
from omegaconf import OmegaConf

from morlnav.analysis import load_episodes, load_fronts, load_run, load_settings, load_summaries, load_sweep
from morlnav.record.loggers import TensorboardCSVLogger


def log(directory, values):
    """Log ``(name, value, step)`` by a logger of their own, until TensorBoard's thread has written them."""
    logger = TensorboardCSVLogger("logs", directory)
    for name, value, step in values:
        logger.log_scalar(name, value, step=step)
    logger.experiment[1].experiment.flush()


def make_run(directory, values=(0.25, 0.5), evaluated=True, **config):
    times = "evaluation/navigation_time/distance=0.5,efficiency=0.5"
    steps = [(value, 10 * step) for step, value in enumerate(values, start=1)]
    log(directory, [row for value, step in steps for row in (("train/success", value, step), (times, 2 * value, step))])
    OmegaConf.save(
        {"seed": 0, "resume": None, "loss": {"gamma": 0.9, "angles": {"none": None}}} | config,
        directory / "config.yaml",
    )
    if evaluated:
        (directory / "evaluation").mkdir()
        for name in ("episodes", "summary", "front"):
            table = pd.DataFrame({"lambda_distance": [1.0, 0.0], name: values[:1] * 2})
            table.to_csv(directory / "evaluation" / f"{name}.csv", index=False)
    return directory


def test_a_run_is_one_long_table(tmp_path):
    logs = load_run(make_run(tmp_path / "first"))
    assert logs.to_dict("list") == {
        "run": ["first"] * 4,
        "metric": ["evaluation/navigation_time/distance=0.5,efficiency=0.5"] * 2 + ["train/success"] * 2,
        "step": [10, 20, 10, 20],
        "value": [0.5, 1.0, 0.25, 0.5],
    }


def test_an_interrupted_run_has_logs_but_no_evaluation(tmp_path):
    directory = make_run(tmp_path / "first", evaluated=False)
    assert len(load_run(str(directory))) == 4
    for load in (load_episodes, load_summaries, load_fronts):
        with pytest.raises(FileNotFoundError, match=r"None of the runs first has .* morlnav-evaluate"):
            load(directory)


def test_steps_that_a_resumed_run_repeats_count_once(tmp_path):
    directory = make_run(tmp_path / "first", values=(0.1, 0.2))
    log(directory, [("train/success", 0.9, 20)])
    assert load_run(directory).query("metric == 'train/success'")["value"].tolist() == [0.1, 0.9]


def test_events_of_tensorboard_stand_in_for_missing_csv_files(tmp_path):
    for seed in (0, 1):
        directory = make_run(tmp_path / f"{seed}", values=[(step + seed) / 7 for step in range(2000)], seed=seed)
        log(directory, [("train/success", 0.9, 20)])  # resumed: another file
    from_csv = load_sweep(tmp_path)
    for seed in (0, 1):
        shutil.rmtree(tmp_path / f"{seed}" / "logs" / "scalars")
    pd.testing.assert_frame_equal(load_sweep(tmp_path), from_csv, rtol=1e-6)
    assert len(from_csv) == 8000


def test_of_files_of_one_second_the_later_counts_whatever_their_names(tmp_path):
    for run in range(6):  # TensorBoard numbers its files, and 10 stands before 9 in the alphabet
        directory = make_run(tmp_path / f"{run}", values=(0.1, 0.2))
        log(directory, [("train/success", 0.9, 20)])
        log(directory, [("train/success", 0.8, 20)])
        shutil.rmtree(directory / "logs" / "scalars")
        assert load_run(directory).query("metric == 'train/success'")["value"].tolist() == pytest.approx([0.1, 0.8])


def test_a_sweep_shows_the_settings_that_differ(tmp_path):
    make_run(tmp_path / "0", seed=0)
    make_run(tmp_path / "1", values=(0.75,), seed=1, loss={"gamma": 0.95, "angles": {"none": None}}, resume="elsewhere")
    make_run(tmp_path / "2", values=(), evaluated=False, seed=2)  # has only just begun
    (tmp_path / ".hydra").mkdir()
    logs = load_sweep(tmp_path)
    assert list(logs) == ["run", "seed", "loss.gamma", "metric", "step", "value"]
    settings = logs[["run", "seed", "loss.gamma"]].drop_duplicates().to_numpy().tolist()
    assert settings == [["0", 0, 0.9], ["1", 1, 0.95]]
    assert logs.groupby("run").size().to_dict() == {"0": 4, "1": 2}


def type_words(directory, *words, **choices):
    (directory / ".hydra").mkdir()
    OmegaConf.save(list(words), directory / ".hydra" / "overrides.yaml")
    if choices:
        OmegaConf.save({"hydra": {"runtime": {"choices": choices}}}, directory / ".hydra" / "hydra.yaml")


def columns_of(table):
    return list(table)[1 : list(table).index("metric")]


def test_a_setting_is_named_by_the_word_that_was_typed(tmp_path):
    for number, (seed, ablation) in enumerate([(0, "our"), (1, "our"), (0, "no_human"), (1, "no_human")]):
        sees = ablation == "our"
        config = {"env": {"observe_human": sees}, "ranking": {"observe_human": sees}, "demonstrations": {"seed": seed}}
        run = make_run(tmp_path / f"{number}", seed=seed, **config)
        type_words(run, f"seed={seed}", f"ablation={ablation}", "threads=1")
    table = load_sweep(tmp_path)
    assert columns_of(table) == ["seed", "ablation"]
    runs = table.drop_duplicates("run")[["seed", "ablation"]].values.tolist()
    assert runs == [[0, "our"], [1, "our"], [0, "no_human"], [1, "no_human"]]


def test_a_choice_that_one_run_did_not_type_is_known_from_hydra(tmp_path):
    type_words(make_run(tmp_path / "0", sees=True), "seed=0", ablation="our", trainer="smoke")
    type_words(
        make_run(tmp_path / "1", sees=False), "seed=0", "ablation=no_human", ablation="no_human", trainer="smoke"
    )
    table = load_sweep(tmp_path)
    assert columns_of(table) == ["ablation"]
    assert table["ablation"].unique().tolist() == ["our", "no_human"]


def test_a_run_that_typed_nothing_stands_beside_one_that_did(tmp_path):
    make_run(tmp_path / "0", sees=True)
    type_words(make_run(tmp_path / "1", sees=False), "ablation=no_human")
    assert load_sweep(tmp_path).drop_duplicates("run")["ablation"].tolist()[1] == "no_human"


def test_what_words_do_not_explain_is_named_too(tmp_path):
    for number, (seed, gamma) in enumerate([(1, 0.9), (2, 0.9), (1, 0.95), (2, 0.95)]):  # another default in between
        type_words(make_run(tmp_path / f"{number}", seed=seed, loss={"gamma": gamma}), f"seed={seed}")
    table = load_sweep(tmp_path)
    assert columns_of(table) == ["seed", "loss.gamma"]
    assert table.drop_duplicates("run")["loss.gamma"].tolist() == [0.9, 0.9, 0.95, 0.95]


def test_a_run_of_a_sweep_is_called_by_the_words_that_were_typed(tmp_path):
    for number, words in enumerate(["our", "[no_human,state_reward]", "our"]):
        run = make_run(tmp_path / f"{number}", seed=number, sees=words == "our", objectives=words)
        type_words(run, f"ablation={words}", f"seed={number}", ablation=words, objectives=words)
    table = load_settings(tmp_path)
    assert table["setting"].tolist() == ["our", "no_human,state_reward", "our"]
    assert table["seed"].tolist() == [0, 1, 2]
    assert table["path"][1] == tmp_path / "1"


def test_other_words_and_what_no_word_explains_are_named_too(tmp_path):
    for number, (ablation, clip, gamma) in enumerate([("our", 0.5, 0.9), ("our", 1.0, 0.9), ("no_angle", 0.5, 0.8)]):
        run = make_run(tmp_path / f"{number}", loss={"noise_clip": clip, "gamma": gamma})
        type_words(run, f"ablation={ablation}", f"loss.noise_clip={clip}")
    assert load_settings(tmp_path)["setting"].tolist() == ["our", "our, loss.noise_clip=1.0", "no_angle"]
    assert load_settings([tmp_path / "0", tmp_path / "1"])["setting"].tolist()[0] == "loss.noise_clip=0.5"
    untold = [make_run(tmp_path / name, loss={"gamma": gamma}) for name, gamma in {"a": 0.9, "b": 0.8}.items()]
    assert load_settings(untold)["setting"].tolist() == ["loss.gamma=0.9", "loss.gamma=0.8"]
    assert load_settings(untold[:1])["setting"].tolist() == ["our"]


def test_what_half_of_the_settings_have_alike_is_named(tmp_path):
    tried = [("our", 0.5), ("our", 1.0), ("no_angle", 0.5), ("no_angle", 1.0)]
    for number, (ablation, clip) in enumerate([*tried, tried[0], tried[0]]):  # more seeds of one are one setting
        run = make_run(tmp_path / f"{number}", loss={"noise_clip": clip}, seed=number)
        type_words(run, f"ablation={ablation}", f"loss.noise_clip={clip}")
    named = [f"{ablation}, loss.noise_clip={clip}" for ablation, clip in tried]
    assert load_settings(tmp_path)["setting"].tolist() == [*named, named[0], named[0]]


def test_what_most_settings_leave_out_is_not_named(tmp_path):
    for number, (gamma, keys) in enumerate([(0.8, None), (0.9, None), (0.95, None), (0.8, "outputs/keys")]):
        run = make_run(tmp_path / f"{number}", loss={"gamma": gamma}, keys=keys)
        type_words(run, f"loss.gamma={gamma}", *([f"keys={keys}"] if keys else []))
    make_run(tmp_path / "old", loss={"gamma": 0.99})  # of a version without keys
    assert load_settings(tmp_path)["setting"].tolist() == [
        "loss.gamma=0.8",
        "loss.gamma=0.9",
        "loss.gamma=0.95",
        "loss.gamma=0.8, keys=outputs/keys",
        "loss.gamma=0.99",
    ]


def test_what_hydra_noted_may_be_damaged(tmp_path):
    type_words(make_run(tmp_path / "0"), "seed=0")
    (tmp_path / "0" / ".hydra" / "hydra.yaml").write_text("[]")
    with pytest.raises(ValueError, match=r"hydra\.yaml is damaged"):
        load_settings(tmp_path)


def test_settings_may_be_lists_and_may_be_missing(tmp_path):
    make_run(tmp_path / "a", cells=[64, 64])
    make_run(tmp_path / "b", cells=[32])
    make_run(tmp_path / "c")
    settings = load_sweep(tmp_path).drop_duplicates("run").set_index("run")["cells"]
    assert settings["a"] == "[64, 64]"
    assert pd.isna(settings["c"])


def test_a_file_that_every_run_keeps_for_itself_is_no_setting(tmp_path):
    for seed in (0, 1):
        demo = {"reward": {"path": "where/the/run/was/made/reward.pt"}}
        directory = make_run(tmp_path / f"{seed}", seed=seed, objectives={"demo": demo})
        (directory / "reward.pt").touch()
    assert list(load_sweep(tmp_path)) == ["run", "seed", "metric", "step", "value"]


def test_a_single_run_is_a_sweep_of_one(tmp_path):
    directory = make_run(tmp_path / "only")
    pd.testing.assert_frame_equal(load_sweep(directory), load_run(directory))


def test_runs_of_the_same_name_are_told_apart(tmp_path):
    runs = [make_run(tmp_path / day / "0") for day in ("monday", "tuesday")]
    assert load_sweep(runs)["run"].unique().tolist() == ["monday/0", "tuesday/0"]


@pytest.mark.parametrize(
    ("load", "name"), [(load_episodes, "episodes"), (load_summaries, "summary"), (load_fronts, "front")]
)
def test_evaluations_of_a_sweep_are_stacked(tmp_path, load, name):
    make_run(tmp_path / "0", values=(0.25,), seed=3)
    make_run(tmp_path / "1", values=(0.75,), seed=4)
    make_run(tmp_path / "2", evaluated=False, seed=5)
    assert load(tmp_path).to_dict("list") == {
        "run": ["0", "0", "1", "1"],
        "seed": [3, 3, 4, 4],
        "lambda_distance": [1.0, 0.0, 1.0, 0.0],
        name: [0.25, 0.25, 0.75, 0.75],
    }


def test_what_holds_no_runs_is_explained(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no runs"):
        load_sweep(tmp_path)
    with pytest.raises(FileNotFoundError, match="not a run directory"):
        load_run(tmp_path / "missing")
    with pytest.raises(ValueError, match="No run directories"):
        load_fronts([])
    make_run(tmp_path / "0", values=(), evaluated=False)
    with pytest.raises(FileNotFoundError, match="None of the runs 0 has logged scalars"):
        load_sweep(tmp_path)
