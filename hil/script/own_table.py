"""The correction table that the drive of an axis holds and applies itself, for scripts."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.desk.rows import Rows
from hil.script.given import Passwords

if TYPE_CHECKING:  # drivers load slowly
    from hil.desk.job import Job, Workplace
    from hil.drive_table.job import Stored
    from hil.drive_table.result import DriveTableResult


class OwnTable:
    """While the drive corrects by its table the bridge must not: `calibrate()`, `verify()` and `close_loop()` then refuse to start."""

    def __init__(
        self,
        file: DriveAxis,
        measured_file: Callable[[], AxisConfig],
        passwords: Passwords,
        carry_out: Callable[[Job], Any],
    ) -> None:
        self._file, self._measured_file, self._passwords = file, measured_file, passwords
        self._carry_out = carry_out

    def show(self) -> Rows:
        """What the drive holds: position_mm, and what it adds in each direction, plus_um and minus_um."""
        from hil.drive_table.job import held  # noqa: PLC0415  (drivers load slowly)

        curve = self._job(lambda place: held(self._file, place.drive)).curve
        nodes = curve.nodes_mm
        return Rows(
            {"position_mm": nodes, "plus_um": curve.correction_um(nodes, 1), "minus_um": curve.correction_um(nodes, -1)}
        )

    def download(
        self,
        *,
        prove_by: str = "instrument",
        positions: int = 7,
        runs: int = 2,
        tolerance_um: float = 1.0,
        seed: int = 1,
        deviation_um: float = 0.5,
        tables_only: bool = False,
    ) -> DriveTableResult:
        """Write the stored tables into the drive, prove them there and switch them on, as `hil params table download`.

        prove_by: "instrument", "drive" (the value that it says it adds) or "nothing"; deviation_um: largest difference from the stored
        tables; tables_only: without the effects, which a drive's table cannot hold. What is not proven is put back.
        """
        from hil.drive_table.job import Proving, download, made_table  # noqa: PLC0415  (drivers load slowly)

        axis, how = self._measured_file(), Proving(prove_by, positions, runs, tolerance_um, seed)
        stored = self._stored(axis, tables_only=tables_only)
        made = made_table(axis, stored, deviation_um)
        found: DriveTableResult = self._job(lambda place: download(_open(axis, place), stored, made, how, place.tell))
        return found

    def prove(
        self,
        *,
        prove_by: str = "instrument",
        positions: int = 7,
        runs: int = 2,
        tolerance_um: float = 1.0,
        seed: int = 1,
        tables_only: bool = False,
    ) -> DriveTableResult:
        """Prove that the drive corrects as the bridge does, as `hil params table prove`; arguments as for `download`.

        Raises InputError for prove_by "nothing".
        """
        from hil.drive_table.job import Proving, prove  # noqa: PLC0415  (drivers load slowly)

        axis, how = self._measured_file(), Proving(prove_by, positions, runs, tolerance_um, seed)
        stored = self._stored(axis, tables_only=tables_only)
        found: DriveTableResult = self._job(lambda place: prove(_open(axis, place), stored, how))
        return found

    def remove(self, *, keep_contents: bool = False) -> None:
        """Switch the drive's correction off and empty its table; keep_contents: switch it off only."""
        from hil.drive_table.job import remove  # noqa: PLC0415  (drivers load slowly)

        self._job(lambda place: remove(self._file, place.drive, place.tell, keep_contents=keep_contents))

    def _stored(self, axis: AxisConfig, *, tables_only: bool) -> Stored:
        from hil.drive_table.job import Stored  # noqa: PLC0415  (drivers load slowly)

        return Stored.of(self._passwords.store(axis, writing=False).load(), leave_out_effects=tables_only)

    def _job(self, work: Callable[[Workplace], Any]) -> Any:
        from hil.desk.job import Job  # noqa: PLC0415  (drivers load slowly)
        from hil.desk.plan import Plan  # noqa: PLC0415

        return self._carry_out(Job("drive table", Plan(self._file.name, self._file.drive.backend), work))


def _open(axis: AxisConfig, place: Workplace) -> Any:
    from hil.drive_table.job import ConnectedAxis  # noqa: PLC0415  (drivers load slowly)

    return ConnectedAxis(axis, place.drive, place.session, place.listener)
