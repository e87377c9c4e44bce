"""Each decision of a download on a drive on paper: what is written, what is read back, when a start counts, what is tried again."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from support.paper_drive import IDENTITY, PaperDrive, done, task_on

from drivers.drive import DriveState
from drivers.errors import AbortError, CapabilityError, InputError, LinkLostError, NoAnswerError, ProtocolError
from drivers.parameters import ParameterValue
from drivers.raw_parameters import DriveIdentity, RawParameter, WireTime
from hil.correction.store import BoundTables
from hil.parameters.compare import Side, compare
from hil.parameters.download import download
from hil.parameters.journal import Download, DownloadPhase, Journal, Noted
from hil.parameters.preflight import match_set, objection_to_state, objections_to_identity, predict, seconds_together
from hil.parameters.recover import recover, set_after, set_before
from hil.parameters.report import Ending, JobReport, ParameterVerdict, Row, shown, slow
from hil.parameters.restart import load_defaults, restart_drive
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.snapshot import back_up
from hil.parameters.transaction import Target
from hil.records.made_with import MadeWith

REFUSED = AbortError("no", 0x06090030)


def bring(drive: PaperDrive, starts: int = 0, prove_all: bool = False, **goals: int) -> list[str]:
    present = dict(drive.held)
    return done(task_on(drive).bring(drive.bytes_of(**goals), present, starts=starts, prove_all=prove_all), drive.clock)


def fails_once(error: Exception, at: str) -> Callable[[str], None]:
    left = [error]

    def check(address: str) -> None:
        if address == at and left:
            raise left.pop()

    return check


# -- bringing and proving ----------------------------------------------------------------------------------------------
def test_only_what_differs_is_written_and_only_that_is_read_back() -> None:
    drive = PaperDrive(a=1, b=2, c=3)
    assert bring(drive, a=1, b=7, c=3) == ["b"]
    assert drive.log == ["w b 7", "r b"]
    assert drive.number("b") == 7


class ReservedBit(PaperDrive):
    """Shows its highest bit set or not, as it likes; its file has no b."""

    def same(self, entry: RawParameter, shown: bytes, meant: bytes) -> bool:
        return (shown[0], shown[1] & 0x7F) == (meant[0], meant[1] & 0x7F)

    def find(self, address: str) -> RawParameter | None:
        return None if address == "b" else super().find(address)


def test_what_differs_is_by_the_parameters_type_and_without_a_parameter_by_the_bytes() -> None:
    drive = ReservedBit(a=0x8005, b=0x8005, c=0x8005)
    assert bring(drive, a=5, b=5, c=6) == ["b", "c"]
    assert bring(drive, a=5, b=5, c=6) == []


def test_a_drive_whose_starts_nobody_hears_is_read_back_entirely_once_anything_was_written() -> None:
    deaf = PaperDrive(a=1, b=2, c=3)
    deaf.hears = False
    bring(deaf, a=1, b=7, c=3)
    assert deaf.log == ["w b 7", "r a", "r b", "r c"]
    deaf.log.clear()
    bring(deaf, a=1, b=7, c=3)
    assert deaf.log == []


def test_everything_is_read_back_where_that_is_asked_for() -> None:
    drive = PaperDrive(a=1, b=2)
    assert bring(drive, prove_all=True, a=1, b=2) == []
    assert drive.log == ["r a", "r b"]


def test_a_start_since_it_was_looked_at_is_found_out() -> None:
    for starts, then in ((0, 1), (3, 4), (4, 3)):
        drive = PaperDrive(a=1)
        drive.starts = then
        with pytest.raises(LinkLostError, match="drive X restarted meanwhile"):
            bring(drive, starts=starts, a=2)
        assert drive.number("a") == 2  # it was written, and whoever asked puts it back
    same = PaperDrive(a=1)
    same.starts = 3
    assert bring(same, starts=3, a=2) == ["a"]


def test_a_refusal_is_tried_again_after_the_rest_and_raised_when_nothing_helped() -> None:
    drive = PaperDrive(a=1, b=2, c=3)

    def needs_c(address: str, _value: int) -> None:
        if address == "a" and drive.number("c") != 9:
            raise REFUSED

    drive.on_write = needs_c
    bring(drive, a=5, b=6, c=9)
    assert drive.log[:4] == ["w a 5", "w b 6", "w c 9", "w a 5"]

    stubborn = PaperDrive(a=1, b=2)

    def never(address: str, _value: int) -> None:
        if address == "a":
            raise REFUSED

    stubborn.on_write = never
    with pytest.raises(AbortError):
        bring(stubborn, a=5, b=6)
    assert stubborn.log == ["w a 5", "w b 6", "w a 5"]  # a second round wrote nothing, so there is no third
    stubborn.log.clear()
    with pytest.raises(AbortError):
        bring(stubborn, a=5)
    assert stubborn.log == ["w a 5"]  # nor a second where nothing else was written


def test_what_is_no_refusal_ends_the_writing_at_once() -> None:
    drive = PaperDrive(a=1, b=2)

    def silent(_address: str, _value: int) -> None:
        raise NoAnswerError("silence")

    drive.on_write = silent
    with pytest.raises(NoAnswerError):
        bring(drive, a=5, b=6)
    assert drive.log == ["w a 5"]


def test_a_drive_may_take_half_a_second_to_show_what_it_took() -> None:
    for late_s, good in ((0.45, True), (0.6, False)):
        drive = PaperDrive(a=1, b=2)
        drive.on_write = lambda address, _value: address != "a"

        def shows(_address: str, drive: PaperDrive = drive, late_s: float = late_s) -> None:
            if drive.clock.now_ns() > late_s * 1e9:
                drive.held |= drive.bytes_of(a=5)

        drive.on_read = shows
        if good:
            assert bring(drive, a=5, b=6) == ["a", "b"]
            assert drive.log.count("r b") == 1  # what is proven is not read again
        else:
            with pytest.raises(ProtocolError, match=r"drive X: a name of a was written 5, it reads back 1$"):
                bring(drive, a=5, b=6)
        assert len(drive.log) > 15  # every 20 ms and the time of a read


def test_how_many_more_are_wrong_is_told() -> None:
    drive = PaperDrive(a=1, b=2, c=3)
    drive.on_write = lambda address, _value: address == "c"
    with pytest.raises(ProtocolError, match=r"written 5, it reads back 1 \(and 1 more\)"):
        bring(drive, a=5, b=6, c=7)


def test_limits_change_in_an_order_in_which_they_never_cross() -> None:
    for low, high, order in ((50, 60, ["high", "low"]), (5, 8, ["low", "high"])):
        drive = PaperDrive(high=20, low=10)
        drive.pairs = (("low", "high"),)
        assert bring(drive, high=high, low=low) == order
    ranked = PaperDrive(a=1, unit=1)
    ranked.ranks = {"a": 1}
    assert bring(ranked, a=5, unit=5) == ["unit", "a"]


def test_the_longest_answer_of_each_address_is_kept() -> None:
    drive = PaperDrive(a=1, b=2)
    job = task_on(drive)
    slow_one = [0.05]
    drive.on_read = lambda address: drive.clock.sleep_s(slow_one.pop()) if address == "a" and slow_one else None
    done(drive.show(["a", "b"], job.done), drive.clock)
    done(drive.show(["a", "b"], job.done), drive.clock)
    assert job.read_s == pytest.approx({"a": 0.051, "b": 0.001})
    assert job.write_s == {}
    drive.on_read = fails_once(REFUSED, "b")
    with pytest.raises(AbortError):
        done(drive.show(["a", "b"], job.done), drive.clock)


def test_putting_back_is_tried_for_three_seconds_with_longer_and_longer_pauses() -> None:
    drive = PaperDrive(a=1)

    def silent(_address: str) -> None:
        raise NoAnswerError("silence")

    drive.on_read = silent
    with pytest.raises(NoAnswerError):
        done(task_on(drive).settle_at(drive.bytes_of(a=5)), drive.clock)
    # after pauses of 20 40 80 … 1280 ms, 2.54 s, one more, of 2.56 s
    assert drive.log == ["r a"] * 9
    assert drive.clock.now_ns() * 1e-9 == pytest.approx(5.1 + 9 * 0.001)


@pytest.mark.parametrize("error", [NoAnswerError("silence"), LinkLostError("gone"), REFUSED, ProtocolError("odd")])
def test_putting_back_goes_on_after_one_failure(error: Exception) -> None:
    drive = PaperDrive(a=1, b=2)
    drive.on_read = fails_once(error, "b")
    assert done(task_on(drive).settle_at(drive.bytes_of(a=5, b=2)), drive.clock) == ["a"]
    assert drive.log == ["r a", "r b", "r a", "r b", "w a 5", "r a", "r b"]  # everything is read back at the end


def test_putting_back_ends_where_our_own_line_is_lost() -> None:
    drive = PaperDrive(a=1)
    drive.lost = True
    drive.on_read = fails_once(LinkLostError("our adapter"), "a")
    with pytest.raises(LinkLostError):
        done(task_on(drive).settle_at(drive.bytes_of(a=5)), drive.clock)
    assert drive.log == ["r a"]


def test_a_start_while_it_is_put_back_means_once_more() -> None:
    drive = PaperDrive(a=1, b=2)

    def starts_once(address: str, _value: int) -> None:
        drive.starts += drive.starts == 0

    drive.on_write = starts_once
    assert done(task_on(drive).settle_at(drive.bytes_of(a=5, b=2)), drive.clock) == []
    assert drive.log == ["r a", "r b", "w a 5", "r a", "r b", "r a", "r b", "r a", "r b"]


# -- a download --------------------------------------------------------------------------------------------------------
def the_set(*after: str, **values: int) -> ParameterSet:
    entries = tuple(
        SetEntry(address, None, value, after=after if address == "a" else ()) for address, value in values.items()
    )
    return ParameterSet("new", None, entries)


def load(drive: PaperDrive, folder: Path, *, store: bool = False, **values: int) -> JobReport:
    return download([Target(drive, the_set(**values), Journal(folder))], store=store)[0]


def phases(folder: Path) -> list[str]:
    last = Journal(folder).last()
    return [] if last is None else [phase.name for phase in last.phases]


def test_a_download_looks_writes_proves_and_stores(tmp_path: Path) -> None:
    drive = PaperDrive(a=1, b=2)
    drive.clock.sleep_s(5.0)  # its seconds count from the first access
    stages: list[tuple[str, int, int]] = []
    target = Target(drive, the_set("b", a=5, b=6), Journal(tmp_path))
    report = download([target], store=True, progress=lambda *told: stages.append((told[0], *told[2:])))[0]
    assert drive.log == ["r a", "r b", "w b 6", "w a 5", "r b", "r a", "store"]
    assert (report.ending, report.stored, report.good, report.error, report.journal) == (
        Ending.WRITTEN,
        True,
        True,
        "",
        "",
    )
    assert phases(tmp_path) == ["BEGIN", "PROVEN", "STORING", "STORED", "END"]
    assert [(r.old, r.new, r.verdict, r.unit) for r in report.rows] == [
        (1, 5, ParameterVerdict.WRITTEN, "rpm"),
        (2, 6, ParameterVerdict.WRITTEN, "rpm"),
    ]
    assert (report.rows[0].read_s, report.rows[0].write_s) == pytest.approx((0.001, 0.001))
    assert report.seconds == pytest.approx(0.006)
    assert stages == [("look", 1, 2), ("look", 2, 2), *[("write", n, 4) for n in (1, 2, 3, 4)]]
    stages.clear()
    target = Target(PaperDrive(a=1), the_set(a=5), Journal(tmp_path / "one"))
    download([target], progress=lambda *told: stages.append((told[0], *told[2:])))
    assert stages == [("look", 1, 1), ("write", 1, 2), ("write", 2, 2)]


def test_what_is_the_same_is_not_written_and_stored_only_when_asked(tmp_path: Path) -> None:
    drive = PaperDrive(a=1, b=2)
    report = load(drive, tmp_path, a=1, b=2)
    assert (report.ending, report.stored, phases(tmp_path)) == (Ending.UNCHANGED, False, [])
    assert {row.verdict for row in report.rows} == {ParameterVerdict.SAME}
    report = load(drive, tmp_path, store=True, a=1, b=2)
    assert (report.ending, report.stored) == (Ending.UNCHANGED, True)
    assert drive.log == ["r a", "r b"] * 2 + ["store"]
    assert load(drive, tmp_path, a=1, b=3).stored is False


@pytest.mark.parametrize("state", list(DriveState))
def test_parameters_are_written_without_power_on_the_motor_only(state: DriveState, tmp_path: Path) -> None:
    drive = PaperDrive(a=1)
    drive.shown_state = state
    allowed = state in (DriveState.NOT_READY, DriveState.SWITCH_ON_DISABLED, DriveState.READY, DriveState.FAULT)
    assert (objection_to_state(state) is None) is allowed
    report = load(drive, tmp_path, a=5)
    assert report.ending is (Ending.WRITTEN if allowed else Ending.REFUSED)
    assert drive.number("a") == (5 if allowed else 1)
    assert load_defaults([drive], pytest.fail) == ([""] if allowed else [f"drive X: {objection_to_state(state).why}"])  # type: ignore[union-attr]
    assert ("defaults" in drive.log) is allowed


def test_a_start_while_it_is_looked_at_or_before_all_is_proven_puts_everything_back(tmp_path: Path) -> None:
    early = PaperDrive(a=1, b=2)
    early.on_read = lambda _address: setattr(early, "starts", 1)
    report = load(early, tmp_path / "early", a=5, b=6)
    assert report.ending is Ending.REFUSED
    assert "restarted while it was read" in report.error
    assert not [line for line in early.log if line.startswith("w")]
    first, second = PaperDrive("X", a=1), PaperDrive("Y", a=1)

    def first_starts(_address: str, _value: int) -> None:
        first.starts += first.starts == 0

    second.on_write = first_starts
    targets = [Target(d, the_set(a=5), Journal(tmp_path / d.name)) for d in (first, second)]
    reports = download(targets, store=True)
    assert [r.ending for r in reports] == [Ending.PUT_BACK] * 2
    assert "drive X restarted before all of it was proven" in reports[0].error
    assert reports[1].notes == ("because of X",)
    assert (first.number("a"), second.number("a")) == (1, 1)
    assert "store" not in first.log + second.log


def test_one_refused_drive_leaves_the_others_untouched(tmp_path: Path) -> None:
    good, bad = PaperDrive("X", a=1), PaperDrive("Y", a=1)
    bad.refusals["a"] = "moves the axis"
    reports = download([Target(d, the_set(a=5), Journal(tmp_path / d.name)) for d in (good, bad)])
    assert [r.ending for r in reports] == [Ending.REFUSED] * 2
    assert good.number("a") == 1
    assert [str(each) for each in reports[1].objections] == ["a name of a: moves the axis"]
    unreadable = PaperDrive(a=1)
    unreadable.on_read = fails_once(REFUSED, "a")
    assert "cannot be read: " in str(load(unreadable, tmp_path / "z", a=5).objections[0])


def test_stored_tables_object_to_another_backlash_and_other_units_are_told(tmp_path: Path) -> None:
    """They were made with a backlash of 2 and a gear of 3: as it is it may be written, 5 and 4 not, and 4 beside 2 is told."""
    tables = BoundTables("X", None, MadeWith({"gear": 3.0}, {"backlash": 2.0}), corrects_reversal=True)
    for backlash, gear, ending, notes in (
        (2, 3, Ending.UNCHANGED, 0),
        (5, 3, Ending.REFUSED, 0),
        (2, 4, Ending.WRITTEN, 1),
    ):
        drive = PaperDrive(backlash=2, gear=3)
        contents = the_set(backlash=backlash, gear=gear)
        folder = tmp_path / f"{backlash} {gear}"
        (report,) = download([Target(drive, contents, Journal(folder), tables=tables)])
        assert (report.ending, len(report.notes)) == (ending, notes)
        assert [each.address for each in report.objections] == (["backlash"] if ending is Ending.REFUSED else [])


class FullDisk(Journal):
    """Cannot be written any more when a download goes back."""

    def note(self, download: Download, phase: DownloadPhase, **facts: object) -> None:
        if phase is DownloadPhase.GOING_BACK:
            raise InputError("cannot be written: the disk is full")
        super().note(download, phase, **facts)


def test_a_full_disk_is_told_and_no_reason_to_leave_a_drive_as_it_is(tmp_path: Path) -> None:
    drive = PaperDrive(a=1, b=2)

    def refuses_b(address: str, value: int) -> None:
        if (address, value) == ("b", 6):
            raise REFUSED

    drive.on_write = refuses_b
    (report,) = download([Target(drive, the_set(a=5, b=6), FullDisk(tmp_path))])
    assert (report.ending, drive.number("a")) == (Ending.PUT_BACK, 1)
    assert report.notes == ("cannot be written: the disk is full",)


def test_a_failing_drive_has_the_unchanged_ones_stay_unchanged(tmp_path: Path) -> None:
    still, bad = PaperDrive("X", a=5), PaperDrive("Y", a=1)

    def never(_address: str, value: int) -> None:
        if value == 5:
            raise REFUSED

    bad.on_write = never
    reports = download([Target(d, the_set(a=5), Journal(tmp_path / d.name)) for d in (still, bad)])
    assert [r.ending for r in reports] == [Ending.UNCHANGED, Ending.PUT_BACK]
    assert reports[1].rows[0].verdict is ParameterVerdict.PUT_BACK
    assert phases(tmp_path / "Y") == ["BEGIN", "GOING_BACK", "END"]


def test_what_cannot_be_put_back_stays_unfinished_and_has_to_be_finished_first(tmp_path: Path) -> None:
    drive = PaperDrive(a=1, b=2)

    def dies(address: str, _value: int) -> None:
        if address == "b":
            drive.on_read = fails = lambda _address: (_ for _ in ()).throw(NoAnswerError("silence"))
            fails("b")

    drive.on_write = dies
    report = load(drive, tmp_path, a=5, b=6)
    assert report.ending is Ending.UNFINISHED
    assert any("it could not be put back" in note for note in report.notes)
    assert report.journal.endswith("download-0001.jsonl")
    assert {row.verdict for row in report.rows} == {ParameterVerdict.UNKNOWN}
    with pytest.raises(InputError, match="is not finished"):
        load(drive, tmp_path, a=5)


# -- storing -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("hears", "started", "read_again"), [(True, 0, False), (True, 1, True), (False, 0, True)])
def test_after_storing_it_is_read_again_where_it_may_have_started(
    hears: bool, started: int, read_again: bool, tmp_path: Path
) -> None:
    drive = PaperDrive(a=1, b=2)
    drive.hears = hears
    drive.on_store = lambda: setattr(drive, "starts", started)
    assert load(drive, tmp_path, store=True, a=5, b=2).stored
    assert drive.log[drive.log.index("store") + 1 :] == (["r a", "r b"] if read_again else [])


def test_a_drive_that_started_before_it_stored_has_stored_something_else(tmp_path: Path) -> None:
    drive = PaperDrive(a=1)

    def starts_and_forgets() -> None:
        drive.starts += 1
        drive.held |= drive.bytes_of(a=1)

    drive.on_store = starts_and_forgets
    report = load(drive, tmp_path, store=True, a=5)
    assert (report.ending, report.stored) == (Ending.UNFINISHED, False)
    assert "whether the drive keeps it is not known" in report.notes[0]
    assert phases(tmp_path) == ["BEGIN", "PROVEN", "STORING"]


@pytest.mark.parametrize("refusal", [REFUSED, CapabilityError("no memory")])
def test_a_drive_that_says_no_to_storing_is_written_and_not_stored(refusal: Exception, tmp_path: Path) -> None:
    drive = PaperDrive(a=1)
    drive.on_store = lambda: (_ for _ in ()).throw(refusal)
    report = load(drive, tmp_path, store=True, a=5)
    assert (report.ending, report.stored, report.good) == (Ending.WRITTEN, False, False)
    assert report.error.startswith("it was not stored: ")
    assert phases(tmp_path)[-1] == "END"


def test_power_on_the_motor_before_storing_keeps_it_from_storing(tmp_path: Path) -> None:
    drive = PaperDrive(a=1)
    drive.on_write = lambda _address, _value: setattr(drive, "shown_state", DriveState.ENABLED)
    report = load(drive, tmp_path, store=True, a=5)
    assert "it was not stored" in report.error
    assert "store" not in drive.log
    drive = PaperDrive(a=1)
    drive.no_store = "it cannot"
    report = load(drive, tmp_path / "other", store=True, a=5)
    assert (report.ending, str(report.objections[0])) == (Ending.REFUSED, "it cannot")


# -- the audit ---------------------------------------------------------------------------------------------------------
def test_an_audit_reads_all_of_it_again_after_a_start(tmp_path: Path) -> None:
    for forgets, lost in ((False, ()), (True, ("a",))):
        drive = PaperDrive(a=1, b=2)
        if forgets:
            drive.on_restart = lambda drive=drive: drive.held.update(drive.bytes_of(a=1))  # type: ignore[misc]
        target = Target(drive, the_set(a=5, b=6), Journal(tmp_path / str(forgets)))
        report = download([target], store=True, ask=pytest.fail)[0]
        assert (report.audited, report.lost, report.good) == (not forgets, lost, not forgets)
        assert drive.log[-3:] == ["restart", "r a", "r b"]


def test_an_audit_that_did_not_come_to_its_end_proves_nothing(tmp_path: Path) -> None:
    drive = PaperDrive(a=1)

    def silent() -> None:
        if "restart" in drive.log:
            raise NoAnswerError("silence")

    drive.on_state = silent
    (report,) = download([Target(drive, the_set(a=5), Journal(tmp_path))], store=True, ask=pytest.fail)
    assert (report.ending, report.stored, report.audited, report.lost) == (Ending.WRITTEN, True, False, ())
    assert "does not answer after its restart" in report.error
    assert "not proven: the restart that was to show it did not succeed" in report.kept


@pytest.mark.parametrize(("silent_s", "good"), [(14.5, True), (15.5, False)])
def test_a_drive_has_fifteen_seconds_to_start(silent_s: float, good: bool) -> None:
    drive = PaperDrive()

    def silent() -> None:
        if drive.clock.now_ns() < silent_s * 1e9:
            raise NoAnswerError("silence")

    drive.on_state = silent
    if good:
        done(restart_drive(drive, pytest.fail), drive.clock)
    else:
        with pytest.raises(NoAnswerError, match="does not answer after its restart within 15 s"):
            done(restart_drive(drive, pytest.fail), drive.clock)


@pytest.mark.parametrize(
    ("off_s", "on_s", "said"),
    [(299.0, 590.0, ""), (301.0, 302.0, "was not switched off within 300 s"), (10.0, 320.0, "does not answer")],
)
def test_a_person_has_five_minutes_for_either_way_of_the_switch(off_s: float, on_s: float, said: str) -> None:
    drive = PaperDrive()
    asked: list[str] = []
    drive.on_restart = lambda: (_ for _ in ()).throw(CapabilityError("cannot"))

    def switched() -> None:
        if off_s <= drive.clock.now_ns() * 1e-9 < on_s:
            raise NoAnswerError("silence")
        raise ProtocolError("an answer all the same")

    drive.on_state = switched
    if said:
        with pytest.raises(NoAnswerError, match=said):
            done(restart_drive(drive, asked.append), drive.clock)
    else:
        done(restart_drive(drive, asked.append), drive.clock)
    assert asked == ["drive X: switch it off and on again"]


# -- going on ----------------------------------------------------------------------------------------------------------
def begun(folder: Path, *notes: DownloadPhase, store: bool = True) -> Journal:
    journal = Journal(folder)
    noted = (Noted("a", "", b"\1\0", b"\5\0", ("b",)), Noted("b", "", b"\2\0", b"\6\0"))
    download = journal.begin("X", "new", "", IDENTITY, noted, store=store)
    for phase in notes:
        journal.note(download, phase)
    return journal


@pytest.mark.parametrize(
    ("notes", "store", "way", "held", "stores"),
    [
        ((), True, "on", (1, 2), True),
        ((), False, "on", (1, 2), False),
        ((DownloadPhase.PROVEN, DownloadPhase.STORING), True, "on", (5, 6), True),
        ((DownloadPhase.PROVEN, DownloadPhase.STORING, DownloadPhase.STORED), True, "on", (5, 6), False),
        (
            (DownloadPhase.PROVEN, DownloadPhase.STORING, DownloadPhase.STORED),
            True,
            "on",
            (5, 2),
            True,
        ),  # it lost something since
        ((), True, "back", (5, 2), False),
        (
            (DownloadPhase.PROVEN, DownloadPhase.STORING),
            True,
            "back",
            (5, 6),
            True,
        ),  # it may have kept what is now undone
    ],
)
def test_going_on_in_either_direction(
    tmp_path: Path, *, notes: tuple[DownloadPhase, ...], store: bool, way: str, held: tuple[int, int], stores: bool
) -> None:
    forward = way == "on"
    journal = begun(tmp_path, *notes, store=store)
    drive = PaperDrive(a=held[0], b=held[1])
    stages: set[str] = set()
    progress = lambda stage, *_: stages.add(stage)  # noqa: E731
    report = recover([(drive, journal)], forward=forward, progress=progress)[0]
    assert stages == {"resume" if forward else "put back"}
    assert (drive.number("a"), drive.number("b")) == ((5, 6) if forward else (1, 2))
    assert report.ending is (Ending.WRITTEN if forward else Ending.PUT_BACK)
    assert (report.good, report.stored) == (True, stores)
    assert ("store" in drive.log) is stores
    writes = [line for line in drive.log if line.startswith("w")]
    if len(writes) == 2:
        assert [line[2] for line in writes] == ["b", "a"]  # a is to come after b
    going = [DownloadPhase.PROVEN] if forward else [DownloadPhase.GOING_BACK]
    storing = [DownloadPhase.STORING, DownloadPhase.STORED] if stores else []
    assert phases(tmp_path) == [
        phase.name for phase in (DownloadPhase.BEGIN, *notes, *going, *storing, DownloadPhase.END)
    ]
    assert recover([(drive, journal)], forward=forward) == []


def test_going_on_is_for_the_very_drive_and_without_power(tmp_path: Path) -> None:
    journal = begun(tmp_path)
    other = PaperDrive(a=1, b=2)
    other.identity = replace(IDENTITY, unit={"serial": 8})
    report = recover([(other, journal)], forward=True)[0]
    assert (report.ending, other.number("a")) == (Ending.UNFINISHED, 1)
    assert "is not as the download left it" in report.error
    powered = PaperDrive(a=1, b=2)
    powered.shown_state = DriveState.ENABLED
    assert recover([(powered, journal)], forward=True)[0].ending is Ending.UNFINISHED
    assert powered.number("a") == 1
    with pytest.raises(InputError, match="begun with b"):
        recover([(PaperDrive(a=1), journal)], forward=True)


def test_both_sides_of_a_download_as_sets(tmp_path: Path) -> None:
    noted = begun(tmp_path).last()
    assert noted is not None
    assert [(e.address, e.raw, e.after) for e in set_before(noted).entries] == [
        ("a", "0100", ("b",)),
        ("b", "0200", ()),
    ]
    assert [e.raw for e in set_after(noted).entries] == ["0500", "0600"]
    assert (set_before(noted).name, set_after(noted).name) == ("before new", "new")
    assert noted.changes
    assert replace(noted, parameters=(Noted("a", "", b"\1", b"\1"), Noted("b", "", b"\1", b"\2"))).changes


def test_the_last_change_is_not_one_that_only_kept(tmp_path: Path) -> None:
    journal = begun(tmp_path, DownloadPhase.END)
    kept = journal.begin("X", "kept", "", IDENTITY, (Noted("a", "", b"\5\0", b"\5\0"),), store=True)
    assert not kept.changes
    assert kept.path.name == "download-0002.jsonl"
    assert journal.last().set_name == "kept"  # type: ignore[union-attr]
    assert journal.last_change().set_name == "new"  # type: ignore[union-attr]
    assert journal.unfinished().set_name == "kept"  # type: ignore[union-attr]


# -- what is known before and said after ---------------------------------------------------------------------------------
def test_whose_set_it_is() -> None:
    other_model = replace(IDENTITY, model={"vendor_id": 0x1B})
    other_version = replace(IDENTITY, version={"firmware": "1"})
    other_unit = replace(IDENTITY, unit={"serial": 8})
    assert objections_to_identity(None, IDENTITY) == []
    assert objections_to_identity(IDENTITY, IDENTITY, same_unit=True) == []
    told = [each.why for each in objections_to_identity(other_model, IDENTITY, any_version=True)]
    assert told == ["the set is for vendor id 0x1b, this drive has 0x1a"]
    told = [each.why for each in objections_to_identity(other_version, IDENTITY)]
    assert told == ["the set was read with firmware '1', this drive has '2'"]
    assert objections_to_identity(other_version, IDENTITY, any_version=True) == []
    assert objections_to_identity(other_unit, IDENTITY) == []
    assert len(objections_to_identity(other_unit, IDENTITY, same_unit=True)) == 1
    assert "on modbus" in objections_to_identity(DriveIdentity("modbus"), IDENTITY)[0].why
    assert "has none" in objections_to_identity(IDENTITY, DriveIdentity("canopen", {}, IDENTITY.version))[0].why


def test_what_a_set_says_twice_has_to_agree() -> None:
    drive = PaperDrive(a=1)

    def told(entry: SetEntry) -> list[str]:
        return [str(each) for each in match_set(drive, ParameterSet("s", None, (entry,)))[1]]

    assert told(SetEntry("a", 5, 5, "u16")) == []
    assert told(SetEntry("a", 5, 6, line=4)) == [
        "line 4: a name of a: value 5 and raw 6 do not agree: raw is 6; remove raw to write the value"
    ]
    assert told(SetEntry("a", 5, type="U32")) == ["a name of a: is a U32 in the set, the drive's is a U16"]
    assert told(SetEntry("a", None, None)) == ["a name of a: has neither value nor raw"]
    assert told(SetEntry("z", 5, name="gain")) == ["z gain: the drive's file has no such parameter"]
    assert told(SetEntry("a", 5, after=("z",))) == ["a name of a: is to come after z, which is not in the set"]


def test_what_a_download_costs() -> None:
    """Looking at both is two reads; writing one and reading it back two frames and one: 2 · 3 · 0.12 ms."""
    drive = PaperDrive(a=1, b=2)
    wanted, _ = match_set(drive, the_set(a=5, b=6))
    every = predict(drive, wanted)
    assert (every.look.frames, every.write.frames, every.whole.answers) == (2, 6, 6)
    assert every.as_json()["write"] == {"frames": 6, "seconds": pytest.approx(7.2e-4), "answers": 4}
    one, other = WireTime(seconds=0.4, answers=10), WireTime(seconds=0.05, answers=90)
    # the bus: 0.45; thinking 5 ms an answer the second takes 0.05 + 0.45 = 0.5 by itself
    assert seconds_together([one, other]) == pytest.approx(0.45)
    assert seconds_together([one, other], 0.005) == pytest.approx(0.5)
    assert seconds_together([]) == 0.0


def row(address: str, read_s: float | None, write_s: float | None = None) -> Row:
    return Row(address, "", "", 1, 2, ParameterVerdict.WRITTEN, read_s, write_s)


def test_which_answers_are_slow() -> None:
    """Median 1 ms: five times that is 5 ms. Median 0.1 ms: five times 0.5 ms, but at least 2 ms longer, 2.1 ms."""
    usual = [row(f"u{i}", 0.001, 0.001) for i in range(5)]
    found = slow([*usual, row("a", 0.0051), row("b", 0.0049), row("c", 0.001, 0.009), row("d", None, None)])
    assert [one.address for one in found] == ["c", "a"]
    either = [row("a", 0.0051), row("c", 0.001, 0.009), row("e", 0.006, 0.006), row("f", 0.02, 0.001)]
    either.append(row("g", None, 0.007))
    assert [one.address for one in slow([*usual, *either])] == ["f", "c", "g", "e", "a"]  # by the slower of both
    quick = [row(f"u{i}", 0.0001, 0.0001) for i in range(5)]
    assert [one.address for one in slow([*quick, row("a", 0.0022), row("b", 0.002)])] == ["a"]
    assert slow([row("a", None)]) == []
    assert [shown(v) for v in (None, b"", b"\1\xff", 0.1, 7, "x")] == ["–", "empty", "01ff", "0.1", "7", "x"]


def test_what_is_good() -> None:
    for ending, good, back in (
        (Ending.UNCHANGED, True, False),
        (Ending.WRITTEN, True, False),
        (Ending.PUT_BACK, False, True),
        (Ending.REFUSED, False, False),
        (Ending.UNFINISHED, False, False),
    ):
        assert JobReport("X", ending).good is good, ending
        assert JobReport("X", ending, meant_back=True).good is back, ending
        assert not JobReport("X", ending, error="no").good
        assert JobReport("X", ending, audited=True).good is good
        assert not JobReport("X", ending, audited=False).good
    plain = JobReport("X", Ending.WRITTEN, (replace(row("a", 0.1), new=b"\xff"),)).as_json()
    assert (plain["ending"], plain["parameters"][0]["new"], plain["parameters"][0]["verdict"]) == (
        "written",
        "ff",
        "written",
    )


def test_what_a_restart_showed_to_be_lost_is_named_up_to_eight() -> None:
    lost = tuple(f"a{number}" for number in range(10))
    kept = JobReport("X", Ending.WRITTEN, stored=True, audited=False, lost=lost).kept
    assert "Different after the restart (10): a0, a1, a2, a3, a4, a5, a6, a7; `hil" in kept


def test_a_set_against_a_drive() -> None:
    """An answer takes 1 ms, of which 0.12 ms are the bus's; what differs costs a write and a read, what is the same a read."""
    drive = PaperDrive(a=1, b=2, c=3)
    drive.on_read = fails_once(REFUSED, "c")
    done_s: list[tuple[int, int]] = []
    found = compare([(drive, the_set(a=1, b=6, c=7))], progress=lambda *told: done_s.append(told[2:]))[0]
    assert [(r.held, r.wanted, r.side) for r in found.rows] == [
        (1, 1, Side.SAME),
        (2, 6, Side.DIFFERS),
        (None, 7, Side.UNKNOWN),
    ]
    assert [r.why for r in found.rows] == ["", "", str(REFUSED)]
    assert found.notes == []
    assert found.cost.frames == 2 + 1 + 2
    assert compare([(PaperDrive(a=1, b=2, c=3), the_set(a=1, b=2, c=7))])[0].cost.frames == 3 + 1 + 2
    assert found.answer_s == pytest.approx(0.00088)
    assert not found.same
    assert done_s == [(1, 3), (2, 3), (3, 3)]
    assert compare([(drive, the_set(a=1))])[0].same
    assert not compare([(drive, the_set(a=2))])[0].same
    assert not compare([(drive, the_set(z=2))])[0].same
    other = replace(the_set(a=1), identity=replace(IDENTITY, version={"firmware": "1"}))
    assert not compare([(drive, other)])[0].same
    assert compare([(drive, other)], any_version=True)[0].same


