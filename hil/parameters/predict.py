"""How long a download will keep the bus busy, and how long it will take, before anything is sent.

What may go in: adding up what the drives' own files say of the cost of accesses. Nothing is measured here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drivers.raw_parameters import RawParameters, WireTime
from hil.parameters.preflight import Wanted


@dataclass(frozen=True)
class Prediction:
    """One drive's share. look: reading everything once; write: writing and reading back what differs."""

    drive: str
    look: WireTime
    write: WireTime

    @property
    def whole(self) -> WireTime:
        return self.look + self.write

    def as_json(self) -> dict[str, Any]:
        return {"drive": self.drive, "look": vars(self.look), "write": vars(self.write)}


def predict(drive: RawParameters, wanted: Sequence[Wanted], differing: Sequence[str] | None = None) -> Prediction:
    """Of a download of these; differing: addresses that have to be written, None for all of them.

    What the drive holds at present stands in the answers as what it is to hold: a guess of some stuff bits, no more.
    """
    every = [(each.address, each.data) for each in wanted]
    written = [pair for pair in every if differing is None or pair[0] in differing]
    return Prediction(drive.name, drive.cost(every, []), drive.cost(written, written))


def seconds_together(costs: Sequence[WireTime], answer_s: float = 0.0) -> tuple[float, float, float]:
    """(least, likely, most) of drives served side by side on one bus, each taking `answer_s` for an answer.

    The bus is shared, a drive's thinking is its own: the longer of the two decides.
    """
    found = []
    for name in ("seconds_least", "seconds_likely", "seconds_most"):
        bus = sum(getattr(cost, name) for cost in costs)
        slowest = max((getattr(cost, name) + answer_s * cost.answers for cost in costs), default=0.0)
        found.append(max(bus, slowest))
    return found[0], found[1], found[2]
