"""A drive's table changed as a whole or not at all, on drives over a simulated CAN wire, whatever happens at whichever frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import can
import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.table_map import load_table_map
from drivers.correction_table import RawTable
from drivers.drive import DriveState
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    InputError,
    NoAnswerError,
    ProtocolError,
    StateError,
)
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.drive_table.change import (
    changing,
    held_table,
    remember_zero,
    remembered_made_with,
    remembered_zero,
    require_same,
    snapshot,
)
from hil.records.made_with import MadeWith
from hil.records.zero import Zero
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind
from sim_backends.own_table import ARRAY, TableForm, error_domain

FORMS = {"simulated_array": replace(ARRAY, points=20), "simulated_domain": error_domain(10.0)}
EVERY = 4
"""Of the frames of an array's change, one in so many; 1 takes twice as long as all the rest here."""
QUICK = CanOpenSettings(sdo_timeout_s=0.02, heartbeat_s=None)


class Port(can.BusABC):
    """The master's port, at which something may happen at one of the frames that it sends."""

    def __init__(self, inner: can.BusABC) -> None:
        super().__init__(channel="simulated")
        self.inner = inner
        self.channel_info = "simulated wire"
        self.sent = 0
        self.is_shut = False
        self.at: int | None = None
        self.what: Callable[[can.Message], bool] = lambda _message: True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent += 1
        if self.at is None or self.sent < self.at or self.what(msg):
            self.inner.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.inner.recv(timeout)

    def shutdown(self) -> None:
        super().shutdown()
        self.inner.shutdown()
        self.is_shut = True


class Rig:
    """A drive that holds a table, and a master that has the map of it."""

    def __init__(self, name: str, faults: tuple[CanFault, ...] = ()) -> None:
        self.name = name
        self.form: TableForm = FORMS[name]
        self.bench = CanBench(table=self.form, faults={5: faults})
        self.port = Port(self.bench.port())

    def raw(self, seed: int, points: int = 8) -> RawTable:
        values = tuple(seed * 100 + place for place in range(points))
        others = tuple(-value for value in values)
        if self.form.explicit:
            return RawTable(values, others, tuple(range(0, 1000 * points, 1000)))
        return RawTable(values, others, (), -500 * seed, 1000)

    @contextmanager
    def drive(self) -> Iterator[CanOpenDrive]:
        with CanLink(self.bench.port() if self.port.is_shut else self.port, self.bench.clock) as link:
            drive = CanOpenDrive(
                "X",
                AxisScaling(100_000, 10.0),
                DriveLimits(-3.0, 300.0, 200.0, 2000.0),
                self.bench.clock,
                link=link,
                node_id=5,
                settings=QUICK,
                table=load_table_map(self.name),
            )
            with drive:
                yield drive

    def holds(self) -> tuple[RawTable, bool]:
        """Asked over a fresh connection."""
        self.port = Port(self.bench.port())
        with self.drive() as drive:
            found = snapshot(held_table(drive))
        return found.raw, found.enabled


def prepared(name: str, note: Path) -> Rig:
    """A drive that corrects by an old table."""
    rig = Rig(name)
    with rig.drive() as drive, changing(drive, note, pytest.fail) as change:
        change.write(rig.raw(1))
        change.switch(True)
    rig.port = Port(rig.bench.port())
    return rig


def change_all(
    rig: Rig,
    note: Path,
    tell: Callable[[str], None],
    error: BaseException | None = None,
    raw: RawTable | None = None,
) -> None:
    with rig.drive() as drive, changing(drive, note, tell) as change:
        change.write(raw or rig.raw(3, points=9))
        change.switch(True)
        if error is not None:
            raise error


@pytest.fixture
def note(tmp_path: Path) -> Path:
    return tmp_path / "before.json"


both = pytest.mark.parametrize("name", ["simulated_domain", pytest.param("simulated_array", marks=pytest.mark.outside)])


@pytest.mark.parametrize("name", FORMS)
def test_a_table_is_written_switched_and_the_drive_applies_it(name: str, note: Path) -> None:
    rig = prepared(name, note)
    assert rig.holds() == (rig.raw(1), True)
    own = rig.bench.slave.table
    assert own is not None
    assert own.table.enabled
    assert own.table.added(0.0, upwards=True) == pytest.approx(-100.0 if own.table.form.negated else 100.0, abs=1.0)
    assert not note.exists()
    change_all(rig, note, pytest.fail)
    assert rig.holds() == (rig.raw(3, points=9), True)