@pytest.mark.parametrize(("took_ms", "answer_s"), [((1, 2, 9, 4, 3), 0.00388), ((5, 1, 2), 0.00288), ((), 0.0)])
def test_the_drives_own_time_is_the_median_of_its_answers(took_ms: tuple[int, ...], answer_s: float) -> None:
    """One more than in the list, as an access takes a millisecond by itself, less 0.12 ms on the bus; of no answer none."""
    drive, left = PaperDrive(**{f"p{number}": 1 for number in range(len(took_ms) or 1)}), list(took_ms)

    def answers(_address: str) -> None:
        if not took_ms:
            raise REFUSED
        drive.clock.sleep_s(1e-3 * left.pop())

    drive.on_read = answers
    (found,) = compare([(drive, the_set(**dict.fromkeys(drive.held, 1)))])
    assert found.answer_s == pytest.approx(answer_s)


class Bytewise(PaperDrive):
    """Shows bytes."""

    def decode(self, entry: RawParameter, data: bytes) -> ParameterValue:
        return data if entry.address == "b" else super().decode(entry, data)


def test_a_comparison_as_json() -> None:
    (found,) = compare([(Bytewise(a=1, b=2), the_set(a=1, b=0x0A0B))])
    form = json.loads(json.dumps(found.as_json()))
    assert [(one["held"], one["wanted"], one["side"]) for one in form["parameters"]] == [
        (1, 1, "same"),
        ("0200", "0b0a", "differs"),
    ]


