"""A disk that is full from one moment of a verb on: every write, new file and flush fails. What is left goes on when there is room."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from hostile.judge import WALL_S, ended_after
from hostile.places import VERBS, Place, store_of

from drivers.errors import BridgeError, InputError
from hil.axis.axis_file import load_axis
from hil.correction.tables import DirectionalTable, TableMode, TableSet

KINDS = ("write", "new file", "flush")
RESUMED = ("calibrate", "verify", "lost-motion", "close-loop", "straightness")


class FullDisk:
    """Counts the writes, and fails from number `fails_at` on (0: never)."""

    def __init__(self, kind: str, fails_at: int = 0) -> None:
        self.kind, self.fails_at, self.count = kind, fails_at, 0

    def _call(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def called(*args: Any, **named: Any) -> Any:
            if self.kind != "new file" and not stat.S_ISREG(os.fstat(args[0]).st_mode):
                return real(*args, **named)  # a port
            self.count += 1
            if self.fails_at and self.count >= self.fails_at:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return real(*args, **named)

        return called

    @contextmanager
    def here(self) -> Iterator[None]:
        """From now on, for the files of this process."""
        module, name = {"write": (os, "write"), "new file": (tempfile, "mkstemp"), "flush": (os, "fsync")}[self.kind]
        with patch.object(module, name, self._call(getattr(module, name))):
            yield


@dataclass
class Run:
    """How a verb ended on a full disk, and then with room. complaints: empty for a correct run."""

    ended: str = ""
    resumed: str = ""
    complaints: list[str] = field(default_factory=list)


def _outcome(verb: str, place: Place) -> BaseException | None:
    try:
        with ended_after(WALL_S):
            VERBS[verb](place)
    except BaseException as error:  # noqa: BLE001 - it is the result to judge
        return error
    return None


def writes(verb: str, kind: str, folder: Path) -> int:
    """The number of writes of this kind when nothing fails."""
    disk = FullDisk(kind)
    with disk.here():
        error = _outcome(verb, Place(folder, "virtual"))
    if error is not None:
        raise error
    return disk.count


def run(verb: str, kind: str, fails_at: int, folder: Path) -> Run:
    """The verb with the disk full from its write number `fails_at` on, and again with room."""
    benches: list[Any] = []
    found = Run()
    place = Place(folder, "virtual", on_bench=benches.append)
    with place.wired():
        _prepared(verb, place)
        with FullDisk(kind, fails_at).here():
            error = _outcome(verb, place)
        found.ended = "done" if error is None else f"{type(error).__name__}: {error}"
        if error is not None and not isinstance(error, BridgeError):
            found.complaints.append(f"ends by {found.ended}")
        if isinstance(error, InputError) and "No space left" not in str(error):
            found.complaints.append(f"does not say why: {found.ended}")
        if any(bench.servo.powered for bench in benches):
            found.complaints.append("leaves the axis under power")
        found.complaints += [f"leaves {path.name} behind" for path in folder.rglob("*.part")]
        again = _outcome(verb, Place(folder, "virtual", resume=verb in RESUMED and _begun(folder)))
        if again is not None:
            again = _outcome(verb, Place(folder, "virtual")) if "no campaign to resume" in str(again) else again
        found.resumed = "done" if again is None else f"{type(again).__name__}: {again}"
        if again is not None:
            found.complaints.append(f"does not go on: {found.resumed}")
    return found


def _prepared(verb: str, place: Place) -> None:
    """The axis file and the keys, which a person makes before."""
    if verb != "probe":
        place.axis(machine={"lost-motion": "worn", "backlash": "worn", "straightness": "bent"}.get(verb, "geometric"))
        place._axes.clear()


def _begun(folder: Path) -> bool:
    """Whether there is an unfinished campaign."""
    return any(folder.rglob("campaign.json"))


# -- another program on the same store -----------------------------------------------------------------------------------
SAVES = 3


def level(value: float) -> TableSet:
    """Tables that can be told from each other."""
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable.constant(np.array([0.0, 100.0]), value))


def save_often(path: str, name: str) -> None:
    """Save an axis's tables again and again into the store of this axis file, and read each back."""
    store = store_of(load_axis(path))
    mine = replace(store, axis=name)
    for number in range(SAVES):
        mine.save_tables(level(float(number)))
        if mine.load().tables != level(float(number)):
            raise AssertionError(f"axis {name}: save {number} is lost")
