"""Files that are bombs, that no reader expects, or that would be read as something else: refused in one line, within a bound."""

from __future__ import annotations

import contextlib
import json
import os
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, PrivateFormat
from hostile import files

from drivers.canopen.eds import load_eds
from drivers.canopen.eds_text import MOST_MEMBERS
from drivers.errors import InputError
from drivers.files import read_bytes
from drivers.instruments.ascii_values import LONGEST_BYTES, AsciiDecoder, AsciiSettings
from drivers.instruments.replay import MOST_LINES, Recording
from drivers.instruments.values import BadLine, Value
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_map import shipped_maps
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.correction.formats import wide_iso
from hil.correction.manual import read_manual_tables
from hil.correction.sealed import CostError, check_detached, load_private_key, load_public_key, new_key, seal
from hil.correction.store import SealedStore
from hil.correction.tables import TableSet
from hil.effects.model import Model
from hil.parameters.formats import read_any
from hil.parameters.set_file import read_set
from hil.probe.store import RunOutStore
from hil.records.files import DEEPEST, parse_json
from hil.records.journal import read_purpose
from hil.records.made_with import read_made_with
from hil.records.rows import parse_csv, read_csv
from hil.records.zero import read_zero
from hil.ui.terminal.passwords import read_password_file

PASSWORD = "a long enough password"
QUICK_S = 0.5
"""Bound on CPU time of a refusal; each takes a few ms."""
LITTLE_BYTES = 8 << 20

Write = Callable[[bytes | str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def written(data: bytes | str) -> Path:
        path = tmp_path / "hostile"
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return path

    return written


def refused(read: Callable[[], object], match: str | None = None, kind: type[InputError] = InputError) -> None:
    """The reader raises an error of one line, in little time.

    Time of this thread alone, and of the quickest of three: a collection of the process's garbage takes as long on a busy host.
    """
    for attempt in range(3):
        began = time.thread_time()
        with pytest.raises(kind, match=match) as error:
            read()
        if time.thread_time() - began < QUICK_S:
            break
        assert attempt < 2, "not quick in three attempts"
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 1000


# -- bombs -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "key",
    [
        pytest.param(files.scrypt_key(1 << 22), id="scrypt of 4 GiB"),
        pytest.param(files.scrypt_key(1 << 30), id="scrypt of 1 TiB"),
        pytest.param(files.scrypt_key(1 << 14, 8, 1 << 20), id="scrypt a million times"),
        pytest.param(files.scrypt_key(3), id="scrypt of no power of two"),
        pytest.param(files.scrypt_key(-8), id="scrypt of a negative cost"),
        pytest.param(files.pbkdf2_key(10**9), id="PBKDF2 of 10⁹ rounds"),
        pytest.param(files.pbkdf2_key(-1), id="PBKDF2 of a negative number of rounds"),
    ],
)
def test_a_key_whose_derivation_is_a_bomb_is_refused_before_it_is_computed(write: Write, key: bytes) -> None:
    path = write(key)
    refused(lambda: load_private_key(path, PASSWORD), "expected", CostError)


@pytest.mark.parametrize(
    "key",
    [
        files.key_of_unknown_scheme(),
        files.key_of_unknown_derivation(),
        files.key_with_false_marker(),
        files.plain_key_called_encrypted(),
        files.scrypt_key(16)[:80] + b"\n-----END ENCRYPTED PRIVATE KEY-----\n",
        b"-----BEGIN ENCRYPTED PRIVATE KEY-----\nA-----END ENCRYPTED PRIVATE KEY-----",
    ],
)
def test_a_private_key_of_another_make_is_refused(write: Write, key: bytes) -> None:
    path = write(key)
    refused(lambda: load_private_key(path, PASSWORD), "is not a password-protected private key")


def test_a_key_file_longer_than_any_key_is_refused(write: Write) -> None:
    path = write(b"x" * (1 << 20) + files.scrypt_key(16))
    refused(lambda: load_private_key(path, PASSWORD), "is too long, expected at most 64 KiB")
    path = write(files.public_key_of_unknown_kind() + b"x" * (1 << 20))
    refused(lambda: load_public_key(path), "is too long, expected at most 64 KiB")


def test_a_key_that_another_tool_encrypted_by_pbkdf2_opens(write: Write) -> None:
    key = Ed25519PrivateKey.generate()
    path = write(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(PASSWORD.encode())))
    assert load_private_key(path, PASSWORD).public_key() == key.public_key()


