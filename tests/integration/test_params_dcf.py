"""DCF and concise DCF as commissioning tools write them: what is no parameter is left out and listed, PDOs are written as a whole."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.bench_axis import AXIS
from support.parameter_rigs import ParameterRig

from drivers.canopen.dcf import pack_concise, unpack_concise
from drivers.canopen.eds import load_eds
from drivers.canopen.pdo import pdo_of
from drivers.canopen.whole_pdo import PdoImage
from drivers.clock import WallClock
from drivers.errors import InputError
from hil.app.main import main
from hil.axis.axis_file import load_drive_axis
from hil.machine.canopen_wiring import canopen_drive
from hil.parameters.compare import compare
from hil.parameters.download import download
from hil.parameters.formats import read_any, write_any
from hil.parameters.job import load_set
from hil.parameters.preflight import match_set, predict
from hil.parameters.recover import set_before
from hil.parameters.report import Ending, JobReport
from hil.parameters.set_file import ParameterSet, read_set, write_set
from hil.parameters.snapshot import back_up
from hil.parameters.transaction import Target
from sim_backends.canopen_drive import EDS
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind

DATA = Path(os.environ.get("HIL_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data")) / "eds"
CONFIGURED = re.compile(rb"(?im)^\s*parametervalue\s*=\s*\S")
DCFS = sorted(
    path for path in DATA.glob("*.dcf") if CONFIGURED.search(path.read_bytes()) and "full_features" not in path.name
)
"""Those that configure something; the values of full_features.dcf are all of objects that are read only."""
Writes = list[tuple[int, int, int]]

COMMANDS = """
[40C5]
ParameterName=P-PRESET execution
ObjectType=0x7
DataType=0x0005
AccessType=rww
DefaultValue=0
[40C0]
ParameterName=Alarm reset
ObjectType=0x7
DataType=0x0005
AccessType=rww
DefaultValue=0
[40C1]
ParameterName=Save it
ObjectType=0x7
DataType=0x0005
AccessType=wo
[40F0]
ParameterName=Preset mode
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=0
"""


@pytest.fixture
def maker(tmp_path: Path) -> Path:
    """The simulated drive's EDS with a maker's commands among its parameters."""
    path = tmp_path / "maker.eds"
    path.write_text(EDS.read_text(encoding="utf-8") + COMMANDS, encoding="utf-8")
    return path


@pytest.fixture
def rig(maker: Path, tmp_path: Path) -> Iterator[ParameterRig]:
    rig = ParameterRig(maker, tmp_path, bitrate=None)
    with rig.stack:
        yield rig


def writes_of(rig: ParameterRig) -> Writes:
    """Every write that the drive receives from now on: (index, sub-index, number)."""
    seen: Writes = []
    dictionary = rig.bench.slave.dictionary
    take = dictionary.write

    def write(index: int, subindex: int, data: bytes) -> None:
        seen.append((index, subindex, int.from_bytes(data, "little")))
        take(index, subindex, data)

    dictionary.write = write  # type: ignore[method-assign]
    return seen


def load(rig: ParameterRig, contents: ParameterSet, **options: object) -> JobReport:
    return download([Target(rig.drives[0], contents, rig.journals[0], **options)])[0]  # type: ignore[arg-type]


def u8(value: int) -> bytes:
    return value.to_bytes(1, "little")


def u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


LELY = [
    # as Lely's dcfgen writes RPDO 3: disabled, emptied, filled, counted, enabled
    ((0x1402, 1), u32(0x80000405)),
    ((0x1402, 2), u8(1)),
    ((0x1602, 0), u8(0)),
    ((0x1602, 1), u32(0x60FF0020)),
    ((0x1602, 2), u32(0x60400010)),
    ((0x1602, 0), u8(2)),
    ((0x1402, 1), u32(0x405)),
    ((0x605A, 0), (6).to_bytes(2, "little")),
    ((0x605A, 0), (1).to_bytes(2, "little")),
    ((0x40C5, 0), u8(1)),
]


def concise(folder: Path, objects: list[tuple[tuple[int, int], bytes]]) -> Path:
    path = folder / "lely.cdcf"
    path.write_bytes(pack_concise(objects))
    return path


def axis_file(folder: Path, eds: Path, node_id: int) -> Path:
    path = folder / "X.toml"
    path.write_text(
        f'{AXIS}\n[drive]\nbackend = "canopen"\ninterface = "virtual"\nchannel = "nobody"\nnode_id = {node_id}\n'
        f'eds = "{eds}"\n'
    )
    return path


@pytest.mark.skipif(not DCFS, reason="no DCF files: set HIL_SHARED_DATA or put ../shared/data beside the project")
@pytest.mark.outside  # a corpus
def test_all_published_device_dcfs_pass_a_dry_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is looked at and what is left out are together all that the file configures; each PDO counts as one parameter."""
    together = {"looked": 0, "left": 0}
    for path in DCFS:
        dcf = load_eds(path)
        configured = [key for key, found in dcf.entries.items() if found.value is not None and found.writable]
        node = dcf.node_id or 1
        status = main(["params", "download", str(axis_file(tmp_path, path, node)), "--set", str(path), "--dry-run"])
        out, _ = capsys.readouterr()
        assert status == 0, (path.name, out)
        assert "would be refused" not in out
        looked = int(re.search(r"would read (\d+) parameters", out)[1])  # type: ignore[index]
        listed = [line for line in out.splitlines() if "left out are" in line]
        assert len(listed) <= 1
        left = sum(map(int, re.findall(r": (\d+) \(", "".join(listed))))
        in_pdos = [key for key in configured if pdo_of(key[0]) is not None and (key[0] & 0x200 or key[1])]
        wholes = {pdo_of(index) for index, _ in in_pdos}
        assert looked - len(wholes) + left + len(in_pdos) == len(configured), path.name
        together["looked"] += looked
        together["left"] += left
    assert len(DCFS) == 32
    assert together["looked"] > 3000
    assert together["left"] > 200


