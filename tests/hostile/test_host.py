"""The computer itself: a clock that is set during a campaign, a disk that is full at any write, two programs on one store."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hostile import disks
from hostile.places import VERBS, Place, store_of

import hil.correction.sealed.sealing
import hil.records.journal
import hil.records.zero
from hil.correction.sealed import check
from hil.figures.history import merge, read_campaign

# -- the clock ---------------------------------------------------------------------------------------------------------
JUMPS_S = (0, -86_400, 3_600, -7, 31_536_000, -31_536_000)


@contextmanager
def jumping_clock() -> Iterator[None]:
    """Each look at the wall clock finds it set to another day."""
    jumps = itertools.cycle(JUMPS_S)

    class Set(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Any:
            return datetime.now(tz) + timedelta(seconds=next(jumps))

    with ExitStack() as stack:
        for module in (hil.records.journal, hil.records.zero, hil.correction.sealed.sealing):
            stack.enter_context(patch.object(module, "datetime", Set))
        yield


def test_a_clock_that_is_set_changes_neither_rows_nor_tables_nor_their_order(tmp_path: Path) -> None:
    found = []
    for name in ("steady", "set"):
        place = Place(tmp_path / name, "virtual")
        with place.wired(), jumping_clock() if name == "set" else ExitStack():
            VERBS["calibrate"](place)
        axis = place.axis()
        campaign = read_campaign(axis.store.directory / "calibrate-001")
        found.append((store_of(axis).load().tables, campaign))
    (tables, steady), (tables_set, jumped) = found
    assert tables == tables_set
    assert [one.name for one in steady.passes] == [one.name for one in jumped.passes]
    assert [one.begun for one in jumped.passes] != sorted(one.begun for one in jumped.passes), "they did jump"
    rows, rows_set = merge(steady.passes), merge(jumped.passes)
    assert np.array_equal(rows.error_um, rows_set.error_um)
    assert np.all(np.diff(rows_set["time_s"]) >= 0.0)


def test_a_campaign_resumes_after_the_clock_was_set_back(tmp_path: Path) -> None:
    folder = tmp_path / "axis"
    place = Place(folder, "virtual")
    with place.wired(), jumping_clock():
        with disks.FullDisk("write", 20).here(), pytest.raises(Exception, match="No space left"):
            VERBS["calibrate"](place)
        VERBS["calibrate"](Place(folder, "virtual", resume=True))


# -- the disk ----------------------------------------------------------------------------------------------------------
def _some(verb: str, kind: str, folder: Path, most: int) -> list[int]:
    count = disks.writes(verb, kind, folder)
    return sorted({round(at) for at in np.linspace(1, count, min(most, count))}) if count else []


@pytest.mark.parametrize("kind", disks.KINDS)
@pytest.mark.parametrize("verb", ["verify", "backlash"])
def test_a_full_disk_ends_a_verb_in_one_line_and_it_goes_on_with_room(verb: str, kind: str, tmp_path: Path) -> None:
    for at in _some(verb, kind, tmp_path / "counted", 4):
        found = disks.run(verb, kind, at, tmp_path / f"{at}")
        assert not found.complaints, (at, found)


@pytest.mark.slow
@pytest.mark.parametrize("kind", disks.KINDS)
@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb != "probe"])
def test_a_disk_that_is_full_at_any_write_of_a_verb(verb: str, kind: str, tmp_path: Path) -> None:
    for at in _some(verb, kind, tmp_path / "counted", 6):
        found = disks.run(verb, kind, at, tmp_path / f"{at}")
        assert not found.complaints, (at, found)


# -- two programs ------------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_two_programs_on_one_store_lose_nothing_and_each_remembers_its_own(tmp_path: Path) -> None:
    axis = Place(tmp_path / "axis", "virtual").axis()
    code = "import sys; sys.path[:0] = sys.argv[3:]; from hostile.disks import save_often; save_often(*sys.argv[1:3])"
    programs = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(axis.path), name, *sys.path], stderr=subprocess.PIPE, text=True
        )
        for name in ("X", "Y")
    ]
    assert [(program.communicate(timeout=120)[1], program.returncode) for program in programs] == [("", 0)] * 2
    store = store_of(axis)
    binding = check(store.path.read_bytes(), store.builder_public).binding
    assert binding is not None
    assert binding.counter == 2 * disks.SAVES, "every save is one change of the file"
    assert store.load().tables == disks.level(disks.SAVES - 1.0)
