"""Input files of fit, apply and diagnose: record files, whole or some of their runs, effects and models."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.errors import InputError
from drivers.files import read_text
from hil.effects import ALL, Effect
from hil.effects.model import Model
from hil.records.journal import MARKER, measurement_of, pass_number
from hil.records.rows import Records, concatenate, read_csv


def read_records(paths: Sequence[str | Path], runs: tuple[int, ...] | None = None) -> Records:
    """The rows of all files as they are: `read_parts` one after the other. Raises InputError as `read_parts`."""
    parts = read_parts(paths, runs)
    return parts[0] if len(parts) == 1 else concatenate(parts)


def read_parts(paths: Sequence[str | Path], runs: tuple[int, ...] | None = None) -> list[Records]:
    """The rows of each file. runs: only these, None for all.

    Passes of one measurement in a campaign's folder come in the order in which they were made and keep their run numbers; those of
    any other file continue the numbers before it. Raises InputError naming the file, and the runs that it lacks.
    """
    parts: list[Records] = []
    last = 0
    before: tuple[Path, str] | None = None
    for path in in_order(paths):
        part = read_csv(path)
        if runs is not None:
            missing = sorted(set(runs) - set(part.runs))
            if missing:
                raise InputError(f"has no run {', '.join(map(str, missing))}; it holds {part.runs}", path=path)
            part = part.of_runs(runs)
        of = (path.parent, measurement_of(path.stem)) if (path.parent / MARKER).exists() else None
        if parts and (of is None or of != before):
            part = part.with_column("run", part.run - float(np.min(part.run)) + last + 1)
        before, last = of, int(np.max(part.run))
        parts.append(part)
    return parts


def in_order(paths: Sequence[str | Path]) -> list[Path]:
    """Files as given, but the passes of one measurement by their number: a shell puts the tenth before the second."""
    given = [Path(path) for path in paths]
    home = {(path.parent, measurement_of(path.stem)): i for i, path in reversed(list(enumerate(given)))}
    return sorted(given, key=lambda path: (home[path.parent, measurement_of(path.stem)], pass_number(path.stem)))


def read_model(path: str, effects: Sequence[Effect] = ALL) -> Model:
    """A model file. Raises InputError naming it."""
    return Model.from_json(read_text(path, expected="a model (JSON)"), path, effects)