def test_a_concise_dcf_with_repeats_is_written_in_the_order_of_the_standard(rig: ParameterRig, tmp_path: Path) -> None:
    contents = read_any(concise(tmp_path, LELY))
    before = rig.bench.slave.dictionary.number(0x1402, 1)
    seen = writes_of(rig)
    report = load(rig, contents)
    assert (report.ending, report.objections) == (Ending.WRITTEN, ())
    assert report.notes == ("left out are commands: 1 (40C5h:00)",)
    of_pdo = [(index, sub, value) for index, sub, value in seen if pdo_of(index) is not None]
    assert of_pdo == [
        *([] if before & 0x80000000 else [(0x1402, 1, before | 0x80000000)]),
        (0x1602, 0, 0),
        (0x1602, 1, 0x60FF0020),
        (0x1602, 2, 0x60400010),
        (0x1602, 0, 2),
        (0x1402, 2, 1),
        (0x1402, 1, 0x405),
    ]
    assert not any(index == 0x40C5 for index, _, _ in seen)
    assert rig.bench.slave.dictionary.number(0x605A) == 1  # the last of the repeated values
    assert load(rig, contents).ending is Ending.UNCHANGED
    (row,) = (row for row in report.rows if row.address == "1402h PDO")
    assert (row.name, str(row.new)) == ("RPDO 3", "405h, type 1, 60FFh:00 6040h:00")
    # the set before is a set of this program: it is kept as a file, compared and written back
    path = tmp_path / "before.toml"
    last = rig.journals[0].last_change()
    assert last is not None
    write_set(path, set_before(last))
    assert load(rig, read_set(path)).ending is Ending.WRITTEN
    assert rig.bench.slave.dictionary.number(0x1402, 1) == before
    assert compare([(rig.drives[0], read_set(path))])[0].same


