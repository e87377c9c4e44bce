"""A drive's parameters as the screen's jobs, on a Modbus server of this process: no browser, no desk's thread."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from support import bench_axis
from support.bench_axis import AXIS
from support.modbus_parameters import COUNT, NEW, OLD, FortyFace, write_map

from drivers.canopen.bus import CanLink
from drivers.canopen.node import Node
from drivers.clock import WallClock
from drivers.errors import CapabilityError, InputError, StateError
from drivers.raw_parameters import DriveIdentity
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.desk.job import Job, Workplace
from hil.desk.progress import Phase, Progress
from hil.desk.stop import StoppedByOperator
from hil.machine.axis_lock import held_axis
from hil.machine.events import Event
from hil.parameters import job as parameters
from hil.parameters.compare import Comparison
from hil.parameters.job import set_files
from hil.parameters.listing import ListedParameter, Listing, changed
from hil.parameters.outcome import BackedUp, kept_outcome
from hil.parameters.report import Ending, JobReport
from hil.parameters.set_file import ParameterSet, SetEntry, read_set
from hil.parameters.snapshot import back_up
from hil.parameters.wiring import connected_parameters, unconnected_parameters
from sim_backends.canopen_drive import EDS
from sim_backends.modbus_drive import tcp_server

SIDES = {"old": [entry.raw for entry in OLD.entries], "new": [entry.raw for entry in NEW.entries]}


@dataclass
class Operator:
    """Hears a job, and presses the stop once, at an event of this stage."""

    stops_at: str = ""
    heard: list[Event] = field(default_factory=list)

    def hears(self, event: Event) -> None:
        self.heard.append(event)

    def real(self, _duration_s: float) -> None:
        if self.stops_at and self.heard and self.heard[-1].stage == self.stops_at:
            self.stops_at = ""
            raise StoppedByOperator

    def simulated(self, _now_ns: int) -> None: ...

    def runs(self, axis: DriveAxis, job: Job) -> object:
        def told(_text: str) -> None: ...

        def watched(*_who: object) -> None: ...

        return job.work(Workplace(axis, None, None, self.hears, told, None, self, watched))


@pytest.fixture
def face() -> FortyFace:
    return FortyFace()


@pytest.fixture
def axis(face: FortyFace, tmp_path: Path) -> Iterator[DriveAxis]:
    write_map(tmp_path)
    with tcp_server({7: face}, WallClock()) as (_, port):
        path = tmp_path / "X.toml"
        path.write_text(
            f'{AXIS}\n[drive]\nbackend = "modbus"\nregister_map = "forty.toml"\nurl = "tcp://127.0.0.1:{port}"\nunit = 7\n'
        )
        yield load_drive_axis(path)


def report(result: object) -> JobReport:
    assert isinstance(result, JobReport)
    return result


def test_from_a_backup_to_stored_and_back(axis: DriveAxis, face: FortyFace) -> None:
    operator = Operator()
    backup = parameters.backup_job(axis)
    assert (backup.plan.locked, backup.connects, backup.plan.moves) == (False, True, ())
    kept = operator.runs(axis, backup)
    assert isinstance(kept, BackedUp)
    assert backup.plan.writes[0].place == str(kept.path)
    assert len(read_set(kept.path).entries) == kept.parameters == COUNT
    assert kept.unreadable == 2  # its commands' registers, which show nothing
    assert set_files(axis) == (kept.path,)  # and neither the axis file nor the register map, which are TOML too

    found = operator.runs(axis, parameters.compare_job(axis, NEW))
    assert isinstance(found, Comparison)
    assert (len(found.rows), found.same, face.ram) == (COUNT, False, SIDES["old"])

    download = parameters.download_job(axis, NEW)
    assert download.plan.locked
    operator.heard.clear()
    assert report(operator.runs(axis, download)).ending is Ending.WRITTEN
    assert (face.ram, face.flash) == (SIDES["new"], SIDES["old"])
    done = [(event.done, event.total) for event in operator.heard if event.stage == "write"]
    assert done == sorted(done)
    assert done[-1] == (2 * COUNT, 2 * COUNT)

    with pytest.raises(StateError, match="does not hold this set"):
        operator.runs(axis, parameters.store_job(axis, OLD))
    assert face.stores == 0
    assert report(operator.runs(axis, parameters.store_job(axis, NEW))).stored
    assert (face.stores, face.flash) == (1, SIDES["new"])
    before = operator.runs(axis, parameters.restore_job(axis))  # the download, not the storing that changed nothing
    assert (report(before).ending, face.ram) == (Ending.WRITTEN, SIDES["old"])


def listed(axis: DriveAxis) -> dict[str, ListedParameter]:
    """The list as the screen's job reads it, by address."""
    listing = Operator().runs(axis, parameters.read_job(axis))
    assert isinstance(listing, Listing)
    return {one.entry.address: one for one in listing.parameters}


