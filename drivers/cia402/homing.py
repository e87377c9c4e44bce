"""Homing by a drive's own methods: starts it with its settings and follows it until it is attained or has failed.

Holds the objects and status bits of the homing mode. `drive` waits for its end and counts the attempts.

In homing mode bit 12 of the statusword says "homing attained", of the last homing too: a drive keeps it until a new one begins (bit 4
of the controlword rises), and then shows bits 13, 12 and 10 low: in progress (IEC 61800-7-201, homing mode, definition of bits 10, 12
and 13). A statusword that is some milliseconds old may still show the homing before. So bit 12 counts once all three were seen low
after bit 4 rose. Methods that do not move (35, 37) may be over before the first sample: without that, bit 12 counts once an axis that
does not move has shown it for `ATTAINED_S` without a break. Bit 13, homing error, is evaluated by the same rule, at rest.

Some drives depart from that: one never shows bit 10 (bit 12 then counts once the axis rests for `ATTAINED_S`), one shows a homing as
attained that was to search a switch and was not seen moving (it has failed), one answers a method that it does not take (it is read
back).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.cia402 import objects
from drivers.cia402.kept_settings import KeptSettings
from drivers.cia402.modes import HomingStatus, Mode, decode_homing
from drivers.cia402.motion import ProfileMotion
from drivers.cia402.objects import Entry
from drivers.cia402.power import RUN, PowerStage
from drivers.cia402.state_machine import Control
from drivers.cia402.wire import LEFT_OUT, ObjectAccess
from drivers.clock import NS_PER_S
from drivers.drive import TAKES_THE_PLACE
from drivers.errors import AbortError, CapabilityError, DriveFaultError
from drivers.scaling import MotionScaling

ATTAINED_S = 0.25
"""Time for which an axis at rest must show the end if no homing was seen in progress, s: far more than a drive takes to begin a homing
and to show it (a control cycle, one to ten ms), and than an axis takes to be seen moving."""
SAME_PLACE = 2
"""Tolerance of the position of an axis at rest, counts: it may stand between two counts of its encoder."""


@dataclass(frozen=True)
class HomingSettings:
    """Objects written before homing; a None is not written. mm/s, and load mm of the home position."""

    method: int | None = None
    speed_switch_mm_s: float | None = None
    speed_zero_mm_s: float | None = None
    home_position_mm: float | None = None


class Homing:
    """Homing of one open drive. homed: since it was opened, or as the drive reports, None while that is unknown.

    under_way: begun, and its end not seen yet. without_bit_10: it has ended and bit 10 was not shown.
    """

    def __init__(self, access: ObjectAccess, power: PowerStage, motion: ProfileMotion, kept: KeptSettings) -> None:
        self.homed: bool | None = None
        self.under_way = self.without_bit_10 = False
        self._method: int | None = None
        self._access = access
        self._power = power
        self._motion = motion
        self._kept = kept
        self._was_low = False  # seen in progress since bit 4 rose
        self._from_counts: int | None = None  # where it began
        self._moved = False  # seen moving since
        self._shown: tuple[int, int] | None = None  # an end shown without a break: since when (ns), position in counts

    def start(self, homing: HomingSettings, units: MotionScaling) -> None:
        """Write the settings, change the mode, begin. Raises AbortError, CapabilityError, ProtocolError, NoAnswerError."""
        settings: list[tuple[Entry, int | None]] = [
            (objects.HOMING_METHOD, homing.method),
            (objects.HOMING_SPEED_SWITCH, _counts(homing.speed_switch_mm_s, units.velocity_units)),
            (objects.HOMING_SPEED_ZERO, _counts(homing.speed_zero_mm_s, units.velocity_units)),
            (objects.HOME_OFFSET, _counts(homing.home_position_mm, units.scaling.motor_counts)),
        ]
        for entry, value in settings:
            if value is None:
                continue
            try:
                self._kept.set(entry, value)
            except AbortError as error:  # one speed may serve the whole homing
                if entry is not objects.HOMING_SPEED_ZERO or error.code not in LEFT_OUT:
                    raise
        self._method = self._access.read_if_shown(objects.HOMING_METHOD, 0)
        if homing.method is not None and self._method != homing.method:
            raise CapabilityError(
                f"{self._access.name} cannot home by method {homing.method}: it was written to 6098h, which stays {self._method}"
            )
        self._motion.set_mode(Mode.HOMING)
        self.homed, self.under_way, self.without_bit_10 = False, False, False
        self._was_low, self._shown = False, None
        self._from_counts, self._moved = None, False
        self._power.write(RUN)
        self._power.write_edge(RUN | Control.HOMING_START)
        self.under_way = True

    def believe(self, status: int) -> None:
        """Evaluate the statusword of a disabled drive in homing mode: one that shows an earlier homing as attained is homed.

        One that does not may have lost that with the change of mode, so it leaves `homed` unknown.
        """
        if decode_homing(status) is HomingStatus.COMPLETED:
            self.homed = True

    def look(self, time_ns: int, status: int, position_counts: int, *, slow: bool) -> None:
        """Evaluate a sample (ns, 6041h, counts); does nothing unless homing is under way. slow: the velocity shown is that of an
        axis at rest.

        Raises DriveFaultError once when homing failed.
        """
        if not self.under_way:
            return
        homing = decode_homing(status)
        if self._from_counts is None:
            self._from_counts = position_counts
        travelled = homing is not HomingStatus.COMPLETED and abs(position_counts - self._from_counts) > SAME_PLACE
        if travelled or not slow:
            self._moved = True
        if homing is HomingStatus.IN_PROGRESS:
            self._was_low, self._shown = True, None
            return
        if homing is HomingStatus.ATTAINED_NOT_REACHED:  # bit 10 follows in a moment, or never
            if self._stays(time_ns, position_counts, slow):
                self._end_attained()
                self.without_bit_10 = True
            return
        ended = homing is HomingStatus.COMPLETED or (homing is not None and homing.failed and slow)
        if not ended:
            self._shown = None
            return
        if not (self._was_low or self._stays(time_ns, position_counts, slow)):
            return
        if homing is HomingStatus.COMPLETED:
            self._end_attained()
        elif homing is not None:
            self.under_way = False
            self._power.write(RUN)
            raise DriveFaultError(
                f"{self._access.name}: homing failed, statusword {status:04X}h ({homing.name.lower()})"
            )

    def _end_attained(self) -> None:
        """Raises DriveFaultError for a homing that is shown as attained, and was not seen moving where its method has to."""
        self.under_way = False
        if not self._moved and self._method is not None and 0 < self._method < TAKES_THE_PLACE[0]:
            self._power.write(RUN)
            raise DriveFaultError(
                f"{self._access.name}: homing failed: method {self._method} searches a switch or the index, and it is shown as"
                " attained where the axis stood, without motion"
            )
        self.homed = True

    def _stays(self, time_ns: int, position_counts: int, slow: bool) -> bool:
        """Where no homing was seen in progress: whether its end has been shown for long enough by an axis that does not move."""
        since_ns, place = self._shown or (time_ns, position_counts)
        if not slow or abs(position_counts - place) > SAME_PLACE:
            since_ns, place = time_ns, position_counts
        self._shown = since_ns, place
        return time_ns - since_ns >= ATTAINED_S * NS_PER_S


def _counts(value: float | None, convert: Callable[[float], int]) -> int | None:
    return None if value is None else convert(value)
