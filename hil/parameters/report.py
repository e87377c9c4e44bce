"""The outcome of a job on one drive, as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from statistics import median
from typing import Any

from drivers.parameters import ParameterValue
from hil.parameters.preflight import Objection

_SLOW, _SLOW_S = 5.0, 0.002
"""An answer is slow if it takes this factor times the median answer time, and so many seconds longer."""


class Ending(Enum):
    """What the drive holds after a job."""

    UNCHANGED = "the drive held everything already; nothing was written"
    WRITTEN = "written, and read back"
    PUT_BACK = "put back: the drive holds what it held before"
    REFUSED = "refused, nothing was written"
    UNFINISHED = "unfinished: what the drive holds is not known"

    @property
    def good(self) -> bool:
        """Whether the drive holds the set."""
        return self in (Ending.UNCHANGED, Ending.WRITTEN)


class ParameterVerdict(Enum):
    """Outcome of one parameter."""

    SAME = "same"
    WRITTEN = "written"
    PUT_BACK = "put back"
    NOT_WRITTEN = "not written"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Row:
    """One parameter of a job; values in its unit. Latencies in s, None where it was not accessed in that way."""

    address: str
    name: str
    unit: str
    old: ParameterValue
    new: ParameterValue
    verdict: ParameterVerdict
    read_s: float | None = None
    write_s: float | None = None


@dataclass(frozen=True)
class JobReport:
    """One drive's share of a job. stored: the drive has confirmed the store; seconds: from the first to the last access.

    journal: path of the journal of an unfinished download, else "".
    """

    drive: str
    ending: Ending
    rows: tuple[Row, ...] = ()
    stored: bool = False
    error: str = ""
    objections: tuple[Objection, ...] = ()
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    journal: str = ""
    meant_back: bool = False  # putting back was the job
    audited: bool | None = None  # None: was not asked for
    lost: tuple[str, ...] = ()  # what the audit found changed after the restart

    @property
    def good(self) -> bool:
        """Whether the job reached its aim."""
        reached = self.ending is Ending.PUT_BACK if self.meant_back else self.ending.good
        return reached and not self.error and self.audited is not False

    @property
    def kept(self) -> str:
        """What is known of the drive's memory, as a sentence; "" where nothing was stored.

        A drive that acknowledges a store may still have kept a part only: nothing but a restart shows it.
        """
        if not self.stored:
            return ""
        if self.audited:
            return "stored, and proven: after its restart it still holds all of it"
        if self.audited is None:
            return (
                "stored, as the drive says; not proven: only a restart shows whether it kept all of it (`--audit`, or"
                " `hil params verify` after switching it off and on)"
            )
        if not self.lost:
            return "stored, as the drive says; not proven: the restart that was to show it did not succeed (`hil params verify`)"
        return (
            f"NOT kept, although the drive confirmed it. Different after the restart ({len(self.lost)}): {', '.join(self.lost[:8])};"
            " `hil params restore --store --audit` puts back the values before this download"
        )

    def as_json(self) -> dict[str, Any]:
        """As `--json` writes it; bytes as hexadecimal digits."""
        return {
            "drive": self.drive,
            "good": self.good,
            "ending": self.ending.name.lower(),
            "stored": self.stored,
            "kept": self.kept,
            "audited": self.audited,
            "lost": list(self.lost),
            "error": self.error,
            "objections": [vars(each) for each in self.objections],
            "notes": list(self.notes),
            "seconds": self.seconds,
            "journal": self.journal,
            "parameters": [
                {**vars(row), "verdict": row.verdict.value, "old": plain(row.old), "new": plain(row.new)}
                for row in self.rows
            ],
            "slow": [row.address for row in slow(self.rows)],
        }


def plain(value: ParameterValue | None) -> int | float | str | None:
    """A value for JSON: bytes as hexadecimal digits."""
    return value.hex() if isinstance(value, bytes) else value


def shown(value: ParameterValue | None) -> str:
    """A value as text for a table; "–" for None, bytes as hexadecimal digits."""
    if value is None:
        return "–"
    if isinstance(value, bytes):
        return value.hex() or "empty"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def slow(rows: Sequence[Row]) -> list[Row]:
    """Parameters whose answers take much longer than the median (`_SLOW`, `_SLOW_S`), the slowest first."""
    times = [time for row in rows for time in (row.read_s, row.write_s) if time is not None]
    if not times:
        return []
    usual = median(times)
    limit = max(_SLOW * usual, usual + _SLOW_S)
    return sorted(
        (row for row in rows if max(row.read_s or 0.0, row.write_s or 0.0) > limit),
        key=lambda row: -max(row.read_s or 0.0, row.write_s or 0.0),
    )