def test_the_list_names_all_that_the_drive_shows_and_what_may_be_changed(axis: DriveAxis, face: FortyFace) -> None:
    found = listed(axis)
    assert [found[f"p{number}"].value for number in range(COUNT)] == [str(raw) for raw in SIDES["old"]]
    may = [address for address, one in found.items() if not one.refusal]
    assert set(may) == {"speed", "ramp", *(f"p{number}" for number in range(COUNT))}
    assert found["position"].refusal == "is read only"
    assert found["go"].refusal.startswith("is a command")
    unread = {address for address, one in found.items() if one.error and not one.refusal}
    assert unread == {"speed", "ramp"}  # those that a backup does not hold
    assert {found[address].value for address in unread} == {"–"}
    assert [address for address, one in found.items() if one.has("P1 ")] == [
        address for address in found if "p1" in address
    ]
    assert face.ram == SIDES["old"]


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_a_typed_value_goes_to_the_drive_as_a_set_of_one_and_comes_back(
    number: int, axis: DriveAxis, face: FortyFace
) -> None:
    """u16, i16, u32, i32. Nothing else is written; it can be taken back as any download."""
    operator, address, old = Operator(), f"p{number}", SIDES["old"]
    listing = operator.runs(axis, parameters.read_job(axis))
    assert isinstance(listing, Listing)
    one = next(each for each in listing.parameters if each.entry.address == address)
    wanted = changed(listing, one, f" {SIDES['new'][number]} ")
    assert (wanted.addresses, wanted.identity) == ((address,), listing.identity)
    assert report(operator.runs(axis, parameters.download_job(axis, wanted))).ending is Ending.WRITTEN
    assert face.ram == [*old[:number], SIDES["new"][number], *old[number + 1 :]]
    assert report(operator.runs(axis, parameters.restore_job(axis))).ending is Ending.WRITTEN
    assert face.ram == old


@pytest.mark.parametrize(
    ("address", "typed", "why"),
    [
        ("position", "1", "is read only"),
        ("go", "1", "is a command"),
        ("p0", "much", "is to be 'much', expected a whole number"),
        ("p0", "1,5", "is to be '1,5', expected a whole number"),
        ("p0", "0.5", "is to be '0.5', expected a whole number"),
    ],
)
def test_what_is_no_value_or_no_parameter_is_refused_before_the_drive_is_asked(
    address: str, typed: str, why: str, axis: DriveAxis
) -> None:
    listing = Operator().runs(axis, parameters.read_job(axis))
    assert isinstance(listing, Listing)
    one = next(each for each in listing.parameters if each.entry.address == address)
    with pytest.raises(InputError, match=rf"^{address}.*{why}"):
        changed(listing, one, typed)


