"""Needs of a register map: registers that must have certain values before the axis is enabled.

Some only the user can meet, with a remedy that the map states; the others are written before enabling and put back at the end.
"""

from __future__ import annotations

from functools import partial

from drivers.errors import StateError
from drivers.modbus.codec import Raw
from drivers.modbus.commands import Commands
from drivers.modbus.drive_map import DriveMap, Need, all_hold
from drivers.modbus.register_access import RegisterAccess
from drivers.undo import undo_all


class Needs:
    """The needs of one drive, as far as they do not hold yet."""

    def __init__(self, drive_name: str, drive_map: DriveMap, access: RegisterAccess, commands: Commands) -> None:
        self._name = drive_name
        self._map = drive_map
        self._access = access
        self._commands = commands
        self._found: dict[str, Raw] = {}  # values before they were written, in the order of writing

    def _unmet(self) -> list[Need]:
        """The needs of the map that do not hold now."""
        needs = self._map.needs
        raw = self._access.of_conditions([need.condition for need in needs]) if needs else {}
        return [need for need in needs if not all_hold((need.condition,), raw)]

    def require(self) -> None:
        """Raise StateError, with the remedy, for a need that only the user can meet."""
        for need in self._unmet():
            if need.write is None:
                raise StateError(self._text(need))

    def _text(self, need: Need) -> str:
        register = self._map.registers[need.condition.register]
        value = self._access.integers([register.name])[register.name]
        expected = " or ".join(f"{each:#x}" for each in need.condition.values)
        word = "anything but" if need.condition.negate else "expected"
        place = f"{register.table.value} {register.span.start:#06x}"
        text = f"drive {self._name}: {register.name} ({place}) reads {value:#x}, {word} {expected}: {need.why}"
        return f"{text}; {need.remedy}" if need.remedy else text

    def arrange(self) -> None:
        """Make hold what the map may make hold; each is read back. Raises StateError for one that does not."""
        for need in self._unmet():
            if need.write is not None:
                name = need.write.register
                if name not in self._found:
                    self._found |= self._access.read([name])
                self._commands.give((need.write,))
        for need in self._unmet():
            raise StateError(self._text(need))

    def put_back(self) -> None:
        """Restore them, the first arranged last: it may be what keeps the others out of the EEPROM. Raises as `undo_all`."""
        found, self._found = self._found, {}
        undo_all(
            [
                (f"{name} not put back", partial(self._access.write, {name: value}))
                for name, value in reversed(found.items())
            ]
        )
