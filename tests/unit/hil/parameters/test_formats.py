"""Sets in the files of other tools: what a concise DCF holds byte by byte, whose a DCF is, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.paper_drive import PaperDrive

from drivers.errors import InputError
from drivers.raw_parameters import RawForm, RawParameter
from hil.parameters.formats import read_any, write_any
from hil.parameters.set_file import ParameterSet, SetEntry


class HexDrive(PaperDrive):
    """Takes raw forms as hexadecimal digits."""

    def from_raw(self, entry: RawParameter, raw: RawForm) -> bytes:
        return bytes.fromhex(str(raw))


def a_set(*entries: tuple[str, str]) -> ParameterSet:
    return ParameterSet("s", None, tuple(SetEntry(address, None, raw) for address, raw in entries))


GAIN = "10220102000000" + "0500"
"""CiA 302-3: index and sub-index, size in four bytes, value; 5 in 2210h:01."""
COB_ID = "001401" + "04000000" + "05020000"
KIND = "001402" + "01000000" + "ff"


def test_a_concise_dcf_holds_each_object_and_a_pdo_as_its_objects(tmp_path: Path) -> None:
    drive, path = HexDrive(**{"2210h:01": 1, "1400h PDO": 0}), tmp_path / "s.cdcf"
    pdo = "02000000" + COB_ID + KIND
    write_any(path, a_set(("2210h:01", "0500"), ("1400h PDO", pdo)), drive, None, None)
    assert path.read_bytes().hex() == "03000000" + GAIN + COB_ID + KIND
    again = read_any(path)
    assert [(entry.address, entry.raw) for entry in again.entries] == [("2210h:01", "0500"), ("1400h PDO", pdo)]


def test_what_the_drive_may_refuse_is_written_and_what_its_file_lacks_is_not(tmp_path: Path) -> None:
    drive, path = HexDrive(**{"2210h:01": 1, "gain": 1}), tmp_path / "s.cdcf"
    drive.refusals["2210h:01"] = "moves the axis"
    write_any(path, a_set(("2210h:01", "0500")), drive, "cdcf", None)
    assert path.read_bytes().hex() == "01000000" + GAIN
    for contents, why in (
        (
            a_set(("2210h:01", "0500"), ("2211h:00", "0500")),
            "cannot be written as cdcf: 2211h:00: .* no such parameter",
        ),
        (a_set(("gain", "0500")), "cannot be written as cdcf: gain is no CANopen object"),
    ):
        with pytest.raises(InputError, match=why):
            write_any(tmp_path / "other.cdcf", contents, drive, None, None)
    assert not (tmp_path / "other.cdcf").exists()
    with pytest.raises(InputError, match="the axis file names no eds"):
        write_any(tmp_path / "s.dcf", a_set(("2210h:01", "0500")), drive, None, None)


DCF = """[DeviceInfo]
VendorNumber={vendor}
ProductNumber={product}
[MandatoryObjects]
SupportedObjects=1
1=0x1018
[1018]
ParameterName=Identity
ObjectType=0x9
SubNumber=3
[1018sub0]
ParameterName=Count
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=2
[1018sub1]
ParameterName=Vendor
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x1A
[1018sub2]
ParameterName=Product
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x2B
[ManufacturerObjects]
SupportedObjects=1
1=0x2210
[2210]
ParameterName=Gain
ObjectType=0x7
DataType=0x0006
AccessType=rw
ParameterValue=5
"""


@pytest.mark.parametrize(
    ("vendor", "product", "model"),
    [
        ("0xFB", "0xFC", {"vendor_id": 0xFB, "product_code": 0xFC}),
        ("0", "0", {"vendor_id": 0x1A, "product_code": 0x2B}),
    ],
)
def test_a_dcf_is_of_the_drive_in_its_head_and_else_of_the_one_in_its_identity_object(
    vendor: str, product: str, model: dict[str, int], tmp_path: Path
) -> None:
    path = tmp_path / "s.dcf"
    path.write_text(DCF.format(vendor=vendor, product=product))
    found = read_any(path)
    assert found.identity is not None
    assert found.identity.model == model
    assert [(entry.address, entry.value) for entry in found.entries] == [("2210h:00", 5)]


def test_a_dcf_that_names_no_drive_is_of_any(tmp_path: Path) -> None:
    path = tmp_path / "s.dcf"
    path.write_text(re.sub("DefaultValue=0x.*\n", "", DCF.format(vendor="0", product="0")))
    found = read_any(path)
    assert found.identity is not None
    assert found.identity.model == {}
