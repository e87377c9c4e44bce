"""The index of all campaigns below a directory: Parquet files that follow the campaigns, which stay the truth.

The index is a folder of parts, each a folder with `campaigns.parquet`, `results.parquet` and `rows.parquet`. A part
is written beside them and takes its name in one step, so a killed run leaves whole parts only and the next one goes
on. A campaign whose files have the names, sizes and times that they had is not read again. One that is gone or was
changed is taken out of its part first and then read anew: it is never there twice. While `fleet-index.json` says
that the index is not complete, whoever reads it is told.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from drivers.errors import InputError
from drivers.files import read_text, replace_file, sync_directory
from hil.fleet.executor import completed
from hil.fleet.read import SCHEMAS, TABLES, Place, parquet, read_batch, text
from hil.fleet.values import TORQUE_FILE, is_result
from hil.records.files import held, parse_json
from hil.records.journal import CHECKSUMS, MARKER

STATE = "fleet-index.json"
FORMAT = 1
BATCH = 100
"""Campaigns of one part: 25,000 rows and 2 s of work, so that a killed run repeats little and a part is worth a
file."""
MOST_SMALL = 8
"""Parts of less than half a batch, as weekly additions leave them, at which they are joined."""
_PART = re.compile(r"part-(\d{6})")


@dataclass(frozen=True)
class Updated:
    """What a run did. found: campaigns there are; read: anew; kept: unchanged and not read; gone: taken out; unread:
    directory and reason of what could not be read, also by earlier runs; rows: in all"""

    found: int
    read: int
    kept: int
    gone: int
    unread: tuple[tuple[str, str], ...]
    rows: int


# -- what there is -----------------------------------------------------------------------------------------------------
def places_below(root: Path) -> tuple[list[Place], list[tuple[str, str]]]:
    """Every campaign below a directory, and the directories that cannot be looked into, with the reason. Raises
    InputError for a root that is no directory."""
    if not root.is_dir():
        raise InputError("is no directory", path=root)
    found: list[Place] = []
    closed: list[tuple[str, str]] = []

    def refused(error: OSError) -> None:
        where = os.path.relpath(error.filename or root, root)
        closed.append((text(where), f"cannot be read: {error.strerror}"))

    for directory, folders, files in os.walk(root, onerror=refused):
        if STATE in files:
            folders.clear()
            continue
        folders.sort()
        here = Path(directory)
        if MARKER in files:
            relevant = [
                name for name in files if name.endswith(".csv") or name in (MARKER, CHECKSUMS) or is_result(name)
            ]
            found.append(_place(root, here, [here / name for name in sorted(relevant)]))
        found += [_place(root, here / name, [here / name]) for name in sorted(files) if TORQUE_FILE.fullmatch(name)]
    return found, closed


def _place(root: Path, path: Path, files: Iterable[Path]) -> Place:
    stamps = []
    for file in files:
        with suppress(OSError):  # gone since, or a dangling link: reading says which
            stat = file.stat()
            stamps.append((os.fsencode(file.name).hex(), stat.st_size, stat.st_mtime_ns))
    signature = hashlib.sha256(json.dumps(stamps).encode()).hexdigest()
    return Place(text(os.path.relpath(path, root)), path, signature)


# -- making it ---------------------------------------------------------------------------------------------------------
def update(
    root: Path,
    index: Path,
    *,
    scheduler: str | None = None,
    processes: int | None = None,
    again: bool = False,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Updated:
    """Make the index follow the campaigns. again: read all of them; progress: called with campaigns read, and to be
    read.

    Raises InputError for a root that is no directory, an index that is not one of ours, or one that another process
    is at work on.
    """
    places, closed = places_below(root)
    _begin(index)
    with held(index):
        _say(index, root, complete=False)
        _clean(index, everything=again)
        wanted = {place.name: place for place in places}
        known: dict[str, str] = {}
        gone = 0
        for part in _parts(index):
            signatures = _signatures(part)
            stale = {name for name, signature in signatures.items() if not _is_same(wanted.get(name), signature)}
            stale |= signatures.keys() & known.keys()
            gone += sum(name not in wanted for name in stale)
            if stale:
                _take_out(part, stale)
            known |= {name: signature for name, signature in signatures.items() if name not in stale}
        todo = [place for place in places if place.name not in known]
        batches = [todo[at : at + BATCH] for at in range(0, len(todo), BATCH)]
        done = 0
        if len(batches) == 1 and scheduler is None:  # a weekly addition: workers would take longer to start
            read = iter([(batches[0], read_batch(batches[0]))])
        else:
            read = completed(read_batch, batches, scheduler=scheduler, processes=processes)
        for batch, contents in read:
            _write_part(index, contents)
            done += len(batch)
            progress(done, len(todo))
        _join_small(index)
        table = read_table(index, "campaigns", ("campaign", "why", "rows"))
        why = [(one["campaign"], one["why"]) for one in table.to_pylist() if one["why"]]
        unread = tuple(sorted([*why, *closed]))
        _say(index, root, complete=True, unread=closed)
        rows = int(pc.sum(table["rows"]).as_py() or 0)
    return Updated(len(places), len(todo), len(known), gone, unread, rows)


def _is_same(place: Place | None, signature: str) -> bool:
    return place is not None and place.signature == signature


def _begin(index: Path) -> None:
    try:
        index.mkdir(parents=True, exist_ok=True)
        others = any(index.iterdir()) and not (index / STATE).exists()
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", path=index) from error
    if others:
        raise InputError(f"holds other files and no {STATE}, expected an index or an empty directory", path=index)


def _say(index: Path, root: Path, *, complete: bool, unread: Sequence[tuple[str, str]] = ()) -> None:
    form = {"format": FORMAT, "of": text(root.resolve()), "complete": complete, "unread": list(map(list, unread))}
    replace_file(index / STATE, (json.dumps(form, indent=1) + "\n").encode())


def _clean(index: Path, *, everything: bool) -> None:
    """Remove what a killed run left, and parts that cannot be read: their campaigns are read again."""
    for path in index.iterdir():
        if path.name.startswith((".new-", ".old-")) and path.is_dir():
            shutil.rmtree(path)
    for part in _parts(index):
        if everything or not _is_whole(part):
            shutil.rmtree(part)


def _is_whole(part: Path) -> bool:
    try:
        for name in TABLES:
            with pq.ParquetFile(part / f"{name}.parquet"):
                pass
    except (OSError, pa.ArrowException):
        return False
    return True


def _parts(index: Path) -> list[Path]:
    return sorted(path for path in index.iterdir() if _PART.fullmatch(path.name))


def _table(part: Path, name: str, columns: list[str] | None = None) -> pa.Table:
    return pq.read_table(
        part / f"{name}.parquet", columns=columns, partitioning=None
    )  # a path with "=" is no partition


def _signatures(part: Path) -> dict[str, str]:
    table = _table(part, "campaigns", ["campaign", "signature"])
    return dict(zip(table["campaign"].to_pylist(), table["signature"].to_pylist(), strict=True))


def _write_part(index: Path, contents: Mapping[str, bytes]) -> None:
    """Write a part under the next number; it is there completely or not at all."""
    last = max((int(path.name.removeprefix("part-")) for path in _parts(index)), default=0)
    name = f"part-{last + 1:06d}"
    new = index / f".new-{name}"
    new.mkdir()
    for table, data in contents.items():
        replace_file(new / f"{table}.parquet", data)
    new.rename(index / name)
    sync_directory(index)


def _remove(part: Path) -> None:
    old = part.with_name(f".old-{part.name}")
    part.rename(old)
    shutil.rmtree(old)


def _take_out(part: Path, stale: Iterable[str]) -> None:
    """Remove campaigns from a part. It is gone before its successor is there: a kill in between has its campaigns
    read again."""
    names = pa.array(sorted(stale), pa.string())
    contents = {}
    left = 0
    for name in TABLES:
        table = _table(part, name)
        table = table.filter(pc.invert(pc.is_in(table["campaign"].cast(pa.string()), names)))
        left += table.num_rows if name == "campaigns" else 0
        contents[name] = parquet(table)
    index = part.parent
    _remove(part)
    if left:
        _write_part(index, contents)


def _join_small(index: Path) -> None:
    """Join the parts that are small, once there are many."""
    counts = {part: pq.read_metadata(part / "campaigns.parquet").num_rows for part in _parts(index)}
    small = [part for part, count in counts.items() if count < BATCH // 2]
    if len(small) < MOST_SMALL:
        return
    contents = {}
    for name in TABLES:
        tables = [_table(part, name) for part in small]
        contents[name] = parquet(pa.concat_tables(tables, promote_options="default").unify_dictionaries())
    for part in small:
        _remove(part)
    _write_part(index, contents)


# -- reading it --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class State:
    """of: the directory that was indexed; complete: whether the last run ended; unread: directories that could not
    be looked into"""

    of: str
    complete: bool
    unread: tuple[tuple[str, str], ...]


def state_of(index: Path) -> State:
    """The state of an index. Raises InputError where there is none."""
    path = index / STATE
    if not path.exists():
        raise InputError("holds no index, make it with: hil fleet index", path=index)
    try:
        form = parse_json(read_text(path))
        unread = tuple((str(where), str(why)) for where, why in form["unread"])
        found = State(str(form["of"]), form["complete"] is True, unread)
        version = form["format"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("is not the state of an index: build the index again", path=path) from error
    if version != FORMAT:
        raise InputError(f"is of format {version}, expected {FORMAT}: build it again with --again", path=path)
    return found


def read_table(index: Path, name: str, columns: Sequence[str] | None = None) -> pa.Table:
    """One of the tables of an index, of all its parts. name: of `TABLES`. Raises InputError for a part that cannot
    be read."""
    tables: list[Any] = []
    for part in _parts(index):
        try:
            tables.append(_table(part, name, None if columns is None else list(columns)))
        except (OSError, pa.ArrowException) as error:
            raise InputError("cannot be read: build the index again", path=part / f"{name}.parquet") from error
    if not tables:
        table = SCHEMAS[name].empty_table()
        return table if columns is None else table.select(list(columns))
    return pa.concat_tables(tables, promote_options="default")