@pytest.mark.parametrize("name", FORMS)
def test_only_what_differs_is_written(name: str, note: Path) -> None:
    rig = prepared(name, note)
    with rig.drive() as drive:
        table = held_table(drive)
        old = table.read()
        table.switch(False)
        before = rig.port.sent
        table.write(old, old)
        assert rig.port.sent == before
        if not rig.form.explicit:
            table.write(RawTable((*old.plus[:-1], 7), old.minus, (), old.origin, old.step), old)
            assert rig.port.sent == before + 1


@both
def test_an_error_inside_leaves_the_drive_as_it_was(name: str, note: Path) -> None:
    rig = prepared(name, note)
    for error in (KeyboardInterrupt(), InputError("no")):
        with pytest.raises(type(error)):
            change_all(rig, note, pytest.fail, error)
        assert rig.holds() == (rig.raw(1), True)
        assert not note.exists()


@both
def test_undo_is_the_same_without_an_error(name: str, note: Path) -> None:
    rig = prepared(name, note)
    with rig.drive() as drive, changing(drive, note, pytest.fail) as change:
        change.write(rig.raw(3))
        change.undo()
    assert change.undone
    assert rig.holds() == (rig.raw(1), True)


def test_nothing_is_touched_under_power(note: Path) -> None:
    rig = prepared("simulated_array", note)
    with rig.drive() as drive:
        drive.enable()
        with (
            pytest.raises(StateError, match="while the axis is disabled, it is operation enabled"),
            changing(drive, note, pytest.fail),
        ):
            pytest.fail("entered")
        with pytest.raises(AbortError, match="present device state"):
            held_table(drive).switch(False)
        drive.disable()
        with changing(drive, note, pytest.fail) as change:
            drive.enable()
            with pytest.raises(StateError, match="not changed under power"):
                change.write(rig.raw(3))
            with pytest.raises(StateError, match="not changed under power"):
                change.switch(False)
    assert rig.holds() == (rig.raw(1), True)


