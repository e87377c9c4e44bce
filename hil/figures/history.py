"""The history of an axis: campaigns on disk, their passes, whether each is unchanged since it was closed, and figures
over time.

Reads only. A pass is dated by its own line; one written before passes had that line, by its file.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.files import decode_log, read_bytes
from hil.figures.iso230 import Iso230, iso230
from hil.records.files import split_lines
from hil.records.journal import BEGUN, CHAINED, FINISHED, MARKER, checksums, grew_from, read_purpose
from hil.records.row_chain import order_written
from hil.records.rows import Records, concatenate, parse_csv

REPLAY = "replay"
"""Kind of a campaign whose rows come from a recording."""


def purpose_of_replay(purpose: Mapping[str, Any], recording: str) -> dict[str, Any]:
    """The purpose of a campaign whose rows come from the recording of this file name; unchanged without one ("")."""
    return {**purpose, "kind": REPLAY, "recording": recording} if recording else dict(purpose)


@dataclass(frozen=True)
class Pass:
    """One measuring pass on disk.

    records: its rows, None where there are none or they cannot be read (`why`)
    state: closed (unchanged since it was closed), changed (since then), open (rows added since, or never closed), torn
    (its last line is incomplete)
    begun: with its time zone; dated: by its own line, not by its file
    """

    path: Path
    records: Records | None
    why: str
    state: str
    begun: datetime
    dated: bool
    sha256: str
    notes: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.path.stem

    @property
    def only_begun(self) -> bool:
        """Whether its file holds no rows yet."""
        return "no rows" in self.why or "no header" in self.why

    def figures(self) -> Iso230 | str:
        """The figures of ISO 230-2, or the reason why there are none."""
        if self.records is None:
            return self.why
        try:
            return iso230(self.records)
        except InputError as error:
            return error.what


@dataclass(frozen=True)
class FoundCampaign:
    """A campaign's directory. purpose: what it was started for, as `Campaign` wrote it; passes in the order of time."""

    directory: Path
    purpose: Mapping[str, Any]
    passes: tuple[Pass, ...]

    @property
    def kind(self) -> str:
        return str(self.purpose.get("kind", "?"))

    @property
    def axis(self) -> str:
        return str(self.purpose.get("axis", "?"))

    @property
    def begun(self) -> datetime | None:
        return self.passes[0].begun if self.passes else None


def find_campaigns(places: Iterable[str | Path]) -> list[FoundCampaign]:
    """All campaigns in or below these directories, by date. Raises InputError for a directory that does not exist or
    cannot be read.
    """
    markers: set[Path] = set()
    for place in map(Path, places):
        if not place.is_dir():
            raise InputError("is no directory", path=place)
        markers.update(marker.resolve() for marker in place.rglob(MARKER))
    found = [read_campaign(marker.parent) for marker in sorted(markers)]
    return sorted(
        found, key=lambda one: (one.begun is None, one.begun.timestamp() if one.begun else 0.0, one.directory)
    )


def read_campaign(directory: Path) -> FoundCampaign:
    """One campaign. Raises InputError where there is none or its purpose cannot be read."""
    if not (directory / MARKER).is_file():
        raise InputError("holds no campaign", path=directory)
    purpose = read_purpose(directory)
    sums = checksums(directory)
    passes = [read_pass(path, sums.get(path.name)) for path in directory.glob("*.csv")]
    chained = all(any(note.startswith(BEGUN) and note.endswith(CHAINED) for note in one.notes) for one in passes)
    # the chain grew as they were measured; dates alone would turn them round where the computer's clock was set back
    place = {name: at for at, name in enumerate(order_written(directory) if chained else ())}
    passes.sort(key=lambda one: (place.get(one.path.name, len(place)), one.begun.timestamp(), one.name))
    return FoundCampaign(directory, purpose, tuple(passes))


def series(directory: Path, kind: str) -> list[Path]:
    """The folders of the campaigns of a kind in an axis's folder, the newest first."""
    begun = [marker.parent for marker in directory.glob(f"{kind}-[0-9]*/{MARKER}")]
    numbered = [path for path in begun if path.name.removeprefix(f"{kind}-").isdecimal()]
    return sorted(numbered, key=lambda path: int(path.name.rpartition("-")[2]), reverse=True)


def latest_file(directory: Path, kind: str, axis: str) -> Path | None:
    """The record file of the latest campaign of a kind, of one pass, that was measured to its end; None without one.

    Raises InputError as `read_campaign`.
    """
    for folder in series(directory, kind):
        path = folder / f"{kind}.csv"
        if (folder / FINISHED).exists() and path.exists() and read_purpose(folder).get("axis") == axis:
            return path
    return None