def test_a_pdo_takes_no_more_frames_than_predicted(maker: Path, tmp_path: Path) -> None:
    rig, contents = ParameterRig(maker, tmp_path), read_any(concise(tmp_path, LELY))
    with rig.stack:
        (drive,), wire = rig.drives, rig.bench.wire
        wanted, _ = match_set(drive, contents)
        looked_at: list[int] = []
        report = download(
            [Target(drive, contents, rig.journals[0])],
            progress=lambda stage, *_: looked_at.append(wire.frames) if stage == "look" else None,
        )[0]
        assert report.ending is Ending.WRITTEN
        taken, most = wire.frames - looked_at[-1], predict(drive, wanted).write.frames
    assert 0.8 * most <= taken <= most


def test_a_pdo_that_is_refused_is_put_back(maker: Path, tmp_path: Path) -> None:
    """605Ah and the first entries are written when the drive refuses an object that cannot be mapped."""
    objects = [each for each in LELY if each[0][0] != 0x40C5]
    objects[4] = ((0x1602, 2), u32(0x10080020))
    rig = ParameterRig(maker, tmp_path, bitrate=None)
    with rig.stack:
        dictionary = rig.bench.slave.dictionary
        held = [dictionary.number(*key) for key in ((0x1402, 1), (0x1402, 2), (0x1602, 0), (0x605A, 0))]
        report = load(rig, read_any(concise(tmp_path, objects)))
        assert (report.ending, "1602h:02" in report.error) == (Ending.PUT_BACK, True), report
        assert [dictionary.number(*key) for key in ((0x1402, 1), (0x1402, 2), (0x1602, 0), (0x605A, 0))] == held


@pytest.mark.parametrize("skip", range(0, 44, 9))
@pytest.mark.parametrize("kind", [CanFaultKind.SDO_LOST, CanFaultKind.SDO_REQUEST_LOST])
def test_a_lost_frame_in_a_pdo_leaves_it_whole(maker: Path, tmp_path: Path, kind: CanFaultKind, skip: int) -> None:
    """An answer that is lost is resolved by reading back; a lost write ends the download, with the PDO as it was found."""
    rig = ParameterRig(maker, tmp_path, bitrate=None, faults=(CanFault(kind, count=1, skip=skip),))
    with rig.stack:
        dictionary = rig.bench.slave.dictionary
        keys = ((0x1402, 1), (0x1402, 2), (0x1602, 0), (0x1602, 1), (0x1602, 2))
        held = [dictionary.number(*key) for key in keys]
        report = load(rig, read_any(concise(tmp_path, LELY)))
        written = report.ending is Ending.WRITTEN
        assert written or (report.ending is Ending.PUT_BACK and kind is CanFaultKind.SDO_REQUEST_LOST), report
        wanted = [0x405, 1, 2, 0x60FF0020, 0x60400010] if written else held
        assert [dictionary.number(*key) for key in keys] == wanted


def test_pdos_are_left_out_on_request(rig: ParameterRig, tmp_path: Path) -> None:
    contents = read_any(concise(tmp_path, LELY), pdos=False)
    seen = writes_of(rig)
    report = load(rig, contents)
    assert report.notes == (
        "left out are PDO parameters: 5 (1402h:02, 1602h:01, 1602h:02, 1602h:00, …); commands: 1 (40C5h:00)",
    )
    assert not any(pdo_of(index) for index, _, _ in seen)


def test_what_cannot_be_a_pdo_is_refused_before_anything_is_written(rig: ParameterRig, tmp_path: Path) -> None:
    for objects, why in (
        ([((0x1602, 0), u8(2)), ((0x1602, 1), u32(0x60400010))], "entry 2 is missing"),
        ([((0x1602, 1), u32(0x607A0040)), ((0x1602, 2), u32(0x60400010))], "maps 80 bits"),
        ([((0x1402, 1), b"\x05\x04")], "1402h:01 has 2 bytes"),
    ):
        seen = writes_of(rig)
        report = load(rig, read_any(concise(tmp_path, objects)))
        assert report.ending is Ending.REFUSED
        assert why in str(report.objections[0])
        assert seen == []


