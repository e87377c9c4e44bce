"""The zero of an axis: what ties its positions to the machine, kept on disk, and checked before the axis is used.

An axis's zero is made by its first homing and kept beside its campaigns, in `<axis>.zero.json`; each campaign keeps a
copy in `zero.json`, sealed tables carry it in their header. Every later measurement or correction is checked against
it: before any motion by the drive's answers (its identity, how it homes, whether it has kept its zero), and at the
reference position by the instrument's reading. Another zero, or one that cannot be shown to be the same, is refused.
Reasons: hil/decisions/0018.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers.drive import DriveZero, ServoDrive
from drivers.errors import InputError, StateError
from drivers.files import read_text, replace_file
from hil.records.files import parse_json, read_note

FILE = "zero.json"
"""A campaign's copy of the zero in which its rows were measured."""
POSITION_DEPENDENT_METHODS = frozenset({33, 34, 35, 37})
"""Homing methods of CiA 402 (6098h) without a switch. 35 and 37 take the present position, 33 and 34 the nearest index
pulse, whose place differs by whole turns of the motor.
"""
REFERENCE_WITHIN_UM = 100.0
"""Tolerance of the reference position, µm. An ordinary switch repeats within 20 µm; half a metre of steel grows by 58
µm in 10 K. The smallest mistake to be found, a missed index pulse, is one turn of the motor: mm.
"""
_SAME_MM = 1e-6  # home positions: less than any encoder's count
_LEAST_COUNTED_SHARE = 0.5
"""Share of the samples due since the last reading, at the instrument's present rate, that an instrument must have
counted if it ran on. One that was switched off has counted only since then; readings dropped on a busy line are far
fewer.
"""
_SLACK_S = 5.0
"""Tolerance between a sample and the time noted for it, s."""
_CALIBRATE_ANEW = "calibrate with a new zero (--new-zero, in a script new_zero=True)"
_INSTRUMENT_ZEROED = "--instrument-zeroed, in a script instrument_zeroed=True"


class ZeroError(StateError):
    """The zero of the axis is not the expected one, or this cannot be shown."""


@dataclass(frozen=True)
class Reference:
    """The readings at the reference position.

    motor_mm: the drive's position there; instrument_mm: the reading, in the instrument's own frame; sequence: the
    instrument's own number of its sample, None where it gives none; time: ISO 8601 in UTC
    """

    motor_mm: float
    instrument_mm: float
    instrument: str
    sequence: int | None
    time: str

    @property
    def offset_mm(self) -> float:
        """Offset of the instrument's frame from the drive's, mm."""
        return self.instrument_mm - self.motor_mm


@dataclass(frozen=True)
class Zero:
    """One zero of one axis. drive: identity of the drive that made it; homes: by its own homing, with method and home
    position (load mm); made: in UTC; refused: its homing ended elsewhere than announced, and the drive may call itself homed.
    """

    id: str
    axis: str
    made: str
    drive: Mapping[str, int | str] = field(default_factory=dict)
    homes: bool = True
    method: int | None = None
    home_position_mm: float | None = None
    reference: Reference | None = None
    refused: bool = False

    def to_json(self) -> dict[str, Any]:
        """The form of a zero file."""
        return asdict(self)

    @classmethod
    def from_json(cls, form: Any) -> Zero:
        """Reads what `to_json` gave. Raises ValueError for anything else."""
        try:
            values = dict(form)
            reference = values.pop("reference")
            zero = cls(**values, reference=None if reference is None else Reference(**reference))
            if zero.reference is not None:
                datetime.fromisoformat(zero.reference.time)
                float(zero.reference.offset_mm)
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError("no zero of an axis") from error
        if not (isinstance(zero.id, str) and isinstance(zero.axis, str) and isinstance(zero.drive, Mapping)):
            raise ValueError("no zero of an axis")
        return zero

    def describe(self) -> str:
        """One phrase for messages: id, date and homing."""
        return f"{self.id[:8]} of {self.made[:10]}, {describe_homing(self.homes, self.method, self.home_position_mm)}"


def describe_homing(homes: bool, method: int | None, home_position_mm: float | None) -> str:
    """The homing in a few words."""
    if not homes:
        return "not homed"
    named = "homed by the drive's own method" if method is None else f"homing method {method}"
    return named if home_position_mm is None else f"{named} to {home_position_mm:g} mm"