def test_a_set_of_another_version_is_refused_and_the_outcome_is_kept(axis: DriveAxis, face: FortyFace) -> None:
    """The screen offers no way to allow one."""
    operator = Operator()
    other = replace(NEW, identity=DriveIdentity("modbus", {}, {"firmware": "another"}), hash=None)
    compare = parameters.compare_job(axis, other)
    assert not compare.plan.locked
    found = operator.runs(axis, compare)
    assert isinstance(found, Comparison)
    assert ["firmware 'another'" in each.why for each in found.objections] == [True]
    assert report(operator.runs(axis, parameters.download_job(axis, other))).ending is Ending.REFUSED
    assert face.ram == SIDES["old"]
    kept = kept_outcome(axis)
    assert kept is not None
    assert kept.outcome == "refused"


def test_a_stop_in_the_middle_of_writing_puts_everything_back(axis: DriveAxis, face: FortyFace) -> None:
    with pytest.raises(StoppedByOperator):
        Operator("write").runs(axis, parameters.download_job(axis, NEW))
    assert face.ram == SIDES["old"]
    assert parameters.unfinished(axis) is None


@pytest.mark.parametrize(("forward", "side"), [(True, "new"), (False, "old")])
def test_what_was_cut_off_is_finished_or_taken_back(axis: DriveAxis, face: FortyFace, forward: bool, side: str) -> None:
    """Cut off when all is written and the drive has been told to keep it: nobody knows whether it did."""
    operator = Operator("store")

    def progress(stage: str, drive: str, done: int, total: int) -> None:
        operator.hears(Event(stage, drive, done, total))
        operator.real(0.0)

    with pytest.raises(StoppedByOperator):
        parameters.write_axes([axis], [NEW], store=True, progress=progress)
    cut_off = parameters.unfinished(axis)
    assert cut_off is not None
    assert cut_off.set_name == NEW.name
    with pytest.raises(InputError, match="is not finished"):
        Operator().runs(axis, parameters.download_job(axis, OLD))
    job = parameters.recover_job(axis, forward=forward)
    assert job.plan.locked
    assert job.kind == ("parameters resume" if forward else "parameters rollback")
    assert [write.what for write in job.plan.writes] == ["parameters" if forward else "parameters_back"]
    assert report(Operator().runs(axis, job)).good
    assert (face.ram, parameters.unfinished(axis)) == (SIDES[side], None)
    with pytest.raises(StateError, match="nothing to do"):
        parameters.recover_job(axis, forward=forward)


def test_what_the_screen_says_of_each_outcome(axis: DriveAxis) -> None:
    from hil.parameters.page_data import parameters_screen  # noqa: PLC0415

    class Last:
        """A desk whose only job is this one."""

        def __init__(self, job: Job, result: object) -> None:
            self.job, self.progress = job, Progress(1, job.kind, job.plan, Phase.DONE, result=result)

        def last(self, kind: str) -> Progress | None:
            return self.progress if kind == self.job.kind else None

        def last_of(self, kinds: Iterable[str]) -> Progress | None:
            return next(filter(None, map(self.last, kinds)), None)

    def shown(job: Job) -> tuple[str, int | None, int | None, int]:
        screen = parameters_screen(Last(job, Operator().runs(axis, job)))  # type: ignore[arg-type]
        return screen.outcome, screen.same, screen.differing, len(screen.rows)

    foreign = ParameterSet("foreign", None, (*NEW.entries, SetEntry("nothing", 1)))
    assert shown(parameters.compare_job(axis, NEW)) == ("differs", 0, COUNT, COUNT)
    assert shown(parameters.compare_job(axis, foreign)) == ("unfit", 0, COUNT, COUNT + 1)
    assert shown(parameters.download_job(axis, foreign))[0] == "refused"
    assert shown(parameters.download_job(axis, NEW)) == ("written", COUNT, 0, COUNT)
    assert shown(parameters.download_job(axis, NEW)) == ("unchanged", COUNT, 0, 0)
    assert shown(parameters.compare_job(axis, NEW, parameters.VERIFY)) == ("holds", COUNT, 0, 0)
    assert shown(parameters.store_job(axis, NEW))[0] == "stored"


