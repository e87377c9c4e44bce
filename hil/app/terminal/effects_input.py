"""`--effects FILE.py`: a user's own effects beside the catalogue, from files named by hand, and those of installed packages."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from hil.effects import Effect
from hil.effects.user_effects import catalogue_with


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--effects",
        metavar="FILE.py",
        action="append",
        default=[],
        help="Python code of yours with EFFECTS = (MyEffect(), …), run and used beside the catalogue; may be repeated",
    )


def read_effects(paths: Sequence[str]) -> tuple[Effect, ...]:
    """The catalogue and the effects of installed packages and of the files. Raises InputError naming the file."""
    return catalogue_with(paths)
