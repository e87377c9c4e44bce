"""Diagnoses stored as JSON beside the rows they are of."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from drivers.files import read_bytes, read_text
from hil.records.files import parse_json
from hil.records.journal import measurement_of

STORED = ".diagnosis.json"
"""Suffix after the name of the diagnosed pass or passes."""


def can_be_held_out(how: object) -> bool:
    """Whether rows left out in this way are predicted within what was measured. Quarters of a single run are not: the model has no row
    near them, and its figures there say nothing of the axis."""
    return isinstance(how, str) and "quarter" not in how


def stored_beside(paths: Sequence[Path]) -> Path:
    """Path of the diagnosis of these passes of one campaign."""
    return paths[0].parent / f"{measurement_of(paths[0].stem)}{STORED}"


def sources(paths: Sequence[Path]) -> dict[str, str]:
    """SHA-256 of each file by its name. Raises InputError for a file that cannot be read."""
    return {path.name: hashlib.sha256(read_bytes(path)).hexdigest() for path in paths}


def read_stored(path: Path) -> dict[str, Any]:
    """A stored diagnosis. Raises InputError for a file that holds none."""
    try:
        form = parse_json(read_text(path))
    except ValueError as error:
        raise InputError("is not JSON", path=path) from error
    if (
        not isinstance(form, dict)
        or not isinstance(form.get("findings"), list)
        or not isinstance(form.get("drawn"), dict)
    ):
        raise InputError("is not a diagnosis as a screen shows it", path=path)
    return form
