"""The drive's parameters of an axis, for scripts. The axis is disconnected for each of these and connected again."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.axis.axis_file import DriveAxis
from hil.script.results import ParameterComparison, ParameterWriting

if TYPE_CHECKING:
    from drivers.parameters import ParameterValue
    from hil.desk.job import Job
    from hil.parameters.set_file import ParameterSet

    Wanted = str | Path | Mapping[str, ParameterValue]


class Parameters:
    """A set is a file (TOML, DCF …), or values in the drive's units by address ("6072h", "2201h:01", "0x6072") or register name.

    What a set has that the drive's file has not, or that does not fit, is in `objections` of the result; nothing is written then.
    """

    def __init__(self, file: DriveAxis, run: Callable[[Job], Any]) -> None:
        self._file, self._run = file, run

    def backup(self, path: str | Path | None = None) -> Path:
        """Write every writable parameter to a file. path: None, beside the axis file, named by the time."""
        from hil.parameters import job  # noqa: PLC0415  (drivers load slowly)

        backed_up = self._run(job.backup_job(self._file, None if path is None else Path(path)))
        return Path(backed_up.path)

    def diff(self, wanted: Wanted) -> ParameterComparison:
        """Compare the drive with a set; nothing is written."""
        from hil.parameters import job  # noqa: PLC0415  (drivers load slowly)

        return self._compared(wanted, job.COMPARE)

    def verify(self, wanted: Wanted) -> ParameterComparison:
        """As `diff`, kept as the proof of a download."""
        from hil.parameters import job  # noqa: PLC0415  (drivers load slowly)

        return self._compared(wanted, job.VERIFY)

    def download(self, wanted: Wanted) -> ParameterWriting:
        """Write what differs and read it back, all or nothing."""
        from hil.parameters import job  # noqa: PLC0415  (drivers load slowly)

        return self._written(job.download_job(self._file, self._set(wanted)))

    def store(self, wanted: Wanted, *, audit: bool = False) -> ParameterWriting:
        """Have the drive keep a set that it holds. audit: prove it by a restart. Raises StateError where it holds another."""
        from hil.parameters import job  # noqa: PLC0415  (drivers load slowly)

        return self._written(job.store_job(self._file, self._set(wanted), audit=audit))

    def restore(self) -> ParameterWriting:
        """Put back the values before the last download. Raises InputError where there is none: download a backup instead."""
        from hil.parameters import job  # noqa: PLC0415  (drivers load slowly)

        return self._written(job.restore_job(self._file))

    def _compared(self, wanted: Wanted, kind: str) -> ParameterComparison:
        from hil.parameters import job  # noqa: PLC0415  (drivers load slowly)

        found = self._run(job.compare_job(self._file, self._set(wanted), kind))
        given = {_address(name): name for name in wanted} if isinstance(wanted, Mapping) else {}
        return ParameterComparison(self._file, None, found, given)

    def _written(self, writing: Job) -> ParameterWriting:
        return ParameterWriting(self._file, None, self._run(writing))

    def _set(self, wanted: Wanted) -> ParameterSet:
        from hil.parameters.job import load_set  # noqa: PLC0415  (drivers load slowly)
        from hil.parameters.set_file import ParameterSet, SetEntry  # noqa: PLC0415

        if isinstance(wanted, Mapping):
            return ParameterSet(
                "script", None, tuple(SetEntry(_address(name), value) for name, value in wanted.items())
            )
        return load_set(wanted, self._file)


_HEXADECIMAL = re.compile(r"^0[xX]([0-9A-Fa-f]{4})")


def _address(name: str) -> str:
    """An object's address in full; a register's name as it is."""
    from hil.axis.backlash import object_key  # noqa: PLC0415
    from hil.parameters.set_file import object_address  # noqa: PLC0415

    key = object_key(_HEXADECIMAL.sub(r"\1h", name))
    return name if key is None else object_address(*key)