_SENSORS = {
    1: "the negative limit switch and the index pulse beside it",
    2: "the positive limit switch and the index pulse beside it",
    17: "the negative limit switch",
    18: "the positive limit switch",
    33: "the next index pulse in the negative direction",
    34: "the next index pulse in the positive direction",
    35: "the place where it stands (former number of 37)",
    37: "the place where it stands",
}
_SENSORS |= dict.fromkeys(range(3, 7), "an edge of the home switch and the index pulse beside it")
_SENSORS |= dict.fromkeys(
    range(7, 15), "an edge of the home switch, a limit switch reverses it, and the index pulse beside it"
)
_SENSORS |= dict.fromkeys(range(19, 23), "an edge of the home switch")
_SENSORS |= dict.fromkeys(range(23, 31), "an edge of the home switch, a limit switch reverses it")
"""What each homing method of CiA 402-2 takes as the home position."""


def explain_homing(method: int | None, home_position_mm: float | None) -> str:
    """What the method does and where the zero will be, as a clause; "" for a method that is not the standard's."""
    sensor = _SENSORS.get(0 if method is None else method)
    if sensor is None:
        return ""
    moves = "moves nothing, takes" if method in (35, 37) else "seeks"
    shows = "its home position" if home_position_mm is None else f"{home_position_mm:g} mm"
    return f"which {moves} {sensor}; that place shows {shows} afterwards"


def read_zero(path: Path) -> Zero | None:
    """The zero in a file, None where there is no such file. Raises InputError for one that cannot be read."""
    return read_note(path, Zero.from_json, "does not say what zero the axis has")


def write_zero(path: Path, zero: Zero) -> None:
    """Writes the zero, completely or not at all. Raises InputError when it cannot be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, (json.dumps(zero.to_json(), indent=1, allow_nan=False) + "\n").encode())


def homing_risk(homes: bool, method: int | None) -> str | None:
    """The risk of an axis's homing method to its zero, as one clause; None for no risk."""
    if not homes:
        return None
    if method is None:
        return "the drive does not say how it homes; a method that takes the place where the axis stands would lose its zero"
    if method in POSITION_DEPENDENT_METHODS:
        where = (
            "the place where the axis stands" if method in (35, 37) else "the index pulse beside where the axis stands"
        )
        return (
            f"takes {where} for zero: tables and limits are off by as much after each homing; home to a switch instead"
        )
    if method < 0:
        return "is the maker's own: see its manual whether it depends on where the axis stands"
    return None


def what_shows_it(zero: Zero, *, absolute_encoder: bool) -> str | None:
    """What a later connection needs to continue in this zero; None where homing to a switch restores it."""
    if absolute_encoder or (zero.homes and zero.method not in POSITION_DEPENDENT_METHODS):
        return None
    if not zero.homes:
        return "the axis is not homed: the instrument has to run on until then"
    return (
        f"homing method {zero.method} is not done a second time: the drive has to say that it is still homed, and the instrument"
        " has to run on until then"
    )


