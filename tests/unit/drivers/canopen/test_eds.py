"""EDS and DCF files as vendors write them: read where the canopen package stops, limits kept, nothing overlooked in silence."""

from pathlib import Path

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.eds import load_eds
from drivers.canopen.eds_text import parse, summary
from drivers.cia402.objects import QUICK_STOP_OPTION, TARGET_VELOCITY, DataType, Entry
from drivers.errors import InputError
from sim_backends.canopen_drive import EDS

VENDOR = """\ufeff[FileInfo]
FileName=drive.eds
this line is a stray one
[DEVICEINFO]
vendornumber=0x4E1
ProductNumber=1026
[1000]
PARAMETERNAME=Device type ; with a comment
DataType=0x07
AccessType=RO
DefaultValue=0x20192
[1018]
ParameterName=Identity
ObjectType=0x9
SubNumber=2
[1018Sub0]
ParameterName=entries
DataType=0x05
AccessType=const
DefaultValue=1
[1018SUB1]
ParameterName=Vendor
DataType=7
AccessType=ro
DefaultValue=4E1h
[605a]
ParameterName=Quick stop option code
DataType=0x0003
AccessType=rw
LowLimit=-32768
HighLimit=0x0008
DefaultValue=02
PDOMapping=0
[605A]
HighLimit=7
[607D]
ParameterName=Software position limit
ObjectType=8
DataType=0x4
AccessType=rww
LowLimit=0x80000000
HighLimit=0x7FFFFFFF
CompactSubObj=2
[607DName]
NrOfEntries=2
1=Minimum
2=Maximum
[6083]
ParameterName=Acceleration
DataType=0x0007
AccessType=wr
LowLimit=
HighLimit=4294967295
DefaultValue=ten
[6085]
ParameterName=Limits that hold nothing
DataType=0x0004
AccessType=rw
LowLimit=0
HighLimit=0xFFFFFFFF
[2001]
ParameterName=Gain
DataType=0x0008
AccessType=rw
LowLimit=-0.5
HighLimit=1.5
DefaultValue=0.25
[2002]
AccessType=ro
[2010sub3]
ParameterName=Orphan
DataType=6
AccessType=rw
[1014]
ParameterName=EMCY
DataType=7
AccessType=rw
DefaultValue=$nodeid + 0x80
"""


@pytest.fixture
def vendor_file(tmp_path: Path) -> Path:
    path = tmp_path / "vendor.eds"
    path.write_text(VENDOR, encoding="utf-8")
    return path


def test_it_is_read(vendor_file: Path) -> None:
    eds = load_eds(vendor_file, 5)
    entries = eds.entries
    assert entries[0x1000, 0].default == 0x20192
    assert entries[0x1000, 0].entry.name == "Device type"
    assert entries[0x1018, 1].default == 0x4E1
    assert entries[0x1014, 0].default == 0x85
    assert (eds.vendor_number, eds.product_number) == (0x4E1, 1026)
    assert entries[0x2002, 0].entry.type is DataType.DOMAIN
    assert entries[0x2010, 3].entry.name == "Orphan"


def test_limits_are_kept(vendor_file: Path) -> None:
    entries = load_eds(vendor_file, 5).entries
    assert (entries[0x605A, 0].low, entries[0x605A, 0].high) == (-32768, 7)
    assert (entries[0x607D, 1].low, entries[0x607D, 2].high) == (-(2**31), 2**31 - 1)
    assert [entries[0x607D, subindex].entry.name for subindex in (1, 2)] == ["Minimum", "Maximum"]
    assert (entries[0x6083, 0].low, entries[0x6083, 0].high) == (None, 2**32 - 1)
    assert (entries[0x2001, 0].low, entries[0x2001, 0].high) == (-0.5, 1.5)
    assert (entries[0x6085, 0].low, entries[0x6085, 0].high) == (None, None)


def test_what_was_overlooked_is_said(vendor_file: Path) -> None:
    assert tuple(map(str, load_eds(vendor_file, 5).notes)) == (
        "line 3 'this line is a stray one' is neither section nor key, skipped",
        "[605A] stands there again, taken together",
        "[605A] HighLimit stands there again, the last one counts",
        "[6083] AccessType 'wr' is no access type, taken as read only",
        "[2002] has no data type, taken as a domain",
        "[2010sub3] has no object, one was assumed",
        "[6083] DefaultValue 'ten' is no number, left out",
        "[6085] LowLimit and HighLimit '0 to -1' limits hold nothing, left out",
    )


