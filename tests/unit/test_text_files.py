"""Every text file that the program reads may be one that an editor saved: with a byte-order mark, or as UTF-16."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from drivers.canopen.eds import load_eds
from drivers.canopen.table_map import load_table_map
from drivers.drive_notes import load_drive_notes
from drivers.errors import InputError
from drivers.instruments.replay import Recording
from drivers.limits import DriveLimits
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.wear import WearLedger
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.correction.manual import read_backlash, read_manual_tables, read_signs, read_straightness
from hil.correction.sealed.keys import load_public_key, new_key
from hil.diagnosis.next.plans import read_plan
from hil.effects.model import Model, PitchTable
from hil.effects.user_effects import effects_of_file
from hil.parameters.formats import read_any
from hil.records.rows import read_csv
from hil.ui.terminal.passwords import read_password_file
from hil.ui.terminal.records_input import read_model

ROOT = Path(__file__).parents[2]
ROWS = "run,direction,target_mm,measured_mm\n1,+1,0.0,0.001\n1,+1,10.0,10.002\n1,-1,10.0,10.001\n1,-1,0.0,0.0\n"
EDS = "[1000]\nParameterName=Gerät\nObjectType=0x7\nDataType=0x7\nAccessType=ro\nDefaultValue=0x192\n"
SET = 'format = "hil parameter set 1"\nname = "Ä"\nparameters = [{ index = 0x2210, subindex = 1, value = 1 }]\n'
MODEL = Model(PitchTable((0.0, 10.0), (0.0, 1.0), (0.0, 1.0), (0, 1), ((0.0,) * 4,) * 4)).to_json()
LIMITS = DriveLimits(0.0, 500.0, 100.0, 500.0)


def _packaged(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


def _verb(*line: str) -> Callable[[Path], str]:
    """A verb whose output holds what was read of a file; `FILE` and `OUT` stand for it and for the output."""

    def run(path: Path) -> str:
        out = path.parent / "out.csv"
        assert main([{"FILE": str(path), "OUT": str(out)}.get(word, word) for word in line]) == 0
        return out.read_text()

    return run


PEM = new_key().public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()
READERS: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "axis file": ("X.toml", _packaged("hil.examples", "axis.toml"), lambda path: load_axis(path).limits),
    "password": ("password", "pässword\r\n", read_password_file),
    "records": ("rows.csv", ROWS, lambda path: read_csv(path).columns["measured_mm"].tolist()),
    "recording": ("rec.csv", "time_s,laser_mm\n0,1\n1,2\n", lambda path: Recording.read(path).column("laser_mm")[1]),
    "EDS": ("drive.eds", EDS, lambda path: [each.entry.name for each in load_eds(path).entries.values()]),
    "DCF": ("drive.dcf", EDS.replace("=ro", "=rw") + "ParameterValue=1\n", lambda path: read_any(path).entries),
    "parameter set": ("set.toml", SET, lambda path: read_any(path).entries),
    "typed tables": ("t.csv", "position_mm,plus_um,minus_um\n0,1,2\n9,1,2\n", read_manual_tables),
    "backlash": ("b.csv", "position_mm,backlash_um\n0,1\n9,2\n", lambda path: read_backlash(path).value_um.tolist()),
    "signs": ("s.csv", "from_mm,to_mm,plus,minus\n0,9,1,-1\n", read_signs),
    "straightness": ("s.csv", "position_mm,deviation_um\n0,1\n5,2\n9,2\n", lambda path: repr(read_straightness(path))),
    "plan": ("plan.csv", "run,direction,target_mm\n1,+1,10\n1,-1,10\n", lambda path: read_plan(path, LIMITS)),
    "public key": ("builder.pub", PEM, lambda path: load_public_key(path).public_bytes_raw()),
    "wear ledger": ("wear.json", '{"d/r": 3}', lambda path: WearLedger(path).writes("d", "r")),
    "drive notes": ("n.toml", _packaged("drivers.canopen", "drive_notes/kinco.toml"), load_drive_notes),
    "register map": ("r.toml", _packaged("drivers.modbus", "maps/leadshine_el7.toml"), load_drive_map),
    "model": ("model.json", MODEL, lambda path: read_model(str(path))),
    "tables to export": ("model.json", MODEL, _verb("export", "FILE", "--format", "linuxcnc", "--out", "OUT")),
    "compensation": ("x.comp", "0 0 0\n9 0.001 0\n", _verb("import", "FILE", "--format", "linuxcnc", "--out", "OUT")),
    "measurement": ("l.csv", ROWS, _verb("import", "FILE", "--format", "csv", "--out", "OUT")),
    "table map": ("m.toml", _packaged("drivers.canopen", "tables/simulated_array.toml"), load_table_map),
}
ENCODINGS = {
    "mark": lambda text: text.encode("utf-8-sig"),
    "UTF-16": lambda text: text.encode("utf-16"),
    "UTF-16 big end first": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
    "UTF-32": lambda text: text.encode("utf-32"),
    "two marks": lambda text: f"\ufeff\ufeff{text}".encode(),
}


@pytest.mark.parametrize("name", READERS)
def test_a_file_reads_alike_in_each_encoding_of_an_editor(name: str, tmp_path: Path) -> None:
    file, text, read = READERS[name]
    path = tmp_path / file
    path.write_text(text, encoding="utf-8", newline="")
    expected = read(path)
    for encode in ENCODINGS.values():
        path.write_bytes(encode(text))
        assert repr(read(path)) == repr(expected)


FORMS = {
    "ZIP": (b"PK\x03\x04\x14\0\x06\0[Content_Types].xml", "ZIP archive, as XLSX"),
    "office": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "office file of the older form (XLS"),
    "PDF": (b"%PDF-1.7\n", "PDF"),
    "gzip": (b"\x1f\x8b\x08\0", "gzip"),
    "XML": (b'\xef\xbb\xbf<?xml version="1.0"?>\n<a/>', "XML"),
    "XDD": (b'<ISO15745ProfileContainer xmlns:xsi="http://x">', "XDD"),
    "HTML": (b"\n<!DOCTYPE html>\n", "HTML page"),
    "UTF-16 without a mark": ("run,direction".encode("utf-16-le"), "UTF-16 without its byte-order mark"),
}


@pytest.mark.parametrize("name", sorted(set(READERS) - {"public key", "recording", "wear ledger"}))
def test_another_form_is_named(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, _, read = READERS[name]
    path = tmp_path / file
    for data, named in FORMS.values():
        path.write_bytes(data)
        try:
            read(path)
        except InputError as error:
            said = str(error)
        except AssertionError:  # a verb's exit status
            said = capsys.readouterr().err
        else:
            said = ""
        assert f"{path}" in said
        assert named in said


@pytest.mark.parametrize("begin", ["", "<!-- made by an editor -->\n", "\n"])
@pytest.mark.parametrize("root", ["ISO15745ProfileContainer", "CanOpenProject", "EtherCATInfo"])
def test_xml_is_named_as_a_drive_s_file_without_declaration_too(begin: str, root: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.xdd"
    path.write_text(f"{begin}<{root}>\n <a/>\n</{root}>\n")
    with pytest.raises(InputError, match=r"is XML, as XDD.* expected EDS or DCF"):
        load_eds(path)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32"])
def test_code_in_another_encoding_than_pythons_is_refused_by_its_name(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "effect.py"
    path.write_bytes("EFFECTS = ()\n".encode(encoding))
    with pytest.raises(InputError, match=f"{encoding.upper()} text, expected Python code in UTF-8"):
        effects_of_file(path)


def test_no_module_decodes_a_file_by_itself() -> None:
    own = re.compile(r"read_bytes\([^)]*\)\.decode|\bpath\.read_text\(|open\([^)]*encoding|removeprefix\(.\\ufeff")
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for folder in ("drivers", "hil")
        for path in (ROOT / folder).rglob("*.py")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if own.search(line) and not re.search(r"open\(\"[ax]", line) and "page.open" not in line
    ]
    assert not found