class ZeroKeeper:
    """Checks one connected axis against its zero. An axis without a zero file is new: its zero is written there.

    path: of the axis's zero; within_um: tolerance at the reference position; absolute_encoder: the drive knows its
    position without homing, also after its power was off; instrument: its kind
    anew: the next homing makes a new zero; instrument_zeroed: the operator states that the instrument's origin has
    changed
    """

    def __init__(
        self,
        path: Path,
        axis: str,
        *,
        within_um: float = REFERENCE_WITHIN_UM,
        absolute_encoder: bool = False,
        instrument: str = "",
    ) -> None:
        self.path = path
        self.axis = axis
        self.anew = False
        self.instrument_zeroed = False
        self.signal_was_lost = False
        """Since the last reference: the instrument's origin has changed, as with `instrument_zeroed`."""
        self.homing_would_lose_zero = False
        """Found by `begin`: the axis has its zero, and a homing would lose it."""
        self.current: Zero | None = None
        """What the axis is in, since `begin`."""
        self._within_um = within_um
        self._absolute = absolute_encoder
        self._instrument = instrument
        self._allowed = False  # the next homing, by `begin`
        self._tied = False  # by the drive: its zero is the same whatever the instrument counts from
        self._says_homed = False  # the drive, without a word by what
        self._campaign: Path | None = None
        self._begun = ""

    def guard(self, drive: ServoDrive) -> None:
        """Makes the drive refuse, for every caller, a homing that would lose the zero."""
        drive.before_homing = lambda: self._before_homing(drive)
        drive.homed_elsewhere = self._homed_elsewhere

    # -- before anything moves -----------------------------------------------------------------------------------------------
    def begin(
        self,
        drive: ServoDrive,
        *,
        homes: bool,
        campaign: Path | None = None,
        tables: Zero | None = None,
        old_tables: bool = False,
    ) -> None:
        """Checks drive, campaign and tables against the axis's zero. Raises ZeroError; nothing has moved.

        campaign: its folder; tables: the zero in which the tables to be put into force were made; old_tables: those
        tables state no zero
        """
        self._campaign, self._allowed, self.homing_would_lose_zero, self._begun = campaign, False, False, _now()
        rows = None if campaign is None else read_zero(campaign / FILE)
        known = self.kept(rows, tables)
        now = drive.zero()
        place = homes and now.method in POSITION_DEPENDENT_METHODS
        asks = (
            not self.anew and not (known is not None and known.refused) and (place or (not homes and known is not None))
        )
        absolute = asks and self._absolute and known is not None
        self._says_homed = asks and not absolute and drive.says_homed() is True
        homed = absolute or self._says_homed
        if known is not None:
            self._check_same(known, now, homes=homes, homed=homed)
        if place and not homed and not self.anew and (known is not None or old_tables or self._was_measured()):
            raise ZeroError(self._refused(now.method, known))
        self.homing_would_lose_zero = place and homed
        self._tied = absolute or (homes and not place)
        self._allowed = homes and not self.homing_would_lose_zero
        self.current = known or Zero(
            secrets.token_hex(16), self.axis, _now(), dict(now.identity), homes, now.method, now.home_position_mm
        )

    def kept(self, rows: Zero | None = None, tables: Zero | None = None) -> Zero | None:
        """The axis's zero, after checking that `rows` of a campaign and `tables` are in it. Raises ZeroError where they
        are not.
        """
        known = None if self.anew else read_zero(self.path) or rows or tables
        for what, zero in (("the campaign's rows were measured", rows), ("the tables were made", tables)):
            if zero is not None and (known is None or zero.id != known.id):
                other = "another is being made" if known is None else f"it has {known.describe()} now"
                raise ZeroError(
                    f"axis {self.axis}: {what} in another zero ({zero.describe()}), {other}: calibrate again"
                )
        return known

    def check_tables(self, tables: Zero | None) -> None:
        """Raises ZeroError for tables that were made in another zero than the axis has."""
        if tables is not None and self.current is not None and tables.id != self.current.id:
            self.kept(tables=tables)

    def _check_same(self, known: Zero, now: DriveZero, *, homes: bool, homed: bool) -> None:
        if dict(known.drive) != dict(now.identity):
            raise ZeroError(
                f"axis {self.axis}: its zero ({known.describe()}) was made with drive {_named(known.drive)}, this one is"
                f" {_named(now.identity)}; to begin anew, {_CALIBRATE_ANEW}"
            )
        if not homes or homed:
            return
        was, is_ = known.home_position_mm, now.home_position_mm
        moved = was is not None and is_ is not None and abs(was - is_) > _SAME_MM
        if not known.homes or known.method != now.method or moved:
            raise ZeroError(
                f"axis {self.axis}: its zero is {known.describe()}, the drive would home by"
                f" {describe_homing(homes, now.method, is_)}; to begin anew, {_CALIBRATE_ANEW}"
            )

    def _refused(self, method: int | None, known: Zero | None) -> str:
        lost = "what was measured before" if known is None else f"its zero ({known.describe()})"
        return (
            f"axis {self.axis}: homing method {method} depends on where the axis stands, {lost} would be lost, and the drive does not"
            " say that it is homed; home to a switch, or bring the axis to its zero and"
            f" {_CALIBRATE_ANEW}"
        )

    @property
    def _drive_statement(self) -> str:
        if not self._says_homed:
            return "does not say that it has kept its zero"
        return (
            "says that it is homed, but not by what: another program may have homed it since"
            f" (a person who knows that none has says so: {_INSTRUMENT_ZEROED})"
        )

    def _was_measured(self) -> bool:
        """Whether the axis has rows from before its zero was kept."""
        for marker in self.path.parent.glob("*/campaign.json"):
            try:
                mine = parse_json(read_text(marker)).get("axis") == self.axis
            except (InputError, ValueError, AttributeError):
                mine = True
            if mine and any(marker.parent.glob("*.csv")):
                return True
        return False

    def _before_homing(self, drive: ServoDrive) -> None:
        """Called before every homing; a caller that did not call `begin` homes an axis alone."""
        if not self._allowed:
            self.begin(drive, homes=True)
            if self.homing_would_lose_zero and (self.path.exists() or self._was_measured()):
                method = None if self.current is None else self.current.method
                raise ZeroError(self._refused(method, self.current))
        self._allowed = False
        if self.current is not None and (self.anew or not self.path.exists()):
            write_zero(self.path, self.current)  # before the order: killed after it, the zero is a new one

    def _homed_elsewhere(self) -> None:
        if self.current is not None:
            write_zero(self.path, replace(self.current, refused=True))

    # -- at the reference position ------------------------------------------------------------------------------------------
    def at_reference(self, motor_mm: float, instrument_mm: float, sequence: int | None, rate_hz: float | None) -> None:
        """Checks a reading at the reference position against the earlier one, or stores it where there is none or the
        instrument's origin has changed.

        sequence: of a sample taken when `begin` was called; rate_hz: of the instrument's samples
        Raises ZeroError; nothing has been measured.
        """
        current = self.current
        if current is None:
            return
        self._allowed = False
        found = Reference(motor_mm, instrument_mm, self._instrument, sequence, self._begun)
        before = None if self.anew else current.reference
        zeroed = self.instrument_zeroed or self.signal_was_lost
        if before is not None and not zeroed and self._counts_on(before, found, rate_hz):
            off_um = 1000.0 * (found.offset_mm - before.offset_mm)
            if abs(off_um) > self._within_um:
                raise ZeroError(
                    f"axis {self.axis}: the instrument finds the reference position {off_um / 1000.0:+.4f} mm from where it was on"
                    f" {before.time[:16]}, at most {self._within_um:g} µm are allowed (reference_within_um):"
                    f" the axis's zero has moved: {_CALIBRATE_ANEW}; or the instrument was zeroed since ({_INSTRUMENT_ZEROED})"
                )
            found = before
        elif before is not None and not self._tied and not (self._says_homed and zeroed):
            raise ZeroError(
                f"axis {self.axis}: the instrument counts from another place than on {before.time[:16]}, the axis is not homed to a"
                f" switch, and its drive {self._drive_statement}: nothing shows that it is the same ([axis] absolute_encoder = true"
                f" where the drive keeps it); to begin anew, {_CALIBRATE_ANEW}"
            )
        self.current = replace(current, reference=found, refused=False)
        write_zero(self.path, self.current)
        if self._campaign is not None and not (self._campaign / FILE).exists():
            write_zero(self._campaign / FILE, self.current)
        self.anew = self.instrument_zeroed = self.signal_was_lost = False

    def instrument_lost(self, motor_mm: float, instrument_mm: float) -> None:
        """The signal was lost while the axis kept its zero: the instrument's origin is now that of this reading, mm."""
        self.signal_was_lost = False
        if self.current is not None and self.current.reference is not None:
            reference = replace(self.current.reference, motor_mm=motor_mm, instrument_mm=instrument_mm, time=_now())
            self.current = replace(self.current, reference=reference)
            write_zero(self.path, self.current)

    def _counts_on(self, before: Reference, found: Reference, rate_hz: float | None) -> bool:
        """Whether the instrument has run on since; one that does not number its samples is assumed to have."""
        if before.instrument != found.instrument:
            return False
        if before.sequence is None or found.sequence is None:
            return True
        counted = found.sequence - before.sequence
        passed_s = (datetime.fromisoformat(found.time) - datetime.fromisoformat(before.time)).total_seconds()
        return counted >= 0 and (rate_hz is None or counted >= rate_hz * (_LEAST_COUNTED_SHARE * passed_s - _SLACK_S))


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _named(identity: Mapping[str, int | str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in identity.items()) or "without a name"