def test_a_backup_is_of_what_may_be_written_unless_all_is_asked_for() -> None:
    drive = PaperDrive(a=1, b=2, c=3)
    drive.refusals["b"] = "read only"
    drive.on_read = fails_once(REFUSED, "a")
    done_s: list[tuple[int, int]] = []
    kept = back_up([drive], progress=lambda *told: done_s.append(told[2:]))[0]
    assert kept.contents is not None
    assert kept.contents.addresses == ("c",)
    assert list(kept.unreadable or {}) == ["a"]
    assert done_s == [(1, 2), (2, 2)]
    assert kept.contents.hash == kept.contents.digest()
    every = back_up([drive], everything=True)[0].contents
    assert every is not None
    assert [(e.address, e.value, e.raw, e.unit, e.name) for e in every.entries][1] == ("b", 2, 2, "rpm", "name of b")
    drive.on_read = fails_once(NoAnswerError("silence"), "c")
    silent = back_up([drive])[0]
    assert (silent.contents, silent.error) == (None, "silence")
    three = PaperDrive(a=1, b=2, c=3)
    for at in ("b", "c"):  # what comes after a silence is not tried
        three.on_read = fails_once(NoAnswerError("silence"), at)
        assert back_up([three])[0].contents is None
    drive.on_read = lambda _address: setattr(drive, "starts", drive.starts + 1)
    assert "restarted" in back_up([drive])[0].error
