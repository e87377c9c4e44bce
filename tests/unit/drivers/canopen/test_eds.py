"""EDS and DCF files as vendors write them: read where the canopen package stops, limits kept, nothing overlooked in silence."""

from pathlib import Path

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.eds import load_eds
from drivers.canopen.eds_text import parse
from drivers.canopen.objects import DataType
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


def test_the_canopen_package_refuses_such_a_file(vendor_file: Path) -> None:
    with pytest.raises(Exception, match=r"."):
        canopen.import_od(str(vendor_file), 5)


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
    assert load_eds(vendor_file, 5).notes == (
        "line 3: 'this line is a stray one' is neither section nor key, skipped",
        "line 34: section [605A] again, taken together",
        "line 35: [605A] HighLimit again, the last one counts",
        "[6083] has access type 'wr', taken as read only",
        "[6083] DefaultValue 'ten' is no number, left out",
        "[2002] has no data type, taken as a domain",
        "[2010sub3] has no [2010], one was assumed",
        "[6085] limits 0 to -1 hold nothing, left out",
    )


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


def test_a_dcf_brings_its_node_and_values(tmp_path: Path) -> None:
    path = tmp_path / "axis.dcf"
    path.write_text(
        "[DeviceCommissioning]\nNodeID=0x0C\nBaudrate=500\n"
        "[605A]\nParameterName=qs\nDataType=3\nAccessType=rw\nDefaultValue=2\nParameterValue=6\n"
        "[1014]\nParameterName=EMCY\nDataType=7\nAccessType=rw\nDefaultValue=$NODEID+0x80\n",
        encoding="cp1252",
    )
    dcf = load_eds(path)
    assert (dcf.node_id, dcf.bitrate) == (12, 500_000)
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


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=400))
def test_any_text_is_taken_apart_without_an_error(text: str) -> None:
    parse(text)


@settings(max_examples=100, deadline=None)
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