def test_a_public_key_of_an_unknown_kind_is_refused(write: Write) -> None:
    path = write(files.public_key_of_unknown_kind())
    refused(lambda: load_public_key(path), "is not a public key")


def test_a_recording_that_unpacks_without_end_is_refused_within_memory(write: Write) -> None:
    path = write(files.packed(b"time_s,laser_mm\n", 1) + files.packed(b"0" * 1024, 1 << 22))  # 4 GiB without a line end
    assert path.stat().st_size < 8 << 20
    tracemalloc.start()
    try:
        refused(lambda: Recording.read(path), "too long unpacked")
        assert tracemalloc.get_traced_memory()[1] < LITTLE_BYTES
    finally:
        tracemalloc.stop()


@pytest.mark.outside
def test_a_recording_of_empty_lines_without_end_is_refused(write: Write) -> None:
    path = write(files.packed(b"time_s,laser_mm\n", 1) + files.packed(b"\n" * 1024, 1 << 20))
    began = time.process_time()
    with pytest.raises(InputError, match=f"in {MOST_LINES} lines"):
        Recording.read(path)
    assert time.process_time() - began < 30


@pytest.mark.parametrize(
    ("read", "most_s"),
    [
        pytest.param(lambda path: load_eds(_written(path, files.eds(8000))), 3.0, id="EDS of 8,000 objects"),
        pytest.param(
            lambda path: load_axis(_written(path, "[axis]\nname = 0b" + "1" * 100_000)),
            1.0,
            id="axis file, a number of 100,000 digits",
        ),
        pytest.param(lambda _path: parse_csv(files.wide_header(20_000)), 1.0, id="records of 20,000 columns"),
        pytest.param(lambda _path: wide_iso.load("t;1" + " " * 8000 + "x\n1;2\n"), 0.1, id="wide ISO, 8,000 blanks"),
        pytest.param(
            lambda _path: wide_iso.load("t;run" + " " * 8000 + "1\n1;2\n"),
            0.1,
            id="wide ISO, 8,000 blanks before a number",
        ),
    ],
)
def test_a_file_that_made_a_reader_quadratic_is_read_or_refused_soon(
    read: Callable[[Path], object], most_s: float, tmp_path: Path
) -> None:
    """The bound is a third of what a quadratic reader took or less; the exponents are in `test_linear_readers`."""
    began = time.thread_time()
    with contextlib.suppress(InputError):
        read(tmp_path / "file")
    assert time.thread_time() - began < most_s


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "read",
    [
        load_axis,
        load_drive_map,
        load_eds,
        read_set,
        lambda path: load_private_key(path, PASSWORD),
        load_public_key,
        read_password_file,
        read_zero,
        read_manual_tables,
        read_csv,
        lambda path: SealedStore(path, "X", PASSWORD, new_key().public_key()).load(),
        lambda path: read_any(path.rename(path.with_suffix(".cdcf"))),
    ],
)
def test_a_file_of_4_tib_that_takes_no_disk_is_refused_unread(read: Callable[[Path], object], write: Write) -> None:
    path = write("")
    os.truncate(path, 4 << 40)
    assert path.stat().st_blocks == 0
    with pytest.raises(InputError, match="is too long"):
        read(path)


def test_a_device_without_end_is_read_up_to_the_bound(write: Write) -> None:
    refused(lambda: read_bytes("/dev/zero", LITTLE_BYTES), "is too long, expected at most 8192 KiB")
    path = write("x" * 10)
    assert read_bytes(path, 10) == b"x" * 10
    refused(lambda: read_bytes(path, 9), "is too long")


