"""Campaigns read for the index: each as one line, its values and its rows, in Parquet. What cannot be read is a line
with its reason.

Runs in worker processes, on this computer or others; the directory must have the same path there.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from drivers.errors import BridgeError, InputError
from drivers.files import read_text
from drivers.undo import one_line
from hil.figures.history import REPLAY, Pass, read_campaign
from hil.fleet.values import FleetValue, is_result, of_pass, of_result, of_torque_file
from hil.records.files import parse_json
from hil.records.journal import MARKER
from hil.records.rows import REQUIRED, Records

MOST_BYTES = 200_000_000
"""Largest file that is read: a pass of two million rows. A larger one is listed with that reason."""
MOST_COLUMNS = 200
"""Most columns of a pass whose rows are stored: each would be a column of the whole table."""
OTHER_ROWS = ("circle", "probe")
"""Kinds of campaigns whose files hold other rows than positions of one axis."""
_WHEN = pa.timestamp("us", tz="UTC")
_NAME = pa.dictionary(pa.int32(), pa.string())
CAMPAIGNS = pa.schema(
    [
        ("campaign", pa.string()),
        ("signature", pa.string()),
        ("axis", pa.string()),
        ("kind", pa.string()),
        ("begun", _WHEN),
        ("passes", pa.int32()),
        ("rows", pa.int64()),
        ("why", pa.string()),
    ]
)
"""One line per campaign. campaign: its directory below the indexed one; why: what could not be read, "" for nothing."""
RESULTS = pa.schema(
    [
        ("campaign", pa.string()),
        ("axis", pa.string()),
        ("kind", pa.string()),
        ("source", pa.string()),
        ("begun", _WHEN),
        ("quantity", pa.string()),
        ("value", pa.float64()),
        ("std", pa.float64()),
        ("of", pa.int32()),
        ("temp_c", pa.float64()),
    ]
)
"""One line per value. source: pass or file; std: standard uncertainty by the campaign's own repeats or fit, null for
none."""
ROW_KEYS = (("campaign", _NAME), ("axis", _NAME), ("pass", _NAME), ("begun", _WHEN))
"""Columns of the rows before those of the records, whose names and units they keep."""
ROWS = pa.schema([*ROW_KEYS, *((name, pa.float64()) for name in REQUIRED)])
"""Columns that the rows have at least."""
SCHEMAS = {"campaigns": CAMPAIGNS, "results": RESULTS, "rows": ROWS}
TABLES = tuple(SCHEMAS)


@dataclass(frozen=True)
class Place:
    """A campaign's directory, or a file of reversals by torque. name: its path below the root; signature: of names,
    sizes and times of its files"""

    name: str
    path: Path
    signature: str


@dataclass
class _Read:
    """What one batch found, as lists of lines."""

    campaigns: list[dict[str, Any]] = field(default_factory=list)
    results: list[dict[str, Any]] = field(default_factory=list)
    rows: list[pa.Table] = field(default_factory=list)


def read_batch(places: Sequence[Place]) -> dict[str, bytes]:
    """The campaigns of these places as the contents of three Parquet files, by the names in `TABLES`."""
    found = _Read()
    for place in places:
        try:
            read = _torque if place.path.is_file() else _campaign
            read(place, found)
        except (BridgeError, OSError) as error:
            _unread(place, found, reason(error))
        except Exception as error:  # noqa: BLE001  one campaign that no reader foresaw must not end the index of all
            _unread(place, found, f"{type(error).__name__}: {one_line(error)}")
    rows = pa.concat_tables(found.rows or [ROWS.empty_table()], promote_options="default").unify_dictionaries()
    return {
        "campaigns": parquet(pa.Table.from_pylist(found.campaigns, CAMPAIGNS)),
        "results": parquet(pa.Table.from_pylist(found.results, RESULTS)),
        "rows": parquet(rows),
    }


def parquet(table: pa.Table) -> bytes:
    """The contents of a Parquet file with this table."""
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd")
    return out.getvalue()


def reason(error: BaseException) -> str:
    """An error of reading as one line that names the file without its directory."""
    if not isinstance(error, InputError):
        return one_line(error)
    where = "" if error.path is None else Path(error.path).name
    where += "" if error.line is None else f", line {error.line}"
    return f"{where} {error.what}".strip()


def text(value: object) -> str:
    """A value as one line that UTF-8 can hold."""
    return " ".join(str(value).split()).encode("utf-8", "backslashreplace").decode()


def axis_of(place: Place, axis: str) -> str:
    """The axis as the fleet names it: machine/axis, by the directory that holds the directory of the axis's campaigns.

    Axes of two machines that are both called X are two; without a directory above it, it is the axis's own name.
    """
    return text("/".join([*Path(place.name).parts[:-2], axis]))


def _unread(place: Place, found: _Read, why: str) -> None:
    """The line of a place that cannot be read, in place of what was read of it."""
    found.results = [one for one in found.results if one["campaign"] != place.name]
    found.campaigns.append(_line(place, "?", "?", why=[why]))


def _line(
    place: Place,
    axis: str,
    kind: str,
    begun: datetime | None = None,
    *,
    passes: int = 0,
    rows: int = 0,
    why: Iterable[str] = (),
) -> dict[str, Any]:
    return {
        "campaign": place.name,
        "signature": place.signature,
        "axis": axis,
        "kind": text(kind),
        "begun": begun,
        "passes": passes,
        "rows": rows,
        "why": "; ".join(map(text, why)),
    }


def _campaign(place: Place, found: _Read) -> None:
    for path in place.path.iterdir():
        if path.is_file() and path.stat().st_size > MOST_BYTES:
            raise InputError(
                f"{path.name} has {path.stat().st_size / 1e6:.0f} MB, expected at most {MOST_BYTES / 1e6:.0f}"
            )
    campaign = read_campaign(place.path)
    replayed, axis = campaign.kind == REPLAY, axis_of(place, campaign.axis)
    why: list[str] = []
    values: list[tuple[FleetValue, datetime]] = []
    tables: list[pa.Table] = []
    for one in campaign.passes:
        if one.state == "torn":
            why.append(f"{one.path.name} ends with an incomplete line, which is left out")
        if one.records is None:
            why += [] if one.only_begun or campaign.kind in OTHER_ROWS else [f"{one.path.name} {one.why}"]
        elif one.state == "changed":
            why.append(f"{one.path.name} was changed since it was closed")
        elif len(one.records.columns) > MOST_COLUMNS:
            why.append(f"{one.path.name} has {len(one.records.columns)} columns, expected at most {MOST_COLUMNS}")
        else:
            tables.append(_rows(place, axis, one, one.records))
            values += [] if replayed else [(value, one.begun) for value in of_pass(one.records, one.name)]
    if campaign.begun is not None and not replayed:
        for path in sorted(place.path.iterdir()):
            if is_result(path.name):
                try:
                    values += [(value, campaign.begun) for value in of_result(path)]
                except InputError as error:
                    why.append(f"{path.name} {error.what}")
    found.rows += tables
    found.campaigns.append(
        _line(
            place,
            axis,
            campaign.kind,
            None if campaign.begun is None else campaign.begun.astimezone(UTC),
            passes=len(campaign.passes),
            rows=sum(one.num_rows for one in tables),
            why=why,
        )
    )
    found.results += [
        _value(place, axis, campaign.kind, begun, value) for value, begun in values if np.isfinite(value.value)
    ]


def _value(place: Place, axis: str, kind: str, begun: datetime, value: FleetValue) -> dict[str, Any]:
    return {
        "campaign": place.name,
        "axis": axis,
        "kind": text(kind),
        "source": text(value.source),
        "begun": begun.astimezone(UTC),
        "quantity": value.quantity,
        "value": value.value,
        "std": value.std if np.isfinite(value.std) else None,
        "of": value.of,
        "temp_c": value.temp_c if np.isfinite(value.temp_c) else None,
    }


def _rows(place: Place, axis: str, one: Pass, records: Records) -> pa.Table:
    n = len(records)
    begun = one.begun.astimezone(UTC)
    keys = {"campaign": place.name, "axis": axis, "pass": text(one.name)}
    columns: dict[str, Any] = {
        name: pa.DictionaryArray.from_arrays(pa.array(np.zeros(n, np.int32)), pa.array([value]))
        for name, value in keys.items()
    }
    columns["begun"] = pa.array(np.full(n, np.datetime64(begun.replace(tzinfo=None), "us"))).cast(_WHEN)
    for name, values in records.columns.items():
        columns[name if name not in columns else f"{name}_"] = pa.array(values, from_pandas=True)  # NaN is null
    return pa.table(columns)


def _torque(place: Place, found: _Read) -> None:
    """Reversals by torque lie beside the campaigns of their axis, which name it where the file does not."""
    read = of_torque_file(place.path)
    begun = datetime.fromtimestamp(place.path.stat().st_mtime, UTC)
    if read.begun:
        begun = datetime.fromisoformat(read.begun).astimezone(UTC)
    axis = axis_of(place, read.axis or _axis_beside(place.path))
    found.campaigns.append(_line(place, axis, "backlash", begun, passes=1))
    found.results += [_value(place, axis, "backlash", begun, value) for value in read.values]


def _axis_beside(path: Path) -> str:
    names = set()
    for marker in path.parent.glob(f"*/{MARKER}"):
        try:
            form = parse_json(read_text(marker))
        except (InputError, ValueError):
            continue
        names |= {str(form["axis"])} if isinstance(form, dict) and "axis" in form else set()
    return names.pop() if len(names) == 1 else path.parent.name.removesuffix("-campaign")
