"""The command line of a resumed run: the words that it began with, which run no code of strangers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException
from omegaconf import OmegaConf

from morlnav.cli import conf_dir
from morlnav.runs.config import CONFIG_FILE, load_config, read_yaml
from morlnav.runs.trust import foreign_targets, refusal, targets

IN_HYDRA = ("callbacks", "job_logging", "hydra_logging", "launcher", "sweeper", "job.env_set", "job.chdir")
TRUST = "if it is your own, add trust=true to the command line"


def resumed_words(words: Sequence[str]) -> tuple[list[str], bool]:
    """What a resumed run is composed of: the words that it began with, and then those of this command line.

    Args:
        words: of the command line.

    Returns:
        The words, and whether classes of the user's own may be imported. Both are as they were without ``resume=``.

    Raises:
        ValueError: if the directory holds no run, its words are no words of a run, or they name code from outside
            this package and the command line does not say ``trust=true``.

    Examples:
        >>> resumed_words(["trainer=smoke"])
        (['trainer=smoke'], True)
        >>> resumed_words(["resume=nowhere"])
        Traceback (most recent call last):
        ValueError: resume=nowhere: no run of morlnav-train there.
    """
    places = [_unquoted(word.removeprefix("resume=")) for word in words if word.startswith("resume=")]
    if not places:
        return list(words), True
    place, trust = Path(places[-1]), "trust=true" in map(str.lower, words)
    typed = [word for word in words if not word.startswith(("resume=", "trust="))]
    if {"-m", "--multirun"} & set(typed):
        raise ValueError(f"resume={place} continues one run; leave out -m.")
    directory = place.parent.parent if place.parent.name == "checkpoints" else place
    if not (directory / ".hydra" / "overrides.yaml").is_file():
        raise ValueError(f"resume={place}: no run of morlnav-train there.")
    if (directory / CONFIG_FILE).is_file():
        load_config(directory, of_this_version=True)
    began = _words_of_a_run(directory / ".hydra" / "overrides.yaml")
    folders = _folders_of_configs(directory / ".hydra" / "hydra.yaml", trust)
    joined = [*folders, *began, *typed]
    if not trust:
        _check(joined, typed, directory)
    return [*joined, f"resume={quoted(place)}", f"hydra.run.dir={quoted(directory)}"], trust


def options_first(words: Sequence[str]) -> list[str]:
    """The words in an order that Hydra's parser takes, which wants all overrides in one place.

    >>> options_first(["trainer=smoke", "-m", "seed=0,1"])
    ['-m', 'trainer=smoke', 'seed=0,1']
    """
    overrides, options = get_args_parser().parse_intermixed_args(list(words)).overrides, list(words)
    for word in overrides:
        options.remove(word)
    return [*options, *overrides]


def _words_of_a_run(path: Path) -> list[str]:
    """The words that a run began with; options, and what would change Hydra itself, are never among them."""
    words, parser = read_yaml(path), OverridesParser.create()
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise ValueError(f"{path} is damaged: it is no list of words.")
    for word in words:
        try:
            refused = parser.parse_override(word).is_hydra_override()
        except HydraException:
            refused = True
        if refused:
            raise ValueError(f"{path} holds {word}, which no run keeps there; nothing was run.")
    return [word for word in words if not word.startswith(("resume=", "trust="))]


def _folders_of_configs(path: Path, trust: bool) -> list[str]:
    """The words that named other folders of configs when a run began; Hydra does not count them as its overrides."""
    if not path.is_file():
        return []
    try:
        settings = read_yaml(path)["hydra"]
        sources = [source for source in settings["runtime"]["config_sources"] if source["provider"] == "command-line"]
        folders = [str(source["path"]) for source in sources]
        searched = [word for word in settings["overrides"]["hydra"] if str(word).startswith("hydra.searchpath=")]
        places = [place for word in searched for place in _search_path(word)]
    except (KeyError, TypeError, HydraException) as error:
        raise ValueError(f"{path} is damaged: it does not say where the run's configs come from.") from error
    for place in places:
        if not trust and ("${" in place or ":" in place.removeprefix("file://")):  # a package would be imported
            raise ValueError(f"This run takes configs from {place}; {TRUST}.")
    return [*(word for folder in folders for word in ("--config-dir", folder)), *searched]


def _search_path(word: str) -> list[str]:
    return [str(place) for place in OverridesParser.create().parse_override(word).value()]


def quoted(text: object) -> str:
    r"""A value as one word of Hydra, whatever quotes, spaces, ``=`` or ``,`` it holds.

    >>> print(quoted("q'uote"))
    'q\'uote'
    """
    return QuotedString(str(text), Quote.single).with_quotes()


def _unquoted(text: str) -> str:
    """What Hydra reads from a value; a path may hold what Hydra would want in quotes."""
    try:
        return str(OverridesParser.create().parse_override(f"resume={text}").value()) if text[:1] in "'\"" else text
    except HydraException:
        return text


def _check(words: Sequence[str], typed: Sequence[str], directory: Path) -> None:
    """Compose the run as Hydra will, which builds nothing, and refuse what would be built from outside the package."""
    args, own = (get_args_parser().parse_intermixed_args(list(some)) for some in (words, typed))
    searched = [word for word in args.overrides if word.startswith("hydra.searchpath=")]
    folders = [f"file://{Path(args.config_dir).resolve()}"] if args.config_dir else []
    folders += _search_path(searched[0]) if searched else []  # the first one counts
    place = ",".join(map(quoted, folders))
    rest = [word for word in args.overrides if not word.startswith("hydra.searchpath=")]
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        cfg = compose("train", [*rest, f"hydra.searchpath=[{place}]", f"hydra.run.dir={quoted(directory)}"], True)
        plain = compose(
            "train", [word for word in own.overrides if word.lstrip("+~").startswith(("hydra.", "hydra/"))], True
        )
    for part in IN_HYDRA:
        if OmegaConf.select(cfg.hydra, part) != OmegaConf.select(plain.hydra, part):
            raise ValueError(f"This run changes hydra.{part}; {TRUST}.")
    OmegaConf.set_struct(cfg, False)
    del cfg["hydra"]
    for resolve in (False, True):
        check_training(OmegaConf.to_container(cfg, resolve=resolve))


def check_training(config: Mapping[str, Any]) -> None:
    """Refuse a config from which training would build anything from outside this package, but for known classes.

    Raises:
        ValueError: naming it, and how to trust it.

    Examples:
        >>> check_training({"objectives": {"calm": {"_target_": "shutil.copyfile"}}})
        Traceback (most recent call last):
        ValueError: This run uses the foreign shutil.copyfile; if it is your own, add trust=true to the command line.
    """
    if made_up := [target for target in targets(config) if "${" in target]:  # it could turn into another one later
        raise ValueError(f"This run makes up the name of a class by {made_up[0]}; {TRUST}.")
    if foreign := foreign_targets(config):
        raise ValueError(refusal(foreign[0], TRUST))
    # Other backends and options of the compiler may name programs.
    backend, options = (config.get(name) or {} for name in ("collector", "compile"))
    if backend.get("backend") not in (None, "direct", "process"):
        raise ValueError(f"This run collects by the backend {backend['backend']}; {TRUST}.")
    if moved := [name for name in ("log_dir", "save_dir") if name in (config.get("logger") or {})]:
        raise ValueError(f"This run sets logger.{moved[0]}, and would write elsewhere; {TRUST}.")
    if options.get("options") is not None:
        raise ValueError(f"This run sets compile.options; {TRUST}.")
