"""The same over Modbus: a fault at every request of a 40-parameter download, and the time it takes as predicted.

Servers that nobody here wrote are met in test_modbus_interop.py.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import pytest
from support.modbus_parameters import COUNT, NEW, OLD, Fault, FaultyLine, FortyFace, connect, write_map
from support.parameter_faults import KilledError

from drivers.errors import AbortError, NoAnswerError
from drivers.modbus.register_map import find_map
from drivers.modbus.wear import WearLedger
from drivers.modbus.wire import Request
from drivers.raw_parameters import Pause, Steps
from hil.parameters.download import download
from hil.parameters.journal import Journal
from hil.parameters.preflight import match_set, predict
from hil.parameters.recover import recover
from hil.parameters.report import Ending, ParameterVerdict
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.snapshot import back_up
from hil.parameters.transaction import Target
from sim_backends.clock import SimClock

EVERY = 7  # request; 1 for all of them
OUTAGE_S = 60.0
KINDS = (
    *("lost request", "lost reply", "abort", "wrong value read", "node reboot", "process killed"),
    *("cable pulled", "cable pulled for a moment", "power cut", "power cut for a moment"),
)
SIDES = {"old": [entry.raw for entry in OLD.entries], "new": [entry.raw for entry in NEW.entries]}


@pytest.fixture(scope="module")
def forty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_map(tmp_path_factory.mktemp("map"))


def _side(values: list[int]) -> str:
    return next((name for name, side in SIDES.items() if values == side), "neither")


def one_run(forty: Path, folder: Path, fault: Fault, *, forward: bool = True) -> tuple[str, bool, int]:
    """(what was said at last, whether that is what the drive holds entirely, exchanges of the download)."""
    face, clock, journal = FortyFace(), SimClock(), Journal(folder)
    line = FaultyLine(face, clock, fault)
    said, stored = None, False
    try:
        report = download([Target(connect(forty, line), NEW, journal)], store=True)[0]
        said, stored = report.ending, report.stored
    except KilledError:
        pass
    exchanges = line.exchanges
    if journal.unfinished() is not None:
        clock.sleep_s(OUTAGE_S)
        again = connect(forty, FaultyLine(face, clock, Fault()))
        report = recover([(again, journal)], forward=forward)[0]
        said, stored = report.ending, report.stored or stored
    held, kept = _side(face.ram), _side(face.flash)
    if said in (Ending.WRITTEN, Ending.UNCHANGED):
        whole = held == "new" and (not stored or kept == "new")
    elif said in (Ending.PUT_BACK, Ending.REFUSED):
        whole = (held, kept) == ("old", "old")
    else:
        whole = said is None and held in SIDES and kept in SIDES
    return said.name if said is not None else "nothing to finish", whole, exchanges


@pytest.mark.parametrize("kind", KINDS)
def test_every_request(kind: str, forty: Path, tmp_path: Path) -> None:
    _, whole, exchanges = one_run(forty, tmp_path / "clean", Fault())
    assert whole
    lasting = 0.2 if kind.endswith("moment") else OUTAGE_S / 2
    said: Counter[str] = Counter()
    requests = range(1 + KINDS.index(kind) % EVERY, exchanges + 1, EVERY)
    for at in requests:
        for forward in (True, False):
            fault = Fault(kind.removesuffix(" for a moment"), at, lasting)
            ending, whole, _ = one_run(forty, tmp_path / f"{at}-{forward}", fault, forward=forward)
            assert whole, (kind, at, forward, ending)
            said[ending] += 1
    print(kind, sum(said.values()), dict(said))
    assert sum(said.values()) == 2 * len(requests)


def test_a_drive_that_is_cut_off_at_any_request_of_a_backup_has_none(forty: Path) -> None:
    """Requests go by table and address, so that the last one answered is not the last one of the map."""
    undisturbed = FaultyLine(FortyFace(), SimClock(), Fault())
    assert back_up([connect(forty, undisturbed)])[0].contents is not None
    for at in range(1, undisturbed.exchanges + 1):
        backup = back_up([connect(forty, FaultyLine(FortyFace(), SimClock(), Fault("cable pulled", at, 1e6)))])[0]
        assert (backup.contents, backup.error) == (None, "no answer"), at


def test_time_on_the_line_is_as_predicted(forty: Path, tmp_path: Path) -> None:
    line = FaultyLine(FortyFace(), SimClock(), Fault())
    drive = connect(forty, line)
    wanted, _ = match_set(drive, NEW)
    predicted = predict(drive, wanted).whole
    seconds = predicted.seconds + predicted.answers * line.turnaround_s
    start_ns = line.clock.now_ns()
    report = download([Target(drive, NEW, Journal(tmp_path))])[0]
    took_s = (line.clock.now_ns() - start_ns) * 1e-9
    assert report.ending is Ending.WRITTEN
    print(
        f"{line.exchanges} requests, predicted {predicted.answers}; {1e3 * took_s:.1f} ms, predicted {1e3 * seconds:.1f}"
    )
    assert 1 / 1.1 <= took_s / seconds <= 1.1
    assert line.exchanges <= predicted.answers + 2  # state, and the command to store is not among them


def test_a_refused_neighbour_is_named(forty: Path, tmp_path: Path) -> None:
    """Five neighbours go in one request; the drive refuses it for one of them."""
    line = FaultyLine(FortyFace(), SimClock(), Fault())
    drive = connect(forty, line)
    honest = line.exchange

    refused = drive.map.registers["p7"].span.start

    def exchange(unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        if request.function.is_write and request.address <= refused < request.address + request.count:
            raise AbortError("illegal data value", 3)
        return honest(unit, request, within_s)

    line.exchange = exchange  # type: ignore[method-assign]
    report = download([Target(drive, NEW, Journal(tmp_path))])[0]
    assert report.ending is Ending.PUT_BACK
    assert _side(line.face.ram) == "old"
    assert {row.verdict for row in report.rows} == {ParameterVerdict.PUT_BACK}


def test_what_is_refused_before_anything_is_written(forty: Path, tmp_path: Path) -> None:
    line = FaultyLine(FortyFace(), SimClock(), Fault())
    drive = connect(forty, line)
    entries = [
        SetEntry("target", 5),
        SetEntry("go", 1),
        SetEntry("on", 1),
        SetEntry("position", 1),
        SetEntry("p0", 70_000),
    ]
    report = download([Target(drive, ParameterSet("x", None, (*NEW.entries[1:], *entries)), Journal(tmp_path))])[0]
    assert report.ending is Ending.REFUSED
    assert {objection.address for objection in report.objections} >= {"go", "on", "position", "p0", "target"}
    assert _side(line.face.ram) == "old"


def test_a_worn_eeprom_is_spared(tmp_path: Path) -> None:
    """A register whose budget is used up is refused before the others are written."""
    path = write_map(tmp_path)
    text = path.read_text(encoding="utf-8").replace(
        "[registers.p3]\n", '[registers.p3]\nmemory = "eeprom"\nwear_budget = 3\n'
    )
    path.write_text(text, encoding="utf-8")
    line = FaultyLine(FortyFace(), SimClock(), Fault())
    drive = connect(path, line)
    drive.wear = WearLedger()
    endings = [download([Target(drive, each, Journal(tmp_path / "j"))])[0].ending for each in (NEW, OLD, NEW)]
    assert endings == [Ending.WRITTEN, Ending.WRITTEN, Ending.REFUSED]


def test_a_backup_of_a_modbus_drive(forty: Path) -> None:
    drive = connect(forty, FaultyLine(FortyFace(), SimClock(), Fault()))
    backup = back_up([drive])[0].contents
    assert backup is not None
    assert {entry.address: entry.raw for entry in backup.entries if entry.address.startswith("p")} == {
        entry.address: entry.raw for entry in OLD.entries
    }
    assert len(backup.entries) >= COUNT


def test_a_pause_of_one_drive_is_the_others_time(forty: Path) -> None:
    line = FaultyLine(FortyFace(), SimClock(), Fault())
    drive, clock = connect(forty, line), line.clock

    def after(pauses_s: tuple[float, ...]) -> Steps[float]:
        for pause_s in pauses_s:
            yield Pause(pause_s)
        yield from drive.read([NEW.entries[0].address])
        if not pauses_s:
            raise NoAnswerError("at the end")
        return clock.now_ns() * 1e-9

    slow, failing, quick = drive.line.run([after((1.0, 4.0)), after(()), after((0.5,))])
    assert slow == pytest.approx(5.0, abs=0.05)
    assert isinstance(failing, NoAnswerError)
    assert quick == pytest.approx(0.5, abs=0.05)
    assert clock.now_ns() * 1e-9 == slow


@pytest.mark.parametrize(("value", "why"), [(300.04, "above its limit 300"), (-0.04, "below its limit 0")])
def test_a_value_of_a_set_is_not_rounded_into_the_limits(value: float, why: str) -> None:
    clock = SimClock()
    drive = connect(find_map("vendor_style"), FaultyLine(FortyFace(), clock, Fault()))
    entry = SetEntry("torque_limit", value)
    wanted, objections = match_set(drive, ParameterSet(drive.name, identity=None, entries=(entry,)))
    assert not wanted
    assert [str(each) for each in objections if f"{why}, allowed is 0 to 300 percent" in each.why]
