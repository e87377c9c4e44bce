"""The campaign under diagnosis: records as the arrays that every step uses, in the order of time. Nothing is fitted here.

Of a large campaign a selection of rows is searched and fitted: one row is drawn at random from each stretch of neighbouring ones, so
that the sampling does not alias with a period of the mechanics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from hil.diagnosis.table import TableBasis, choose_knots
from hil.effects import Survey, survey_of
from hil.effects.history import complete
from hil.records.rows import UM_PER_MM, Records, refuse_other_units

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Singles = NDArray[np.float32]


OF_A_MODEL = frozenset({"correction_um", "residual_um"})
"""Columns that `hil apply` writes: the output of a model cannot explain the rows."""


@dataclass(frozen=True)
class CampaignRows:
    """n rows of a campaign.

    columns: completed, each (n,); error_um: of the uncorrected machine, (n,)
    run: index of the run 0 … r-1, (n,)
    basis: of the declared table; repeated: its knots are repeated targets, between which nothing is known
    """

    columns: Mapping[str, Floats]
    error_um: Floats
    run: Ints
    basis: TableBasis
    repeated: bool
    survey: Survey

    def __len__(self) -> int:
        return len(self.error_um)

    @property
    def x(self) -> Floats:
        """Targets, mm, (n,)."""
        return self.columns["target_mm"]

    @property
    def d(self) -> Floats:
        """Directions, +1 or -1, (n,)."""
        return self.columns["direction"]

    @property
    def runs(self) -> int:
        return int(np.max(self.run)) + 1


def columns_of(records: Records) -> dict[str, Floats]:
    """The columns of records for a diagnosis, each (n,): history columns added (`hil.effects.history`), columns of a
    model removed.
    """
    return complete({name: values for name, values in records.columns.items() if name not in OF_A_MODEL})


def prepare(records: Records, pitches_mm: tuple[float, ...] = ()) -> CampaignRows:
    """Builds a campaign from records. Raises InputError for fewer than 4 rows, and as `refuse_other_units`."""
    refuse_other_units(records)
    return campaign_of(columns_of(records), records.uncorrected_error_um, pitches_mm)


def campaign_of(columns: Mapping[str, Floats], error_um: Floats, pitches_mm: tuple[float, ...] = ()) -> CampaignRows:
    """Builds a campaign from completed columns, each (n,), and the error of the uncorrected machine, µm, (n,). Raises
    InputError for fewer than 4 rows.
    """
    if len(error_um) < 4:
        raise InputError(f"{len(error_um)} rows are too few for a fit; expected at least 4")
    direction = columns["direction"]
    _, run = np.unique(columns["run"], return_inverse=True)
    knots, repeated = choose_knots(columns["target_mm"], rows_per_pass(run, direction))
    both = bool(np.any(direction > 0) and np.any(direction < 0))
    return CampaignRows(
        columns=columns,
        error_um=error_um,
        run=run.astype(np.int64),
        basis=TableBasis(knots, both),
        repeated=repeated,
        survey=survey_of(columns, pitches_mm),
    )


def rows_per_pass(run: NDArray[np.intp], direction: Floats) -> int:
    """Median number of rows of one run in one direction."""
    _, counts = np.unique(np.column_stack([run, direction]), axis=0, return_counts=True)
    return max(int(np.median(counts)), 1)


MOST_ROWS = 2000
"""With 2000 rows a table of 80 coefficients adds 2 % to the noise it leaves."""
ROWS_OF_A_RUN = 40
"""Least rows kept of a run; of campaigns with very many runs, whole runs are left out."""


def kept_rows(run: Floats, seed: int, most: int = MOST_ROWS) -> Ints:
    """Indices, ascending, of at most about `most` rows, evenly over the runs, from the run of each row, shape (n,).

    All rows where there are no more than that.
    """
    if len(run) <= most:
        return np.arange(len(run), dtype=np.int64)
    rng = np.random.default_rng(seed)
    numbers = np.unique(run)
    count = min(len(numbers), max(most // ROWS_OF_A_RUN, 1))
    kept = numbers[np.round(np.linspace(0, len(numbers) - 1, count)).astype(np.int64)]
    parts = []
    for number in kept:
        rows = np.flatnonzero(run == number)
        edges = np.linspace(0, len(rows), min(len(rows), max(most // count, 1)) + 1)
        drawn = edges[:-1] + rng.random(len(edges) - 1) * np.diff(edges)
        parts.append(rows[np.unique(drawn.astype(np.int64))])
    return np.sort(np.concatenate(parts)).astype(np.int64)


STEPS_MM = tuple(float(f"{digit}e{power}") for power in range(-2, -7, -1) for digit in (5, 2, 1))
"""Steps of readings that are looked for, the coarsest first."""
ON_STEP = 1e-3
"""Part of a step that a reading may lie beside it: files have ten digits or more."""


def coarse_step_mm(records: Records) -> float | None:
    """The step of a readout that is coarser than the noise, mm; None for a finer one, and without repeats.

    Coarser than the noise: of neighbouring repeats of a target more than half have the same error.
    """
    error_um = np.round(records.uncorrected_error_um, 6)
    order = np.lexsort((np.arange(len(records)), records["direction"], records.target_mm))
    again = (np.diff(records.target_mm[order]) == 0) & (np.diff(records["direction"][order]) == 0)
    if not np.any(again) or np.mean(np.diff(error_um[order])[again] == 0) <= 0.5:
        return None
    # targets have steps too, with an error that never varies
    coarsest_mm = max(float(np.ptp(error_um)) / UM_PER_MM, STEPS_MM[-1])
    return next((step for step in STEPS_MM if step <= coarsest_mm and _on_steps(records.measured_mm / step)), None)


def unread_um(rows: int, step_mm: float | None) -> Floats:
    """What may lie between the steps of a readout that is coarser than the noise, drawn evenly over one step, µm, (rows,); zeros for
    None.

    Repeats that agree to the last digit have no noise, and the slightest course beside them would be a cause.
    """
    if step_mm is None:
        return np.zeros(rows)
    return np.asarray(np.random.default_rng(rows).uniform(-0.5, 0.5, rows) * step_mm * UM_PER_MM)


def _on_steps(values: Floats) -> bool:
    return bool(np.all(np.abs(values - np.round(values)) < ON_STEP))


@dataclass(frozen=True)
class AllRows:
    """Every row of a campaign, with the selection that is searched and fitted.

    columns: completed, each (n,); error_um: of the uncorrected machine, (n,); kept: indices of the selection,
    ascending, (m,); step_mm: of a readout that is coarser than the noise
    """

    columns: Mapping[str, Floats]
    error_um: Floats
    kept: Ints
    step_mm: float | None = None

    @classmethod
    def of(cls, records: Records, seed: int) -> AllRows:
        """The history of each row (travel since the reversal …) is computed before rows are left out. Raises InputError as
        `refuse_other_units`.
        """
        refuse_other_units(records)
        step_mm = coarse_step_mm(records)
        error_um = records.uncorrected_error_um + unread_um(len(records), step_mm)
        return cls(columns_of(records), error_um, kept_rows(records.run, seed), step_mm)

    @property
    def searched(self) -> CampaignRows:
        """The selected rows. Raises InputError for fewer than 4."""
        kept = {name: values[self.kept] for name, values in self.columns.items()}
        return campaign_of(kept, self.error_um[self.kept])

    def __len__(self) -> int:
        return len(self.error_um)

    def folds(self, fold: Ints) -> Ints:
        """Fold of every row, shape (n,), from that of the kept ones, (m,): that of its run; any where its run was not kept."""
        if len(fold) == len(self):
            return fold
        run = self.columns["run"]
        numbers, index = np.unique(run, return_inverse=True)
        if len(numbers) == 1:
            return fold[np.minimum(np.searchsorted(self.kept, np.arange(len(self))), len(fold) - 1)]
        of_run = np.arange(len(numbers)) % (int(np.max(fold)) + 1)
        of_run[index[self.kept]] = fold
        return np.asarray(of_run[index], dtype=np.int64)
