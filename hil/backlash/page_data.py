"""The contents of the page of system B, from the desk's last jobs; no drawing."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime

from drivers.errors import InputError
from drivers.files import decode_log, read_bytes
from hil.axis.axis_file import DriveAxis
from hil.axis.backlash import REVERSALS
from hil.backlash import job as backlash
from hil.backlash.job import CompensationState
from hil.backlash.measured import BacklashResult
from hil.backlash.neutral_settings import SettingsBefore
from hil.backlash.result import NAMES, Reversal, TorqueBacklash
from hil.backlash.trace import read_trace
from hil.desk.desk import Desk
from hil.desk.progress import Phase, Progress
from hil.records.files import parse_json, split_lines


@dataclass(frozen=True)
class BacklashScreen:
    """measurement: the last one; parameter: the drive's compensation as last read, None before that

    by_direction_um: mean of the runs so far, by the direction after the reversal; mean_um: the value to be written,
    only of a complete measurement; warning: in English, "" for none; interrupted: a measurement left the drive's settings changed
    written: its mean was written since
    """

    measurement: Progress | None
    parameter: CompensationState | None
    by_direction_um: dict[int, float | None]
    mean_um: float | None
    warning: str
    interrupted: bool = False
    written: bool = False

    @property
    def to_write(self) -> bool:
        """Whether a mean was measured that was not written yet."""
        return self.mean_um is not None and not self.written


@dataclass(frozen=True)
class KeptBacklash:
    """The last measurement on disk. at: when its file was last written."""

    at: datetime
    found: TorqueBacklash


def kept_backlash(axis: DriveAxis) -> KeptBacklash | None:
    """The last measurement in the axis's folder, also of an earlier run of the server; None without a readable reversal."""
    files = sorted(axis.store.directory.glob("backlash-[0-9]*.jsonl"), key=lambda path: path.stat().st_mtime)
    if not files:
        return None
    reversals, asked = [], "both"
    try:
        text = decode_log(read_bytes(files[-1]))
    except InputError:
        return None
    for line in split_lines(text):
        with suppress(ValueError, InputError, TypeError, KeyError):  # torn, or of a reversal that was broken off
            form = parse_json(line)
            asked = asked if form.get("reversals") not in REVERSALS else form["reversals"]
            reversals.append(Reversal.of(int(form["run"]), read_trace(form)))
    if not reversals:
        return None
    at = datetime.fromtimestamp(files[-1].stat().st_mtime).astimezone()
    method, unknown = backlash.backlash_config(axis).method, SettingsBefore({}, from_note=False)
    return KeptBacklash(at, TorqueBacklash(tuple(reversals), method, REVERSALS[asked], unknown))


def backlash_screen(desk: Desk) -> BacklashScreen:
    """From the present state of the desk. Reads whether a note of an interrupted measurement exists."""
    measurement = desk.last(backlash.MEASURE)
    result = None if measurement is None else measurement.result
    found_um = warning = None
    if isinstance(result, BacklashResult):
        found_um, warning = result.lost_motion_um, result.verdict
    interrupted = backlash.unrestored(desk.axis) and not (measurement is not None and measurement.running)
    if interrupted:
        warning = "an interrupted measurement left the drive's backlash settings changed: restore them"
    by_direction = {direction: _mean(measurement, direction) for direction in NAMES}
    wrote = desk.last(backlash.WRITE)
    written = wrote is not None and measurement is not None and wrote.number > measurement.number
    written = written and wrote is not None and wrote.phase is Phase.DONE
    return BacklashScreen(measurement, _parameter(desk), by_direction, found_um, warning or "", interrupted, written)


def _mean(measurement: Progress | None, direction: int) -> float | None:
    """Mean over the completed runs of a direction; None where one had no value."""
    if measurement is None:
        return None
    values = [one.value for one in measurement.figures if one.name.endswith(NAMES[direction])]
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known and len(known) == len(values) else None


def _parameter(desk: Desk) -> CompensationState | None:
    """The compensation by the last job that read it."""
    jobs = [desk.last(kind) for kind in (backlash.LOOK, backlash.WRITE, backlash.RESTORE, backlash.SWITCH)]
    done = [job for job in jobs if job is not None and job.phase is Phase.DONE]
    latest = max(done, key=lambda job: job.number, default=None)
    return latest.result if latest is not None and isinstance(latest.result, CompensationState) else None