def test_commands_of_makers_are_never_downloaded(rig: ParameterRig, maker: Path, tmp_path: Path) -> None:
    text = maker.read_text(encoding="utf-8")
    for index in ("40C5", "40C0", "40C1", "40F0", "607A", "605A", "1010sub1"):
        text = text.replace(f"[{index}]\n", f"[{index}]\nParameterValue=1\n")
    path = tmp_path / "tool.dcf"
    path.write_text(text, encoding="utf-8")
    seen = writes_of(rig)
    report = load(rig, read_any(path))
    assert report.ending is Ending.WRITTEN
    assert report.notes == ("left out are commands: 4 (1010h:01, 40C0h:00, 40C1h:00, 40C5h:00); targets: 1 (607Ah:00)",)
    assert set(seen) == {(0x40F0, 0, 1), (0x605A, 0, 1)}
    # in a set of this program, which a backup never fills with them, one is an error
    backup = back_up(rig.drives)[0].contents
    assert backup is not None
    assert not {"40C5h:00", "40C0h:00", "40C1h:00"} & set(backup.addresses)
    own = tmp_path / "own.toml"
    own.write_text(
        'format = "hil parameter set 1"\nname = "x"\nparameters = [\n{ index = 0x40C5, value = 1 },\n]\n',
        encoding="utf-8",
    )
    refused = load(rig, read_set(own))
    assert refused.ending is Ending.REFUSED
    assert "P-PRESET execution: is a command by its name" in str(refused.objections[0])


