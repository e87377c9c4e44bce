"""The axis that is moved against the straightness error of another axis, while that other one moves.

It has no instrument and no targets of its own: it stands at one place, and is commanded away from there by what the moving axis's
straightness table says for the moving axis's position. That way is a motion of its own, with a direction: its own stored tables, where
it has any, correct it as any other, its reversals too.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

from drivers.drive import DriveState, ServoDrive
from drivers.errors import StateError
from drivers.undo import undo_all
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.compensation import Compensation, CorrectedSetPoint, MotionHistory
from hil.correction.streamed import StreamedCorrection
from hil.correction.tables import TableSet
from hil.machine.one_correction import refuse_while_drive_corrects
from hil.machine.set_points import CommandState
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.records.rows import UM_PER_MM
from hil.records.zero import ZeroKeeper

UNCHANGED_MM = 1e-6
"""A command that differs by less is not given again: a tenth of the finest count of the axes known here."""


def check_across(tables: TableSet, bound: CorrectionBound) -> None:
    """Hold what a straightness table adds to another axis against that axis's bound. Raises CorrectionBoundError."""
    if tables.straightness is not None and tables.straightness_axis:
        table = tables.straightness
        what = f"straightness correction not put into force, to axis {tables.straightness_axis}"
        bound.check_curves(what, table.position_mm, {1: table.plus_um, -1: table.minus_um})


class CrossAxisDrive:
    """A context manager: entering connects and enables nothing; leaving stops after an error, disables and disconnects.

    at_mm: where it stands while nothing is to be corrected; velocity_mm_s: of its moves; run_in_mm: it comes to `at_mm` upwards from
    so far below, so that its direction is known; homes: it may be homed here, where its drive does not say that it is; bound: its own
    """

    def __init__(
        self,
        drive: ServoDrive,
        at_mm: float,
        *,
        velocity_mm_s: float,
        run_in_mm: float,
        homes: bool,
        zero: ZeroKeeper | None = None,
        bound: CorrectionBound = CAREFUL,
    ) -> None:
        self.name = drive.name
        self.at_mm = at_mm
        self.state = CommandState()
        self.state.bound = bound
        self.axis = WatchedAxis(drive, on_stop=self._stopped)
        self.supervisor = Supervisor([self.axis])
        self.velocity_mm_s = velocity_mm_s
        self._run_in_mm = run_in_mm
        self._homes = homes
        self.zero = zero

    def _stopped(self) -> None:
        self.state.forget()
        self.axis.kept_for = ""

    @property
    def drive(self) -> ServoDrive:
        return self.axis.drive

    def __enter__(self) -> Self:
        self.drive.open()
        try:
            self.supervisor.begin()
        except BaseException as error:
            undo_all((("", self.drive.close),), during=error)
            raise
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.axis.kept_for = ""
        self.drive.corrected_outside = False
        self.supervisor.leave(exc, (f"drive {self.name} was not let go", self.drive.close))

    def corrected_by(self, own: Compensation | None) -> None:
        """Put its own stored correction into force, before it is made ready. Raises StateError while its drive corrects too, and
        CorrectionBoundError."""
        if own is not None:
            refuse_while_drive_corrects(self.drive)
            own.check(self.state.bound, f"correction of axis {self.name} not put into force")
        self.state.compensation = own
        self.drive.corrected_outside = own is not None

    def check(self, tables: TableSet) -> None:
        """Hold a straightness table against this axis's bound and travel. Raises CorrectionBoundError, LimitError."""
        check_across(tables, self.state.bound)
        if tables.straightness is not None:
            for values_um in (tables.straightness.plus_um, tables.straightness.minus_um):
                for value_um in (values_um.min(), values_um.max()):
                    self.drive.limits.check_target(self.at_mm + float(value_um) / UM_PER_MM)

    # -- standing where it is to stand -----------------------------------------------------------------------------------
    @property
    def ready(self) -> bool:
        """Whether it stands where it was commanded to, from a known direction."""
        return self.state.history is not None

    def get_ready(self) -> None:
        """Enable, home where that is allowed and needed, and come to `at_mm` from below, unless it stands ready.

        Raises StateError, before anything moves, for an axis that is not homed and may not be, ZeroError, and as `Supervisor.move`.
        """
        if self.ready:
            return
        self.drive.limits.check_target(self.at_mm - self._run_in_mm)
        self.drive.limits.check_target(self.at_mm)
        homed = self.drive.sample().homed
        if not homed and not self._homes:
            raise StateError(f"axis {self.name} is not homed, and is to be moved for straightness: home it first")
        if self.zero is not None:
            own = self.state.compensation
            stored = None if own is None else own.zero
            old = own is not None and stored is None
            self.zero.begin(self.drive, homes=self._homes, tables=stored, old_tables=old)
        if self.drive.sample().state is not DriveState.ENABLED:
            self.drive.disable()  # a quick stop holds the drive until it is disabled
        self.supervisor.get_ready(home=self._homes)
        below_mm = self.at_mm - self._run_in_mm
        self.supervisor.move(below_mm, self.velocity_mm_s)
        self.supervisor.move(self.at_mm, self.velocity_mm_s)
        self.state.set_position(MotionHistory(below_mm).moved_to(self.at_mm), self.at_mm)
        self.axis.kept_for = "standing for straightness"

    def without_power(self) -> None:
        """Disable it, while a person works in the machine; `get_ready` brings it back."""
        self._stopped()
        self.drive.disable()

    # -- moving ------------------------------------------------------------------------------------------------------------
    def command(self, across_um: float, time_s: float) -> CorrectedSetPoint:
        """The command at a time (s) at which the moving axis's straightness adds `across_um` to this axis.

        Raises StateError before `get_ready` and after a stop, CorrectionBoundError beyond this axis's bound.
        """
        return self.state.command(self.at_mm, {"time_s": time_s, "velocity_mm_s": 0.0}, across_um=across_um)

    def set_points(self, time_s: float) -> StreamedCorrection:
        """Begin a stream beside that of the moving axis. Raises as `command`."""
        return self.state.stream({"time_s": time_s, "velocity_mm_s": 0.0})

    def set_point(self, points: StreamedCorrection, across_um: float, time_s: float) -> float:
        """The next command of such a stream, mm, as `command` gives it."""
        points.known["time_s"] = time_s
        return points.command_mm(self.at_mm, across_um)

    def unchanged(self, command: CorrectedSetPoint) -> bool:
        """Whether it stands there already."""
        return abs(command.command_mm - self.state.commanded_mm) < UNCHANGED_MM
