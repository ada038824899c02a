"""What the command lines share."""

from __future__ import annotations

import argparse
import ctypes
import io
import logging
import os
import re
import select
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import ConfigCompositionException, HydraException, InstantiationException, MissingConfigException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from torchrl.checkpoint import CheckpointError
from yaml import MarkedYAMLError

from morlnav.files import is_full
from morlnav.sentences import first_line, nearest

MOST_THREADS = 1024
"""With a million, OpenMP ends the process without a word."""


def conf_dir() -> str:
    """The folder of configs: inside the installed package, or beside it in a checkout.

    >>> (Path(conf_dir()) / "train.yaml").is_file()
    True
    """
    inside = Path(__file__).parent / "conf"
    return str(inside if inside.is_dir() else Path(__file__).parents[1] / "conf")


def composed(words: Sequence[str] = ()) -> DictConfig:
    """The config of ``morlnav-train`` with these words.

    >>> composed(["seed=3"]).seed
    3
    """
    refuse_choices(words)
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return compose("train", list(words))


def quiet() -> None:
    """Keep the libraries' notes to developers off a user's screen, and print what a terminal cannot show as ``?``."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    logging.getLogger("hydra.utils").setLevel(logging.CRITICAL)  # tells at length what our sentence tells
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", category=FutureWarning, module="torchrl")
    warnings.filterwarnings("ignore", message=".*init_random_frames.*")
    sys.unraisablehook = _unless_full


def _unless_full(unraisable: Any) -> None:
    """What is closed at exit would repeat at length that the disk is full."""
    if not is_full(unraisable.exc_value):
        sys.__unraisablehook__(unraisable)


def keep_freed_memory() -> None:
    """Let glibc keep the memory of freed tensors for the next ones; elsewhere nothing.

    Returned to the system after every update, it comes back as a thousand page faults, a fifth of an update's time.
    """
    libc = ctypes.CDLL(None) if sys.platform == "linux" else None
    if hasattr(libc, "mallopt"):
        trim_threshold, mmap_threshold = -1, -3  # names of <malloc.h>
        libc.mallopt(trim_threshold, 2**29)
        libc.mallopt(mmap_threshold, 2**25)


def folder(word: str) -> Path:
    """A folder that a command line names for results; what could not be written there is refused before it is made.

    >>> folder("outputs/clone").name
    'clone'
    >>> folder(__file__)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    argparse.ArgumentTypeError: .../cli.py is a file, and no folder for results.
    """
    try:
        return writable(Path(word))
    except OSError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def writable(path: Path) -> Path:
    """A folder for results, before any work is done for them; it need not be there yet.

    Raises:
        OSError: if nothing could be written there.
    """
    there = next((place for place in (path, *path.absolute().parents) if place.exists()), path)
    if not there.is_dir():
        raise NotADirectoryError(f"{there} is a file, and no folder for results.")
    if not os.access(there, os.W_OK):
        raise PermissionError(f"{there} may not be written to; name another folder for results.")
    return path


def set_threads(number: int) -> None:
    """Let PyTorch compute with so many threads.

    Raises:
        ValueError: for less than one, or more than any machine can start.
    """
    if not 1 <= number <= MOST_THREADS:
        raise ValueError(f"threads must be from 1 to {MOST_THREADS}, got {number}.")
    torch.set_num_threads(number)


@contextmanager
def one_sentence_errors(own_classes: bool = False) -> Iterator[None]:
    """Turn a user's mistake into one sentence on standard error and exit status 1.

    Args:
        own_classes: let a config name classes from the present folder.

    A reader that has seen enough, as ``head``, ends the command without a word.

    >>> with one_sentence_errors():
    ...     raise ValueError("Seeds must not be negative.")
    Traceback (most recent call last):
    SystemExit: Seeds must not be negative.
    """
    if own_classes:
        sys.path.insert(0, os.getcwd())
    try:
        try:
            yield
        finally:
            sys.stdout.flush()  # here, not at the interpreter's exit, which would complain
    except BrokenPipeError:
        if not _nobody_reads():
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit("Interrupted.")
    except InstantiationException as error:
        sys.exit(first_line(error.__cause__ or error))
    except MarkedYAMLError as error:
        where = error.problem_mark or error.context_mark
        sys.exit(f"{where.name} is no YAML: {error.problem} in line {where.line + 1}.")
    except MissingConfigException as error:
        sys.exit(_unknown_choice(str(error.missing_cfg_file), error.options))
    except ConfigCompositionException as error:
        if key := re.search(r"Could not override '(.+?)'", str(error)):
            sys.exit(_unknown_key(key[1]))
        if several := re.match(r"Ambiguous value for argument '(.+)'", str(error)):
            sys.exit(f"{several[1]} names several values; morlnav-train -m trains with each, and quotes make them one.")
        gone = [word[1:] for word in sys.argv[1:] if word.startswith("~")]
        if gone and str(error).startswith("Error resolving interpolation"):
            sys.exit(f"~{gone[0]} leaves out what others depend on; choose another with {gone[0]}=NAME.")
        mixed = re.search(r"Error merging override [+]*(.+?)=(.*)", str(error))
        sys.exit(f"{mixed[1]} cannot become {mixed[2]}; --cfg job shows what it is." if mixed else first_line(error))
    except (
        ValueError,
        OSError,
        CheckpointError,
        OmegaConfBaseException,
        HydraException,
    ) as error:
        if str(error).startswith("Config group override must be"):
            sys.exit(_no_choice(sys.argv[1:]))
        sys.exit(_of_the_system(error) if isinstance(error, OSError) and error.strerror else first_line(error))


def _nobody_reads() -> bool:
    """Whether it is the standard output that is closed at its other end, and not the pipe to a worker."""
    if not hasattr(select, "poll"):  # Windows
        return True
    poll = select.poll()
    poll.register(sys.stdout.fileno(), 0)
    return bool(poll.poll(0))


def _of_the_system(error: OSError) -> str:
    """What to say of a file that could not be read or written.

    >>> _of_the_system(PermissionError(13, "Permission denied", "run/config.yaml"))
    'run/config.yaml: permission denied.'
    """
    advice = "; make room, and start the command again" if is_full(error) else ""
    where, why = error.filename or "A file", error.strerror[:1].lower() + error.strerror[1:]
    return f"{where}: {why}{advice}."


def _choices(group: str) -> list[str]:
    return sorted(path.stem for path in (Path(conf_dir()) / group).glob("*.yaml"))


def _unknown_choice(choice: str, options: Sequence[str] | None) -> str:
    group, _, name = choice.rpartition("/")
    return f"There is no {choice}; {nearest(name, options or _choices(group))}"


def _no_choice(words: Sequence[str]) -> str:
    """What to say of a number, or of ``null``, where a group wants one of its choices."""
    for key, _, value in (word.partition("=") for word in words):
        if (choices := _choices(key)) and re.fullmatch(r"null|true|false|[-+.\d]*", value, re.IGNORECASE):
            return f"{key}={value} is no choice of the group {key}: {', '.join(choices)}; ~{key} leaves it out."
    return "A group needs one of its choices, GROUP=CHOICE; see --help."


def refuse_choices(words: Sequence[str]) -> None:
    """Refuse what Hydra takes without a word: a choice that is named twice, and one that is not a user's to make.

    >>> refuse_choices(["objectives=[distance,distance]"])
    Traceback (most recent call last):
    ValueError: objectives names distance twice.
    >>> refuse_choices(["brief=long"])
    Traceback (most recent call last):
    ValueError: brief follows trainer and env; choose them instead.
    >>> refuse_choices(["env=[own,navigation]"])
    Traceback (most recent call last):
    ValueError: env is one of mo_gymnasium, navigation, own, and not several.
    >>> refuse_choices(["env.objectives={}"])
    Traceback (most recent call last):
    ValueError: env.objectives={} would change nothing; ~env.objectives.NAME leaves out what is in it.
    """
    for word in OverridesParser.create().parse_overrides(list(words)):
        if word.key_or_group == "brief":
            raise ValueError("brief follows trainer and env; choose them instead.")
        choices, key = word.value(), word.key_or_group
        if key in ("env", "trainer") and isinstance(choices, list):
            raise ValueError(f"{key} is one of {', '.join(_choices(key))}, and not several.")
        if choices == {} and not word.is_add():  # Hydra merges mappings
            raise ValueError(f"{key}={{}} would change nothing; ~{key}.NAME leaves out what is in it.")
        for choice in choices if isinstance(choices, list) and _choices(key) else []:
            if not isinstance(choice, str):
                raise ValueError(f"{key} names {choice}; {nearest(str(choice), _choices(key))}")
            if choices.count(choice) > 1:
                raise ValueError(f"{key} names {choice} twice.")


def refuse_misplaced(words: Sequence[str], sweep: bool) -> None:
    """Refuse settings of Hydra that it would ignore: a sweep's for one run, and the directory of one run for a sweep.

    >>> refuse_misplaced(["hydra.sweep.dir=here"], sweep=False)
    Traceback (most recent call last):
    ValueError: hydra.sweep.dir=here is about sweeps; add -m.
    >>> refuse_misplaced(["hydra.run.dir=here"], sweep=True)
    Traceback (most recent call last):
    ValueError: hydra.run.dir=here is about a single run; a sweep takes hydra.sweep.dir.
    """
    for word in (word for word in words if not sweep and re.match(r"[+~]*hydra[./](sweep|launcher)", word)):
        raise ValueError(f"{word} is about sweeps; add -m.")
    for word in (word for word in words if sweep and word.startswith("hydra.run.dir=")):
        raise ValueError(f"{word} is about a single run; a sweep takes hydra.sweep.dir.")


def _unknown_key(key: str) -> str:
    if key.startswith("hydra."):
        return f"There is no {key}; see --hydra-help."
    if choices := _choices(key):
        return f"The group {key} ({', '.join(choices)}) belongs to another environment than the one that is chosen."
    try:
        node = composed([word for word in sys.argv[1:] if _choices(word.partition("=")[0])])
    except (HydraException, ValueError):
        node = composed()
    parts = [part for part in node if OmegaConf.is_dict(node.get(part))]
    if longer := [f"{part}.{key}" for part in parts if OmegaConf.select(node, f"{part}.{key}") is not None]:
        return f"There is no {key} in the config; did you mean {longer[0]}?"
    node, where = OmegaConf.to_container(node), ""
    for name in key.split("."):
        if not isinstance(node, dict):
            return f"There is no {key} in the config, for {where} is {node}."
        if name not in node:
            break
        node, where = node[name], f"{where}.{name}".lstrip(".")
    children = [child for child in map(str, node) if child[0] != "_"]
    return f"There is no {name} in {where or 'the config'}" + (f"; {nearest(name, children)}" if children else ".")


def duration(seconds: float) -> str:
    """A time as one says it.

    >>> duration(7.3), duration(754.0), duration(9000.0)
    ('7 seconds', '12.6 minutes', '2.5 hours')
    """
    if seconds < 120:
        return f"{seconds:.0f} second{'' if round(seconds) == 1 else 's'}"
    return f"{seconds / 60:.1f} minutes" if seconds < 7200 else f"{seconds / 3600:.1f} hours"
