"""What the command lines share."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hydra.errors import HydraException, InstantiationException
from omegaconf.errors import OmegaConfBaseException


def conf_dir() -> str:
    """The folder of configs: inside the installed package, or beside it in a checkout."""
    inside = Path(__file__).parent / "conf"
    return str(inside if inside.is_dir() else Path(__file__).parents[1] / "conf")


def quiet() -> None:
    """Keep the libraries' notes to developers off a user's screen."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", category=FutureWarning, module="torchrl")
    warnings.filterwarnings("ignore", message=".*init_random_frames.*")


@contextmanager
def one_sentence_errors() -> Iterator[None]:
    """Turn a user's mistake into one sentence on standard error and exit status 1."""
    try:
        yield
    except InstantiationException as error:
        sys.exit(str(error.__cause__ or error).splitlines()[0])
    except (ValueError, FileNotFoundError, OmegaConfBaseException, HydraException) as error:
        sys.exit(str(error).splitlines()[0])
