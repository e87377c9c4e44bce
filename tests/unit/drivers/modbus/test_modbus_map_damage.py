"""Register maps damaged in every way a text editor can: read, or refused with one line that names the file. Nothing else ever."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_map import shipped_maps

TEXTS = {name: path.read_text(encoding="utf-8") for name, path in shipped_maps().items()}
VALUES = [
    '""',
    "-1",
    "0",
    "1.5",
    "true",
    "nan",
    "inf",
    "[]",
    "{}",
    '"x"',
    "99999999999",
    "[1, 2]",
    "1979-05-27",
    '["fault"]',
]


def _load(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
    complaint = ""
    try:
        load_drive_map(path)
    except InputError as error:
        complaint = str(error)
    assert "\n" not in complaint
    assert not complaint or str(path) in complaint


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_lines(tmp_path: Path, data: st.DataObject) -> None:
    lines = TEXTS[data.draw(st.sampled_from(sorted(TEXTS)))].splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(lines) - 1))
        match data.draw(st.sampled_from(["drop", "double", "value", "key", "cut", "swap"])):
            case "drop":
                del lines[place]
            case "double":
                lines.insert(place, lines[place])
            case "value":
                lines[place] = f"{lines[place].partition('=')[0]}= {data.draw(st.sampled_from(VALUES))}"
            case "key":
                lines[place] = "x" + lines[place]
            case "cut":
                lines[place] = lines[place][: data.draw(st.integers(0, len(lines[place])))]
            case "swap":
                other = data.draw(st.integers(0, len(lines) - 1))
                lines[place], lines[other] = lines[other], lines[place]
    _load(tmp_path / "model.toml", "\n".join(lines))


def test_a_file_that_is_no_text_and_one_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_bytes(b"[map]\xff")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        load_drive_map(path)
    with pytest.raises(InputError, match="is neither a file nor a shipped register map"):
        load_drive_map(tmp_path)