def test_a_makers_file_of_another_vendor_is_named_before_anything_is_written(
    rig: ParameterRig, maker: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.eds"
    text = maker.read_text(encoding="utf-8")
    text = re.sub(r"(?m)^VendorNumber=.*$", "VendorNumber=0xFB", text)
    text = text.replace("DefaultValue=0x000004E1", "DefaultValue=0x000000FB")
    other.write_text(text, encoding="utf-8")
    second = ParameterRig(maker, tmp_path / "second", bitrate=None, file=load_eds(other, 5))
    with second.stack:
        contents = read_any(concise(tmp_path, LELY[-3:]))
        seen = writes_of(second)
        report = load(second, contents)
        why = "the maker's file (eds) is for vendor id 0xfb, this drive reports 0x4e1"
        assert (report.ending, [each.why for each in report.objections]) == (Ending.REFUSED, [why])
        assert seen == []
        assert compare([(second.drives[0], contents)])[0].notes[0] == why
        allowed = load(second, contents, other_eds=True)
        assert (allowed.ending, allowed.notes[0]) == (Ending.WRITTEN, why)
        # the DCF of a backup names the drive's own vendor, not that of the file
        (backup,) = back_up(second.drives)
        assert backup.notes == (why,)
        assert backup.contents is not None
        path = tmp_path / "backup.dcf"
        write_any(path, backup.contents, second.drives[0], None, other)
        written = load_eds(path)
        assert (written.vendor_number, written.entries[0x1018, 1].value) == (0x4E1, 0x4E1)
    assert load(rig, read_any(concise(tmp_path, LELY[-3:]))).objections == ()  # the right file has no objection


def test_what_was_accepted_in_a_makers_file_is_told_by_every_job(maker: Path, tmp_path: Path) -> None:
    odd = tmp_path / "odd.eds"
    odd.write_text(maker.read_text(encoding="utf-8").replace("DefaultValue=0\n[40F0]", "DefaultValue=soon\n[40F0]"))
    odd.write_text(odd.read_text(encoding="utf-8") + "DefaultValue=soon\n")
    file = load_eds(odd, 5)
    assert file.notes
    rig = ParameterRig(maker, tmp_path / "odd", bitrate=None, file=file)
    with rig.stack:
        told = [f"the maker's file: {note}" for note in rig.drives[0].file_notes]
        contents = read_any(concise(tmp_path, LELY[-3:]))
        assert told
        assert [note for note in load(rig, contents).notes if note in told] == told
        assert [note for note in compare([(rig.drives[0], contents)])[0].notes if note in told] == told
        (backup,) = back_up(rig.drives)
        assert [note for note in backup.notes if note in told] == told


def test_a_dcf_of_another_node_does_not_bring_its_cob_ids(tmp_path: Path) -> None:
    path = tmp_path / "node5.dcf"
    text = EDS.read_text(encoding="utf-8").replace("[1402sub1]\n", "[1402sub1]\nParameterValue=0x405\n")
    path.write_text(text + "\n[DeviceComissioning]\nNodeID=5\n", encoding="utf-8")
    assert [entry.address for entry in read_any(path, 5).entries] == ["1402h PDO"]
    with pytest.raises(
        InputError, match=r"is of node 5, and its RPDO 3 has the COB-ID 405h of that node; this drive is node 6"
    ):
        read_any(path, 6)
    assert [entry.address for entry in read_any(path, 6, pdos=False).entries] == ["1402h:01"]
    assert [entry.address for entry in load_set(path, load_drive_axis(axis_file(tmp_path, EDS, 5))).entries] == [
        "1402h PDO"
    ]
    with pytest.raises(InputError, match="this drive is node 6"):
        load_set(path, load_drive_axis(axis_file(tmp_path, EDS, 6)))
    for harmless in ("0x406", "0x80000405"):  # of no node's predefined set but 6's; of a PDO that is out of use
        path.write_text(path.read_text(encoding="utf-8").replace("ParameterValue=0x405", f"ParameterValue={harmless}"))
        assert [entry.address for entry in read_any(path, 6).entries] == ["1402h PDO"]
        path.write_text(path.read_text(encoding="utf-8").replace(f"ParameterValue={harmless}", "ParameterValue=0x405"))


def test_objects_that_the_drives_file_lacks_are_told_in_one_line(rig: ParameterRig, tmp_path: Path) -> None:
    objects = [((0x5F00 + number, 0), u8(1)) for number in range(6)]
    report = load(rig, read_any(concise(tmp_path, objects)))
    assert [str(each) for each in report.objections] == [
        "6 objects of the set are not in the drive's file (5F00h:00, 5F01h:00, 5F02h:00, 5F03h:00, …):"
        " expected the axis file's eds to have them"
    ]


def test_the_axis_files_eds_reaches_the_drive(maker: Path, tmp_path: Path) -> None:
    """So that the PDOs are checked against it before anything is written, and motion objects have its limits."""
    axis = load_drive_axis(axis_file(tmp_path, maker, 5))
    with ExitStack() as stack:
        drive = canopen_drive(axis, WallClock(), ("virtual", f"eds-{tmp_path.name}"), stack)
        assert drive.node.eds is not None
        assert drive.node.eds.path == str(maker)
        assert (0x40C5, 0) in drive.node.eds.mappable_objects()


def test_a_block_is_the_bytes_of_a_concise_dcf() -> None:
    block = PdoImage.of(LELY[:7])
    assert unpack_concise(block.pack()) == list(block.items)
    assert (block.cob_id, block.mapped) == (0x405, (0x60FF0020, 0x60400010))
    assert PdoImage.unpack(block.pack()) == block
    with pytest.raises(InputError, match="expected the objects of one PDO"):
        PdoImage.unpack(pack_concise(LELY))


def test_what_a_node_may_ignore_is_no_difference() -> None:
    """Bit 30 of the COB-ID (no RTR), the entries behind the count, and what the set does not name."""
    held = PdoImage.of(
        [((0x1800, 1), u32(0x40000185)), ((0x1800, 2), u8(1)), ((0x1A00, 0), u8(1)), ((0x1A00, 1), u32(0x60410010))]
    )
    assert held.holds(PdoImage.of([((0x1800, 1), u32(0x185)), ((0x1A00, 0), u8(1)), ((0x1A00, 1), u32(0x60410010))]))
    assert not held.holds(PdoImage.of([((0x1800, 1), u32(0x80000185))]))
    assert not held.holds(PdoImage.of([((0x1800, 2), u8(255))]))
    assert not held.holds(PdoImage.of([((0x1A00, 0), u8(1)), ((0x1A00, 1), u32(0x60640020))]))
    assert not held.holds(PdoImage.of([((0x1800, 5), u8(1))]))  # a time that the node does not have
