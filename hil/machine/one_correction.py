"""Guard against two corrections at once: the bridge's, and the drive's by a table of its own.

The drive's state is read each time and never cached: another master, a stored switch or an operator's panel may have enabled its
table.
"""

from __future__ import annotations

from drivers.correction_table import CorrectionTable
from drivers.drive import ServoDrive
from drivers.errors import StateError

TWICE = "with the bridge's correction the error would be corrected twice"


def refuse_while_drive_corrects(drive: ServoDrive, because: str = TWICE) -> None:
    """Raises StateError while the drive corrects by a table of its own. because: the reason in the message."""
    table = drive.correction_table
    if table is not None and table.enabled():
        raise StateError(
            f"drive {drive.name} corrects this axis itself, its {table.description.name} is switched on: {because}; switch the"
            " drive's off (hil params table remove), or leave it to the drive"
        )


def switch_table(drive: ServoDrive, table: CorrectionTable, on: bool) -> None:
    """Switch a drive's table on or off. Raises StateError when it is to be switched on while the bridge's correction is in force."""
    if on and drive.corrected_outside:
        raise StateError(
            f"drive {drive.name}: the bridge's correction is in force, and with {table.description.name} switched on the error"
            " would be corrected twice; take the bridge's out first"
        )
    table.switch(on)