VALUES = """
[2000]
ParameterName=a signed byte in hexadecimal digits
DataType=0x0002
AccessType=rw
DefaultValue=0xFD
[2001]
ParameterName=the lowest of 32 bits
DataType=0x0004
AccessType=rw
DefaultValue=0x80000000
ParameterValue=-0x77359400
[2002]
ParameterName=a REAL by its bits
DataType=0x0008
AccessType=rw
DefaultValue=0x41200000
LowLimit=0xC1200000
HighLimit=3.402823E+38
[2003]
ParameterName=the node id alone
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID
ParameterValue=0x80 + $NodeID
[2004]
ParameterName=24 bit
DataType=0x0010
AccessType=rw
DefaultValue=0xFFFFFE
[2005]
ParameterName=56 bit
DataType=UNSIGNED56
AccessType=rw
DefaultValue=0xFFFFFFFFFFFFFF
[2006]
ParameterName=48 bit
DataType=0x0013
AccessType=rw
DefaultValue=-48
[2007]
ParameterName=a suffix of C
DataType=0x0015
AccessType=rw
DefaultValue=0x1234567890ABCDEFLL
[2008]
ParameterName=16-bit units
DataType=0x000B
AccessType=rw
DefaultValue=abc✓; def
[2009]
ParameterName=six bytes of time
DataType=0x000C
AccessType=rw
DefaultValue=010203040506
[200A]
ParameterName=a domain
DataType=0x000F
AccessType=rw
DefaultValue=0
ParameterValue=0A0B ; two bytes
[200B]
ParameterName=beyond its type
DataType=0x0005
AccessType=rw
DefaultValue=256
ParameterValue=010
[200C]
ParameterName=compact
ObjectType=0x8
DataType=0x0003
AccessType=rw
CompactSubObj=2
[200CValue]
NrOfEntries=1
2=0xFFFF
[200D]
ParameterName=an empty list
ObjectType=0x8
DataType=0x0003
AccessType=rw
CompactSubObj=400
"""


def test_values_are_read_as_they_are_meant(tmp_path: Path) -> None:
    """CiA 306: hexadecimal digits of signed types are two's complement, of a REAL its bits (41200000h is 10.0 in IEEE 754)."""
    path = tmp_path / "values.dcf"
    path.write_text(VALUES, encoding="utf-8")
    eds = load_eds(path, 5)
    found = {key[0]: (each.default, each.value) for key, each in eds.entries.items() if key[1] == 0}
    assert found[0x2000] == (-3, None)
    assert found[0x2001] == (-(2**31), -2_000_000_000)
    assert found[0x2002] == (10.0, None)
    assert (eds.entries[0x2002, 0].low, eds.entries[0x2002, 0].high) == (-10.0, 3.402823e38)
    assert found[0x2003] == (5, 0x85)
    assert (found[0x2004], found[0x2005], found[0x2006]) == ((-2, None), (2**56 - 1, None), (-48, None))
    assert found[0x2007] == (0x1234567890ABCDEF, None)
    assert found[0x2008] == ("abc✓; def", None)
    assert found[0x2009] == (bytes((1, 2, 3, 4, 5, 6)), None)
    assert found[0x200A] == (None, b"\x0a\x0b")
    assert found[0x200B] == (None, 10)
    assert [eds.entries[0x200C, member].value for member in (1, 2)] == [None, -1]
    assert tuple(map(str, eds.notes)) == (
        "[2005] DataType 'UNSIGNED56' is a name, its code is meant",
        "[200D] CompactSubObj '400' is no number of members, left out",
        "[200A] DefaultValue '0' is no DOMAIN in hexadecimal digits, left out",
        "[200B] DefaultValue '256' does not fit its type, left out",
        "[200B] ParameterValue '010' has a leading zero, read as decimal, not octal",
    )
    unknown = load_eds(path)
    assert unknown.entries[0x2003, 0].default is None
    assert summary(unknown.notes)[2] == (
        "[2003] DefaultValue '$NODEID', [2003] ParameterValue '0x80 + $NodeID':"
        " depends on the node id, which is not given, left out"
    )


def test_values_of_every_type_go_to_the_wire_and_back() -> None:
    """CiA 301, 7.1.4: little endian; UNICODE_STRING in units of 16 bit."""
    spelled: tuple[tuple[DataType, int | str | bytes, str], ...] = (
        (DataType.I24, -2, "feffff"),
        (DataType.U40, 0x0102030405, "0504030201"),
        (DataType.I48, -48, "d0ffffffffff"),
        (DataType.U56, 2**56 - 1, "ff" * 7),
        (DataType.UNICODE, "a✓", "61001327"),
        (DataType.TIME_OF_DAY, bytes(6), "00" * 6),
    )
    for kind, value, data in spelled:
        entry = Entry(0x2000, 0, kind, "x")
        assert entry.pack(value).hex() == data
        assert entry.unpack(bytes.fromhex(data)) == value
    for kind, wrong in ((DataType.I24, 2**23), (DataType.DOMAIN, 1_200_000), (DataType.OCTETS, 3), (DataType.U40, -1)):
        with pytest.raises(InputError, match="does not fit"):
            Entry(0x2000, 0, kind, "x").pack(wrong)