def test_a_drive_whose_state_is_not_known_may_be_under_power(note: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = prepared("simulated_array", note)
    with rig.drive() as drive:
        sample = drive.sample()
        monkeypatch.setattr(drive, "sample", lambda: replace(sample, state=DriveState.UNKNOWN))
        with pytest.raises(StateError, match="while the axis is disabled"), changing(drive, note, pytest.fail):
            pytest.fail("entered")
    assert rig.holds() == (rig.raw(1), True)


def test_a_drive_without_a_table_says_so() -> None:
    rig = Rig("simulated_array")
    with rig.drive() as drive:
        drive.node.table = None
        with pytest.raises(CapabilityError, match="no correction table that is described"):
            held_table(drive)


def test_a_table_that_is_none_is_refused_by_the_drive_and_taken_back(note: Path) -> None:
    rig = prepared("simulated_array", note)
    with pytest.raises(AbortError, match="invalid value"):
        change_all(rig, note, pytest.fail, raw=RawTable((1,), (1,), (), 0, 10))
    assert rig.holds() == (rig.raw(1), True)


def test_a_note_that_is_none_is_refused(note: Path) -> None:
    rig = Rig("simulated_array")
    note.write_text("[]")
    with (
        pytest.raises(InputError, match="no note of a drive's correction table"),
        rig.drive() as drive,
        changing(drive, note, pytest.fail),
    ):
        pytest.fail("entered")


def test_what_a_table_was_made_in_is_remembered_for_that_table_alone(tmp_path: Path) -> None:
    note, raw, other = tmp_path / "new" / "X.drive-table.json", RawTable((1, 2)), RawTable((1, 3))
    assert (remembered_zero(note, raw), remembered_made_with(note, raw)) == (None, None)
    zero, made_with = Zero("z1", "X", "2026-03-02T10:00:00+00:00"), MadeWith({"gear": 2.0}, {"backlash": 5.0})
    remember_zero(note, raw, zero, made_with)
    assert (remembered_zero(note, raw), remembered_made_with(note, raw)) == (zero, made_with)
    assert (remembered_zero(note, other), remembered_made_with(note, other)) == (None, None)
    remember_zero(note, other, None)
    assert (remembered_zero(note, other), remembered_made_with(note, other)) == (None, None)
    note.write_text("{}")
    for read in (remembered_zero, remembered_made_with):
        with pytest.raises(InputError, match="does not say"):
            read(note, raw)


def test_what_differs_is_named() -> None:
    old = RawTable((1, 2), (3, 4), (5, 6))
    require_same("X", old, old)
    for kept, words in (
        (RawTable((1, 2), (3, 5), (5, 6)), "minus 2 was written 4, it reads back 5"),
        (RawTable((1, 2), (3, 4), (5, 6), backlash=1), "backlash was written 0, it reads back 1"),
        (RawTable((1,), (3,), (5,)), "2 values of plus were written, 1 read back"),
    ):
        with pytest.raises(ProtocolError, match=words):
            require_same("X", old, kept)


# -- at every frame ------------------------------------------------------------------------------------------------------


def _interrupted(_message: can.Message) -> bool:
    raise KeyboardInterrupt


def _unplugged(_message: can.Message) -> bool:
    raise can.CanOperationError("unplugged")


class _Once:
    """Once, then as before."""

    def __init__(self, what: Callable[[can.Message], bool]) -> None:
        self.does = what
        self.done = False

    def __call__(self, message: can.Message) -> bool:
        if self.done:
            return True
        self.done = True
        return self.does(message)


HAPPENINGS: dict[str, Callable[[], Callable[[can.Message], bool]]] = {
    "Ctrl-C": lambda: _Once(_interrupted),
    "a frame lost": lambda: _Once(lambda _message: False),
    "unplugged for good": lambda: _unplugged,
    "all frames lost": lambda: lambda _message: False,
}


def happens_at(name: str, happening: str, frame: int, folder: Path) -> bool:
    """Change a table while something happens at a frame; whether the frame was reached. Judges how the drive is left."""
    note = folder / f"{happening}-{frame}.json"
    rig = prepared(name, note)
    told: list[str] = []
    rig.port.at, rig.port.what = frame, HAPPENINGS[happening]()
    old, new = (rig.raw(1), True), (rig.raw(3, points=9), True)
    error: BaseException | None = None
    try:
        change_all(rig, note, told.append)
    except (KeyboardInterrupt, BridgeError) as found:
        error = found
    reached = rig.port.sent >= frame
    left_over = note.exists()
    found = rig.holds()
    if error is None:
        assert (found, left_over, told) == (new, False, [])
    elif not left_over:
        assert (found, told) == (old, [])
    else:  # the drive could not be reached any more: said so, and made good by the next who changes it
        assert "kept in" in told[-1]
        assert found in (old, new) or not found[1], "it corrects by half a table"
        with rig.drive() as drive, changing(drive, note, told.append):
            pass
        assert "has been put back" in told[-1]
        assert rig.holds() == old
    return reached


def frames_of(name: str, folder: Path) -> tuple[int, int]:
    """The first frame of the change itself, and the last."""
    rig = prepared(name, folder / "frames.json")
    with rig.drive() as drive:
        first = rig.port.sent
        with changing(drive, folder / "frames.json", pytest.fail) as change:
            change.write(rig.raw(3, points=9))
            change.switch(True)
        return first + 1, rig.port.sent


@pytest.mark.parametrize("happening", ["Ctrl-C", "unplugged for good"])
def test_whatever_happens_at_some_frames(happening: str, tmp_path: Path) -> None:
    first, last = frames_of("simulated_domain", tmp_path)
    for frame in (first + 3, last - 3):
        assert happens_at("simulated_domain", happening, frame, tmp_path)


@pytest.mark.outside
@pytest.mark.parametrize("happening", HAPPENINGS)
@both
def test_whatever_happens_at_every_frame(name: str, happening: str, tmp_path: Path) -> None:
    first, last = frames_of(name, tmp_path)
    for frame in range(first, last + 1, EVERY):
        assert happens_at(name, happening, frame, tmp_path), frame
    assert not happens_at(name, happening, 10 * last, tmp_path)


@both
def test_a_value_that_the_drive_keeps_otherwise_is_found_and_all_is_taken_back(name: str, note: Path) -> None:
    rig = prepared(name, note)
    dictionary = rig.bench.slave.dictionary
    key = (0x2321, 0) if rig.form.explicit else (0x2314, 3)
    store = dictionary.set_raw
    wrong = iter([True])

    def kept(place: tuple[int, int], data: bytes) -> None:
        flips = place == key and next(wrong, False)
        store(place, bytes((data[0] ^ 1,)) + data[1:] if flips else data)

    dictionary.set_raw = kept  # type: ignore[method-assign]
    with pytest.raises(ProtocolError, match="reads back"):
        change_all(rig, note, pytest.fail)
    assert rig.holds() == (rig.raw(1), True)
    assert not note.exists()


def test_an_answer_lost_late_or_refused_once(note: Path) -> None:
    for kind in (CanFaultKind.SDO_LOST, CanFaultKind.SDO_LATE, CanFaultKind.SDO_ABORTED):
        rig = Rig("simulated_array", (CanFault(kind, size=0.03, count=1, skip=90),))
        try:
            change_all(rig, note, pytest.fail)
        except (AbortError, NoAnswerError):
            assert rig.holds() == (RawTable(), False)
        else:
            assert rig.holds() == (rig.raw(3, points=9), True)