def test_a_drive_without_parameters_on_a_wire_is_refused(tmp_path: Path) -> None:
    path = bench_axis.lay_out(tmp_path)
    path.write_text(path.read_text().replace('backend = "bench"', 'backend = "bench"\nface = "virtual"'))
    bench = load_drive_axis(path)
    with pytest.raises(CapabilityError, match=r"its drive \(bench\) has no parameters"), connected_parameters([bench]):
        pass


def test_the_benchs_own_drive_answers(tmp_path: Path) -> None:
    with connected_parameters([load_drive_axis(bench_axis.lay_out(tmp_path))]) as (drive,):
        (backup,) = back_up([drive])
    assert (backup.error, drive.name) == ("", "X")
    assert backup.contents is not None
    assert "6065h:00" in backup.contents.addresses


STEP = "\n[2313]\nParameterName=Step\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\nDefaultValue=0\n"


def on_can(folder: Path, *lines: str, name: str = "X", bus: tuple[str, str] = ("virtual", "nobody")) -> DriveAxis:
    """An axis whose drive is on a bus that nothing else is on, as node 5, and Y's as node 6."""
    path = folder / f"{name}.toml"
    place = (
        f'[drive]\nbackend = "canopen"\ninterface = "{bus[0]}"\nchannel = "{bus[1]}"\nnode_id = {5 + (name == "Y")}\n'
    )
    path.write_text("\n".join([AXIS.replace('"X"', f'"{name}"') + place, *lines, ""]))
    return load_drive_axis(path)


@pytest.mark.parametrize(("lines", "refused"), [((), False), (('correction_table = "simulated_array"',), True)])
def test_the_objects_of_a_drives_correction_table_are_no_parameters(
    tmp_path: Path, lines: tuple[str, ...], refused: bool
) -> None:
    eds = tmp_path / "maker.eds"
    eds.write_text(EDS.read_text(encoding="utf-8") + STEP, encoding="utf-8")
    with unconnected_parameters([on_can(tmp_path, f'eds = "{eds}"', *lines)]) as (found,):
        step = found.find("2313h:00")
        assert step is not None
        assert (step.refusal is not None) is refused


def test_without_a_wire_no_adapter_is_opened_and_drives_on_one_bus_share_their_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[str] = []
    monkeypatch.setattr(Node, "close", lambda node: closed.append(node.name))
    places = {"X": "nobody0", "Y": "nobody0", "Z": "nobody1"}
    axes = [on_can(tmp_path, name=name, bus=("socketcan", channel)) for name, channel in places.items()]
    with unconnected_parameters(axes) as (first, second, other):
        assert (first.name, second.name, other.name) == ("X", "Y", "Z")
        assert first.line is second.line is not other.line
        assert closed == []
    assert closed == ["Z", "Y", "X"]


@pytest.mark.parametrize("interface", ["socketcan", "virtual"])
def test_the_adapter_is_opened_with_the_bit_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, interface: str
) -> None:
    opened: list[object] = []
    virtual = CanLink.open

    def opens(clock: WallClock, **how: object) -> CanLink:
        opened.append((how["interface"], how["channel"], how["bitrate"]))
        return virtual(clock, interface="virtual", channel=tmp_path.name)

    monkeypatch.setattr(CanLink, "open", opens)
    axes = [on_can(tmp_path, "bitrate = 250_000", name=name, bus=(interface, "nobody")) for name in ("X", "Y")]
    with connected_parameters(axes) as (first, second):
        assert first.line is second.line
    assert opened == [(interface, "nobody", 250_000)]


def test_an_axis_in_use_is_not_connected(tmp_path: Path) -> None:
    axis = on_can(tmp_path)
    with held_axis(axis), pytest.raises(InputError, match="in use"), connected_parameters([axis]):
        pass