def test_a_limit_of_400_digits_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "long.eds"
    path.write_text("[6081]\nDataType=7\nAccessType=rw\nHighLimit=" + "9" * 400 + "\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_eds(path, 5)
    assert str(caught.value) == (f"{path}: [6081] HighLimit '{'9' * 40}…' has 400 digits, expected a number of 64 bits")


def test_a_clean_file_has_no_notes_and_agrees_with_the_canopen_package() -> None:
    eds = load_eds(EDS, 5)
    theirs = canopen.import_od(str(EDS), 5)
    assert eds.notes == ()
    for (index, subindex), found in eds.entries.items():
        variable = theirs.get_variable(index, subindex)
        assert variable is not None
        assert (found.entry.name, found.access) == (variable.name, variable.access_type)
        assert found.default == variable.default
        assert (found.low, found.high) == (variable.min, variable.max)
        assert found.mappable == variable.pdo_mappable
    assert len(eds.entries) > 200
    assert eds.mappable_objects()[0x6041, 0].readable


def test_the_file_tells_of_an_object_what_the_drive_layer_asks(vendor_file: Path) -> None:
    eds = load_eds(vendor_file, 5)
    quick_stop = eds.about(QUICK_STOP_OPTION)
    assert quick_stop is not None
    assert (quick_stop.entry.type, quick_stop.access, quick_stop.mappable) == (DataType.I16, "rw", False)
    assert (eds.limits(QUICK_STOP_OPTION), eds.value(QUICK_STOP_OPTION)) == ((-32768, 7), 2)
    assert (eds.about(TARGET_VELOCITY), eds.limits(TARGET_VELOCITY), eds.value(TARGET_VELOCITY)) == (
        None,
        (None, None),
        None,
    )
    assert eds.doubts(0x4E1, 1026) == eds.doubts(None, None) == ()
    assert eds.doubts(0xFB, 2) == (
        "the maker's file (eds) is for vendor id 0x4e1, this drive reports 0xfb",
        "the maker's file (eds) is for product code 0x402, this drive reports 0x2",
    )


def test_a_dcf_brings_its_node_and_values(tmp_path: Path) -> None:
    path = tmp_path / "axis.dcf"
    path.write_text(
        "[DeviceCommissioning]\nNodeID=0x0C\nBaudrate=500\n"
        "[605A]\nParameterName=qs\nDataType=3\nAccessType=rw\nDefaultValue=2\nParameterValue=6\n"
        "[1014]\nParameterName=EMCY\nDataType=7\nAccessType=rw\nDefaultValue=$NODEID+0x80\n",
        encoding="cp1252",
    )
    dcf = load_eds(path)
    assert dcf.node_id == 12
    assert (dcf.entries[0x605A, 0].default, dcf.entries[0x605A, 0].value) == (2, 6)
    assert dcf.entries[0x1014, 0].default == 0x8C
    assert load_eds(path, 5).entries[0x1014, 0].default == 0x85


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing.eds: cannot be read"):
        load_eds(tmp_path / "nothing.eds")
    empty = tmp_path / "empty.eds"
    empty.write_text("[FileInfo]\nFileName=x\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"empty.eds: holds no object"):
        load_eds(empty)


@settings(max_examples=200)
@given(st.text(max_size=400))
def test_any_text_is_taken_apart_without_an_error(text: str) -> None:
    parse(text)


@settings(max_examples=100)
@given(st.lists(st.sampled_from(VENDOR.splitlines()), max_size=60))
def test_any_shuffle_of_a_files_lines_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, lines: list[str]
) -> None:
    path = tmp_path_factory.mktemp("eds") / "shuffled.eds"
    path.write_text("\n".join(lines), encoding="utf-8")
    try:
        load_eds(path, 5)
    except InputError as error:
        assert "shuffled.eds" in str(error)  # noqa: PT017 - either way is right


@pytest.mark.parametrize("kind", ["0x0007", "0x0003", "0x0005", "0x0008", "UNSIGNED16"])
@pytest.mark.parametrize("access", ["rw", "rww", "RWR", "wo"])
@pytest.mark.parametrize("zero", ["0", "0x0", "00000000h"])
def test_limits_of_0_on_what_is_written_are_none(tmp_path: Path, kind: str, access: str, zero: str) -> None:
    """CANopenEditor issue 54: an editor writes LowLimit=0 and HighLimit=0 where nobody entered limits."""
    path = tmp_path / "drive.eds"
    for name, low, high, kept in (
        ("6065", zero, zero, False),
        ("6065", zero, "5000", True),
        ("607Bsub1", zero, zero, False),
    ):
        path.write_text(
            f"[{name}]\nParameterName=x\nDataType={kind}\nAccessType={access}\nLowLimit={low}\nHighLimit={high}\n",
            encoding="utf-8",
        )
        eds = load_eds(path)
        (found,) = (found for found in eds.entries.values() if found.entry.name == "x")
        if kind == "0x0008" and zero != "0":
            continue  # a REAL in hexadecimal digits has the bits of one
        assert (found.low, found.high) == ((0, 5000) if kept else (None, None))
        assert any("limits of 0 are none" in note.kind for note in eds.notes) is not kept


def test_a_read_only_object_may_have_nothing_but_0(tmp_path: Path) -> None:
    path = tmp_path / "drive.eds"
    path.write_text("[6502]\nParameterName=x\nDataType=0x7\nAccessType=ro\nLowLimit=0\nHighLimit=0\n", encoding="utf-8")
    assert load_eds(path).entries[0x6502, 0].high == 0
