"""The drive's parameters that tables were made with: its units, and its own backlash compensation.

Tables correct what the instrument saw through these parameters. A drive that gets another backlash amount afterwards corrects the same
reversal a second time; one with another gear or position factor moves by other millimetres.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from drivers.drive import ServoDrive
from drivers.errors import CapabilityError, StateError
from drivers.files import replace_file
from hil.records.files import read_note

FILE = "made_with.json"
"""In a campaign's folder: what its rows were measured with."""
_SAME = 1e-9
"""Relative difference below which two values are the same: they are whole numbers on the wire, times a scale."""


class MadeWithError(StateError):
    """The drive has other parameters than those with which tables or rows were made."""


@dataclass(frozen=True)
class MadeWith:
    """Parameters by the address that parameter sets use, in the drive's own unit.

    units: encoder resolution, gear, feed, position factor, polarity, as far as the drive has them
    backlash: amount and acceleration switch, as far as the axis file names them
    """

    units: Mapping[str, float] = field(default_factory=dict)
    backlash: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, drive: ServoDrive, backlash: Sequence[str]) -> MadeWith:
        """Reads them from an open drive. backlash: names of the amount and the switch. Raises what reading a parameter raises."""
        units = dict(drive.unit_parameters())
        try:
            return cls(units, dict(map(drive.read_number, backlash)))
        except CapabilityError:  # a drive without a wire has no parameters, whatever the axis file names
            return cls(units)

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, form: Any) -> MadeWith:
        """Reads what `to_json` gave. Raises ValueError for anything else."""
        try:
            parts = {name: {str(k): float(v) for k, v in form[name].items()} for name in ("units", "backlash")}
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError("no parameters of a drive") from error
        return cls(**parts)

    def differences(self, now: MadeWith, *, backlash: bool = True) -> list[str]:
        """The parameters that `now` has otherwise, in words. backlash: the amount counts too."""
        pairs = [(self.units, now.units), *([(self.backlash, now.backlash)] if backlash else [])]
        return [
            f"{address} was {was:g}, is {'missing' if address not in there else f'{there[address]:g}'}"
            for known, there in pairs
            for address, was in known.items()
            if address not in there or not same(was, there[address])
        ]


def same(was: float, is_: float) -> bool:
    """Whether two values of a parameter are the same one."""
    return abs(was - is_) <= _SAME * max(1.0, abs(was), abs(is_))


def read_made_with(path: Path) -> MadeWith | None:
    """What a file states, None where there is none. Raises InputError for one that cannot be read."""
    return read_note(path, MadeWith.from_json, "does not say which parameters the drive had")


def write_made_with(path: Path, made_with: MadeWith) -> None:
    """Writes the file, completely or not at all. Raises InputError when it cannot be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, (json.dumps(made_with.to_json(), indent=1, allow_nan=False) + "\n").encode())


@dataclass(frozen=True)
class MadeWithKeeper:
    """Compares one axis's drive with what its tables, and a campaign's rows, were made with.

    path: what the drive had when the axis was last measured, which tables that are stored afterwards are bound to
    backlash: names of its amount and switch in the axis file
    """

    path: Path
    axis: str
    axis_file: Path
    backlash: tuple[str, ...] = ()

    def now(self, drive: ServoDrive, recorded: MadeWith | None = None) -> MadeWith:
        """What the open drive has; recorded: what it names is read too."""
        return MadeWith.of(drive, list(dict.fromkeys([*self.backlash, *(recorded.backlash if recorded else ())])))

    def begin(self, drive: ServoDrive, campaign: Path | None) -> None:
        """Notes what the drive has, before anything moves. Raises MadeWithError for a campaign whose rows were measured with other
        parameters."""
        rows = None if campaign is None else read_made_with(campaign / FILE)
        now = self.now(drive, rows)
        if rows is not None and (differing := rows.differences(now)):
            raise MadeWithError(
                f"axis {self.axis}: the drive no longer has the parameters that the campaign's rows were measured with"
                f" ({', '.join(differing)}): set them back, or begin a new campaign"
            )
        write_made_with(self.path, now)
        if campaign is not None and rows is None:
            write_made_with(campaign / FILE, now)

    def check(self, drive: ServoDrive, tables: MadeWith | None, *, reversal: bool) -> None:
        """Raises MadeWithError unless the open drive has what the tables were made with; None: they do not state it.

        reversal: the tables correct one, so that the drive's backlash amount counts
        """
        if tables is None:
            return
        differing = tables.differences(self.now(drive, tables), backlash=reversal)
        if differing:
            raise MadeWithError(
                f"axis {self.axis}: the drive no longer has the parameters that its tables were made with ({', '.join(differing)}),"
                f" so that the tables are wrong for it: set them back, or calibrate again (hil calibrate {self.axis_file})"
            )
