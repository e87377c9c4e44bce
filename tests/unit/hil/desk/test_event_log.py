"""The log of events: what is kept on disk, which alarms stand, and what a desk writes into it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from support.bench_axis import lay_out

from drivers.errors import LinkLostError
from hil.axis.axis_file import load_axis
from hil.desk import event_log
from hil.desk.desk import Desk
from hil.desk.event_log import EventLog, LogKind
from hil.desk.job import Job, Workplace
from hil.desk.plan import Plan

Until = Callable[[Callable[[], bool], str], None]


def test_an_alarm_stands_until_it_is_acknowledged_over_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "a" / "events.jsonl"
    log = EventLog(path, "X")
    log.add(LogKind.JOB, "started", who="Browser 1", job="calibrate")
    alarm = log.add(LogKind.ALARM, "failed", cause="no answer", remedy="link", job="calibrate")
    again = EventLog(path, "X")
    assert again.alarms() == (alarm,)
    again.acknowledge(alarm.number, "Browser 2")
    again.acknowledge(alarm.number, "Browser 2")
    for one in (again, EventLog(path, "X")):
        assert one.alarms() == ()
        assert [(entry.what, entry.who) for entry in one.entries()] == [
            ("acknowledged", "Browser 2"),
            ("failed", ""),
            ("started", "Browser 1"),
        ]


def test_a_torn_line_and_a_full_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "events.jsonl"
    EventLog(path, "X").add(LogKind.STOP, "stop")
    with path.open("ab") as file:
        file.write(b'{"number": 2, "wh')
    assert [one.what for one in EventLog(path, "X").entries()] == ["stop"]
    monkeypatch.setattr(event_log, "MOST_BYTES", path.stat().st_size + 10)
    log = EventLog(path, "X")
    log.add(LogKind.STOP, "stop")
    assert path.with_name("events.jsonl.1").exists()
    assert len(log.entries()) == 2


def test_alarms_that_stand_outlast_full_files_and_a_restart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "events.jsonl"
    monkeypatch.setattr(event_log, "MOST_BYTES", 3000)
    log = EventLog(path, "X")
    first = log.add(LogKind.ALARM, "fault", cause="short circuit")
    gone = log.add(LogKind.ALARM, "fault", cause="too warm")
    log.acknowledge(gone.number, "Ann")
    for _ in range(60):  # four files
        log.add(LogKind.STOP, "stop")
    assert path.stat().st_size <= 3000
    assert EventLog(path, "X").alarms() == log.alarms() == (first,)
    assert EventLog(path, "X").number == log.number


def test_not_more_alarms_stand_than_are_shown(tmp_path: Path) -> None:
    log = EventLog(tmp_path / "events.jsonl", "X")
    alarms = [log.add(LogKind.ALARM, "fault") for _ in range(event_log.KEPT + 1)]
    assert log.alarms() == tuple(reversed(alarms[1:]))


def test_a_disk_that_cannot_be_written_loses_nothing_shown(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    log = EventLog(tmp_path / "file" / "events.jsonl", "X")
    log.add(LogKind.STOP, "stop")
    assert [one.what for one in log.entries()] == ["stop"]
    assert "file/events.jsonl" in log.trouble


def test_a_desk_logs_who_started_and_wrote_what_and_how_it_failed(tmp_path: Path, until: Until) -> None:
    def fail(_place: Workplace) -> object:
        raise LinkLostError("node 1 does not answer")

    with Desk(load_axis(lay_out(tmp_path)), pace=0.0) as desk:
        until(lambda: desk.live.connected, "the axis is looked at")
        token, ends = desk.control.take("Browser 7"), {"done", "failed"}
        for work in (lambda _place: None, fail):
            desk.run(token, Job("test", Plan("X", "bench"), work), changes=["2201h: 0 → 5"])
            until(lambda: desk.events.entries()[0].what in ends and not desk.job().running, "its end is logged")  # type: ignore[union-attr]
        (alarm,) = desk.events.alarms()
        assert (alarm.cause, alarm.remedy, alarm.figures["job"]) == ("node 1 does not answer", "link", "test")
        told = [(one.kind, one.what, one.who) for one in reversed(desk.events.entries())]
        assert told == [
            (LogKind.JOB, "started", "Browser 7"),
            (LogKind.WRITE, "wrote", "Browser 7"),
            (LogKind.JOB, "done", "Browser 7"),
            (LogKind.JOB, "started", "Browser 7"),
            (LogKind.ALARM, "failed", "Browser 7"),
        ]


def test_a_name_with_a_foreign_line_end_is_found_again(tmp_path: Path) -> None:
    EventLog(tmp_path / "events.jsonl", "X").add(LogKind.CONTROL, "taken", who="a\u2028b\x85c")
    assert [entry.who for entry in EventLog(tmp_path / "events.jsonl", "X").entries()] == ["a\u2028b\x85c"]
