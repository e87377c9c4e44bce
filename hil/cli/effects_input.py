"""`--effects FILE.py`: a user's own effects, from a file the user names by hand.

The one place where code outside the project is loaded, and only from the command line: no data, model or sealed file can name one.
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Sequence
from pathlib import Path

from drivers.errors import InputError
from hil.effects import ALL, Effect


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--effects",
        metavar="FILE.py",
        action="append",
        default=[],
        help="a Python file of yours with `EFFECTS = (MyEffect(), …)`, tried beside the catalogue",
    )


def read_effects(paths: Sequence[str]) -> tuple[Effect, ...]:
    """The catalogue and the effects of the files. Raises InputError naming the file."""
    effects = list(ALL)
    for path in paths:
        for effect in _load(path):
            if effect.id in {known.id for known in effects}:
                raise InputError(f"defines the effect {effect.id!r}, which exists already", path=path)
            effects.append(effect)
    return tuple(effects)


def _load(path: str) -> tuple[Effect, ...]:
    if not Path(path).is_file():
        raise InputError("is not a file; expected Python code with EFFECTS = (…)", path=path)
    spec = importlib.util.spec_from_file_location(f"user_effects_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise InputError("cannot be loaded as Python; expected a .py file", path=path)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"fails when loaded: {type(error).__name__}: {error}", path=path) from error
    effects = getattr(module, "EFFECTS", None)
    if not isinstance(effects, (tuple, list)) or not all(isinstance(effect, Effect) for effect in effects):
        raise InputError("lacks EFFECTS, a tuple of hil.effects.Effect objects", path=path)
    return tuple(effects)
