"""Predicted bus time and duration of a download, from the sizes of its accesses. Nothing is sent or measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drivers.raw_parameters import RawParameters, WireTime
from hil.parameters.preflight import Wanted


@dataclass(frozen=True)
class Prediction:
    """One drive's share. look: reading every entry once; write: writing and reading back the entries that differ."""

    drive: str
    look: WireTime
    write: WireTime

    @property
    def whole(self) -> WireTime:
        """look and write together."""
        return self.look + self.write

    def as_json(self) -> dict[str, Any]:
        """As `--json` writes it."""
        return {"drive": self.drive, "look": vars(self.look), "write": vars(self.write)}


def predict(drive: RawParameters, wanted: Sequence[Wanted], differing: Sequence[str] | None = None) -> Prediction:
    """Prediction of a download. differing: addresses to be written, None for all."""
    every = [(each.address, each.data) for each in wanted]
    written = [pair for pair in every if differing is None or pair[0] in differing]
    return Prediction(drive.name, drive.cost(every, []), drive.cost(written, written))


def seconds_together(costs: Sequence[WireTime], answer_s: float = 0.0) -> float:
    """Duration at most, s, for drives served side by side on one bus. answer_s: a drive's own time for one answer, s.

    It is the longer of the bus time of all drives and the bus and answer time of the slowest drive.
    """
    return max(sum(cost.seconds for cost in costs), *(cost.seconds + answer_s * cost.answers for cost in costs), 0.0)