def test_compact_arrays_that_unpack_to_gigabytes_are_refused(write: Write) -> None:
    """100 kB of text would make a million entries, 60 times what is kept of them at most."""

    def arrays(count: int) -> str:
        return "".join(f"[{index:04X}]\nCompactSubObj=254\n" for index in range(count))

    path = write(arrays(1 << 12))
    refused(lambda: load_eds(path), "more than 16384 members")
    path.write_text(arrays(MOST_MEMBERS // 254))
    assert len(load_eds(path).entries) == 255 * (MOST_MEMBERS // 254)


# -- numbers, nesting and types that no reader expects ----------------------------------------------------------------
@pytest.mark.parametrize(
    "text",
    [
        files.model(table={**files.MODEL["table"], "forward_um": [int(files.MANY_DIGITS), 0]}),
        files.model(table={**files.MODEL["table"], "nodes": [int(files.MANY_DIGITS)]}),
        files.model(table={**files.MODEL["table"], "nodes": [1e308]}),
        files.model(version=int(files.MANY_DIGITS)),
        '{"format": "hil-model", "version": ' + "9" * 5000 + "}",
        files.nested(),
        "[" * files.DEEP,
        files.model()[:-3] + files.nested() + "}",
        files.model(about={"a": json.loads(files.nested(500))}),
        *(files.model(terms=[{**files.TERM, "effect": effect}]) for effect in ([], {}, None, 1, [[]])),
        *(files.model(terms=[{**files.TERM, "inputs": inputs}]) for inputs in ([[]], [None], "x", {})),
        *(files.model(terms=[{**files.TERM, key: value}]) for key in files.TERM for value in ([], {}, 1, "x", [[]])),
    ],
)
def test_a_model_file_of_wrong_values_is_refused(text: str) -> None:
    refused(lambda: Model.from_json(text))


@pytest.mark.parametrize(
    "value", [files.MANY_DIGITS, "9" * 5000, files.MANY_DIGITS + ".0", "inf", "nan", files.nested()]
)
def test_a_register_map_of_a_hostile_scale_is_refused(write: Write, value: str) -> None:
    good = shipped_maps()["vendor_style"].read_text()
    assert "\nscale = 0.1" in good
    path = write(good.replace("\nscale = 0.1", f"\nscale = {value}"))
    refused(lambda: load_drive_map(path))


@pytest.mark.parametrize("value", ["0x" + "F" * 5000, '"' + "P" * 5000 + '"'])
def test_a_register_map_of_a_hostile_address_is_refused(write: Write, value: str) -> None:
    path = write(shipped_maps()["vendor_style"].read_text().replace("\naddress = ", f"\naddress = {value}#", 1))
    refused(lambda: load_drive_map(path), "address is")


@pytest.mark.parametrize(
    "line",
    [
        f"travel_max_mm = {files.MANY_DIGITS}",
        "travel_max_mm = " + files.nested(),
        "travel_max_mm = " + files.nested(900),
        "travel_max_mm = " + "{a = " * 900 + "1" + "}" * 900,
        ".".join("a" * 10_000) + " = 1",
    ],
)
def test_an_axis_file_of_hostile_values_is_refused(write: Write, line: str) -> None:
    path = write(f'[axis]\nname = "X"\n{line}\n')
    refused(lambda: load_axis(path))


@pytest.mark.parametrize("key", ["LowLimit", "HighLimit", "DefaultValue", "ParameterValue"])
def test_an_eds_file_with_a_number_of_400_digits_is_refused(write: Write, key: str) -> None:
    path = write(files.eds(1) + f"{key}={files.MANY_DIGITS}\n")
    refused(lambda: load_eds(path), "400 digits, expected a number of 64 bits")


@pytest.mark.parametrize(
    "content", [files.nested(), files.nested(900), files.MANY_DIGITS, f'{{"format": {files.nested()}}}']
)
def test_a_signed_store_of_hostile_json_is_refused(tmp_path: Path, content: str) -> None:
    key = new_key()
    entries = {"X.tables": content.encode(), "X.effects": b"[]"}
    path = tmp_path / "X.sealed"
    path.write_bytes(seal(entries, PASSWORD, key))
    refused(lambda: SealedStore(path, "X", PASSWORD, key.public_key()).load())


@pytest.mark.parametrize(
    "content", [files.nested(), files.nested(900), files.MANY_DIGITS, "[]", "null", "\x00", '{"id": 1']
)
def test_every_other_json_file_of_hostile_content_is_refused(write: Write, content: str) -> None:
    path = write(content)
    refused(lambda: read_zero(path))
    refused(lambda: read_made_with(path))
    refused(lambda: check_detached(b"", content.encode(), new_key().public_key()))
    (path.parent / "campaign.json").write_text(content)
    refused(lambda: read_purpose(path.parent))
    (path.parent / "runout.json").write_text(content)
    refused(lambda: RunOutStore(path.parent, "M").load())


def test_json_may_nest_as_deep_as_stated_and_no_deeper() -> None:
    assert parse_json(files.nested(DEEPEST)) is not None
    for deeper in (files.nested(DEEPEST + 1), '{"a":' * (DEEPEST + 1) + "1" + "}" * (DEEPEST + 1)):
        with pytest.raises(ValueError, match="nested too deeply"):
            parse_json(deeper)


def test_tables_whose_mode_or_format_is_no_text_are_refused() -> None:
    for value in ([], {}, None, int(files.MANY_DIGITS)):
        refused(lambda form=value: TableSet.from_dict({"format": form}))
        refused(lambda form=value: TableSet.from_dict({"format": "hil-tables/1", "mode": form}))


# -- read as something else -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("pieces", [1, 7, 1000])
def test_a_line_longer_than_the_longest_is_never_believed(pieces: int) -> None:
    line = b" " * (LONGEST_BYTES - 4) + b"12.3456"
    decoder = AsciiDecoder(AsciiSettings("number", request=b"?"))
    data = line + b"\r\n 1.5\r\n"
    events = [event for at in range(0, len(data), pieces) for event in decoder.feed(data[at : at + pieces])]
    assert [event for event in events if isinstance(event, Value)] == [Value(1.5)]
    assert any(isinstance(event, BadLine) and "longer" in event.reason for event in events)


@pytest.mark.parametrize("cell", ["1_0", "١٢", "１", "inf", "-inf", "infinity", "1e999", "1e5_0", "0x10"])
def test_a_cell_that_only_python_takes_for_a_number_is_refused(write: Write, cell: str) -> None:
    path = write(f"time_s,laser_mm\n0,1\n1,{cell}\n")
    refused(lambda: Recording.read(path), "expected a number")
    refused(lambda: parse_csv(f"run,direction,target_mm,measured_mm\n1,1,0,{cell}\n"), "expected")


def test_a_recording_that_names_a_column_twice_is_refused(write: Write) -> None:
    path = write("time_s,laser_mm,laser_mm\n0,1,2\n")
    refused(lambda: Recording.read(path), "twice")


@pytest.mark.parametrize("inside", ["\u2028", "\u2029", "\x0b", "\x0c", "\x1c", "\x85", " "])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "", "\nmore"])
def test_only_a_line_end_ends_a_password(write: Write, inside: str, end: str) -> None:
    path = write(f"first half{inside}second half{end}")
    assert read_password_file(path) == f"first half{inside}second half"


@pytest.mark.parametrize("inside", ["\u2028", "\x0b", "\x0c", "\x85"])
def test_only_a_line_end_ends_a_row(write: Write, inside: str) -> None:
    path = write(f"time_s,laser_mm\n0,1{inside}1,2\n")
    refused(lambda: Recording.read(path))
    refused(lambda: parse_csv(f"run,direction,target_mm,measured_mm\n1,1,0,0{inside}1,1,1,1\n"))


@pytest.mark.parametrize(
    ("radius", "sense", "angles"),
    [
        (1, 1, [0]),
        (1, 1e400, [0, 1]),
        (1, 2, [0, 1]),
        (1e400, 1, [0, 1]),
        (-1, 1, [0, 1]),
        (1, 1, [[0, 1]]),
        (1, 1, [0, 1e400]),
    ],
)
def test_a_circle_of_wrong_values_is_refused(
    write: Write, radius: float, sense: float, angles: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    circle = {"angle_deg": angles, "deviation_um": [0, 1]}
    path = write(json.dumps({"radius_mm": radius, "sense": sense, "circles": {"a": circle}}))
    path = path.rename(path.with_suffix(".json"))
    assert main(["iso230-4", str(path)]) == 2
    assert capsys.readouterr().err.endswith("is no result of `hil circle --json`\n")


@pytest.mark.parametrize("inside", ["\u2028", "\x0b", "\x0c", "\x85"])
def test_only_a_line_end_ends_a_point_of_a_circle(
    write: Write, inside: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(f"x_mm,y_mm\n1,0\n0,1{inside}-1,0\n0,-1\n")
    assert main(["iso230-4", str(path), "--radius", "1"]) != 0
    assert "row has 3 columns, expected 2" in capsys.readouterr().err
