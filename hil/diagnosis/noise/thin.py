"""The selection of rows of a large campaign for search and fit.

One row is drawn at random from each stretch of neighbouring ones, so that the sampling does not alias with a period of
the mechanics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows, campaign_of, columns_of
from hil.records.rows import Records

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

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


@dataclass(frozen=True)
class AllRows:
    """Every row of a campaign, with the selection that is searched and fitted.

    columns: completed, each (n,); error_um: of the uncorrected machine, (n,); kept: indices of the selection,
    ascending, (m,)
    """

    columns: Mapping[str, Floats]
    error_um: Floats
    kept: Ints

    @classmethod
    def of(cls, records: Records, seed: int) -> AllRows:
        """The history of each row (travel since the reversal …) is computed before rows are left out."""
        return cls(columns_of(records), records.uncorrected_error_um, kept_rows(records.run, seed))

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