def read_pass(path: Path, closed_as: str | None) -> Pass:
    """One pass, also a damaged one; closed_as: its SHA-256 when it was closed. Raises InputError for a file that cannot
    be read.
    """
    data = read_bytes(path)
    sha256 = hashlib.sha256(data).hexdigest()
    whole = data[: data.rfind(b"\n") + 1]
    text = decode_log(whole)
    notes = tuple(line.removeprefix("#").strip() for line in split_lines(text) if line.startswith("#"))
    if whole != data:
        state = "torn"
    elif sha256 == closed_as:
        state = "closed"
    else:
        state = "open" if closed_as is None or grew_from(closed_as, data) else "changed"
    records, why = None, ""
    try:
        records = parse_csv(text, path)
    except InputError as error:
        why = error.what
    begun = _date(notes)
    dated = begun is not None
    begun = begun or datetime.fromtimestamp(path.stat().st_mtime).astimezone()
    return Pass(path, records, why, state, begun, dated, sha256, notes)


def _date(notes: Iterable[str]) -> datetime | None:
    for note in notes:
        if note.startswith(BEGUN):
            try:
                date = datetime.fromisoformat(note.removeprefix(BEGUN).removesuffix(CHAINED))
            except ValueError:
                continue
            return date.astimezone()
    return None


def merge(passes: Sequence[Pass]) -> Records:
    """Rows of passes in the order of time, runs numbered consecutively. Raises InputError for a pass without rows.

    `time_s` counts from the first pass where all are dated by their own line; else each begins where the one before it
    ended.
    """
    parts: list[Records] = []
    last_run, end_s = 0, 0.0
    all_dated = all(one.dated for one in passes)
    for one in passes:
        records = one.records
        if records is None:
            raise InputError(one.why, path=one.path)
        records = records.with_column("run", records.run - float(records.run.min()) + last_run + 1)
        last_run = int(records.run.max())
        if "time_s" in records:
            start_s = float(np.nanmin(records["time_s"]))
            after_s = 0.0 if not parts else end_s - start_s
            since_s = (one.begun - passes[0].begun).total_seconds() if all_dated else after_s
            records = records.with_column("time_s", records["time_s"] + max(since_s, after_s))
            end_s = float(np.nanmax(records["time_s"]))
        parts.append(records)
    return concatenate(parts)


@dataclass(frozen=True)
class Moment:
    """One pass of an axis's history.

    figures_um: by name, NaN where the pass has none; mean_temp_c: over its `temp_*_c` columns, NaN without them
    """

    at: Pass
    campaign: FoundCampaign
    figures_um: Mapping[str, float]
    mean_temp_c: float


def history(campaigns: Iterable[FoundCampaign], names: Iterable[str]) -> list[Moment]:
    """The passes that have at least one of these ISO 230-2 figures, in the order of time; replayed campaigns are left
    out.
    """
    wanted = tuple(names)
    moments = []
    for campaign in campaigns:
        for one in campaign.passes if campaign.kind != REPLAY else ():
            figures = one.figures()
            if isinstance(figures, Iso230) and one.records is not None:
                known = figures.figures()
                values = {name: math.nan if (value := known[name]) is None else value for name in wanted}
                if not all(map(math.isnan, values.values())):
                    moments.append(Moment(one, campaign, values, _mean_temp_c(one.records)))
    return sorted(moments, key=lambda moment: moment.at.begun.timestamp())


def usual_pass(moments: Iterable[Moment]) -> str:
    """The most frequent pass name, the latest of equals, so that a trend compares like with like. Raises ValueError
    without moments.
    """
    names = [moment.at.name for moment in moments]
    return max(reversed(names), key=names.count)


def _mean_temp_c(records: Records) -> float:
    places = [records[name] for name in records.columns if name.startswith("temp_") and name.endswith("_c")]
    values = np.concatenate([column[np.isfinite(column)] for column in places]) if places else np.empty(0)
    return float(values.mean()) if len(values) else math.nan


@dataclass(frozen=True)
class Trend:
    """A straight line through a figure over time: slope per 30 days with its standard deviation, µm."""

    slope_um: float
    std_um: float


def trend(days: np.ndarray[Any, np.dtype[np.float64]], value_um: np.ndarray[Any, np.dtype[np.float64]]) -> Trend | None:
    """Least squares over days, both shape (n,), NaN left out; None of fewer than three values or less than a day."""
    known = np.isfinite(value_um)
    x, y = days[known], value_um[known]
    if len(x) < 3 or np.ptp(x) < 1.0:
        return None
    x = x - x.mean()
    total = float(x @ x)
    slope = float(x @ y) / total
    residual = y - y.mean() - slope * x
    std = math.sqrt(float(residual @ residual) / (len(x) - 2) / total)
    return Trend(30.0 * slope, 30.0 * std)
