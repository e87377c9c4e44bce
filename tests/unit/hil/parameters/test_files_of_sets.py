"""Which files are sets, which uploads are kept, and when a backup was made."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.errors import InputError
from hil.parameters.job import LARGEST_BYTES, backed_up_at, keep_set, require_size, set_files
from hil.parameters.set_file import FORMAT, ParameterSet, SetEntry, write_set


@pytest.fixture
def axis(tmp_path: Path) -> Any:
    home = tmp_path / "home"
    home.mkdir()
    (home / "x.toml").write_text('name = "X"\n')
    return cast(
        Any, SimpleNamespace(name="X", path=home / "x.toml", store=SimpleNamespace(directory=tmp_path / "kept"))
    )


def a_set(path: Path, value: int = 1) -> bytes:
    write_set(
        path, ParameterSet("gains", None, (SetEntry("6065h:00", value, None, "UNSIGNED32", "", "window"),), None, path)
    )
    return path.read_bytes()


def test_sets_are_known_by_suffix_and_toml_by_its_first_lines(axis: Any, tmp_path: Path) -> None:
    home = axis.path.parent
    a_set(home / "b.toml")
    for name in ("a.dcf", "C.DCF", ".hidden.dcf", "notes.txt", "late.toml"):
        (home / name).write_text("x")
    (home / "late.toml").write_bytes(b"#" * 4096 + FORMAT.encode())
    (home / "in_time.toml").write_bytes(b"#" * (4096 - len(FORMAT)) + FORMAT.encode())
    (home / "folder.dcf").mkdir()
    brought = tmp_path / "kept/parameters/sets"
    brought.mkdir(parents=True)
    (brought / "aa.dcf").write_text("x")
    assert [path.name for path in set_files(axis)] == ["C.DCF", "a.dcf", "aa.dcf", "b.toml", "in_time.toml"]


def test_an_upload_is_kept_once_and_never_replaced(axis: Any, tmp_path: Path) -> None:
    data, other = a_set(tmp_path / "one.toml"), a_set(tmp_path / "other.toml", 2)
    path = keep_set(axis, "some/folder/gains.toml", data)
    assert (path.name, path.read_bytes()) == ("gains.toml", data)
    assert set_files(axis) == (path,)
    assert keep_set(axis, "gains.toml", data) == path
    with pytest.raises(InputError, match="something else"):
        keep_set(axis, "gains.toml", other)
    assert path.read_bytes() == data
    assert keep_set(axis, "again.toml", other).read_bytes() == other


@pytest.mark.parametrize("name", ["gains.exe", "gains", ".toml", "bad|name.toml", "-x.toml", f"{'x' * 100}.toml"])
def test_a_name_that_is_none_of_a_set_is_refused(axis: Any, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="expected the name of a set"):
        keep_set(axis, name, a_set(tmp_path / "one.toml"))
    assert set_files(axis) == ()


def test_nothing_is_left_of_an_upload_that_is_no_set(axis: Any) -> None:
    with pytest.raises(InputError):
        keep_set(axis, "gains.toml", b"no set = [")
    with pytest.raises(InputError, match="at most 2000000"):
        keep_set(axis, "gains.toml", b"#" * (LARGEST_BYTES + 1))
    assert not [path for path in axis.store.directory.rglob("*") if path.is_file()]


def test_the_size_may_be_the_largest_and_no_more() -> None:
    require_size("a/b.toml", 2_000_000)
    with pytest.raises(InputError, match=r"^b\.toml has 2000001 bytes"):
        require_size("a/b.toml", 2_000_001)


def test_a_backup_says_in_its_name_when_it_was_made(axis: Any) -> None:
    found = backed_up_at(axis, Path("X-20260102-030405.params.toml"))
    assert found is not None
    assert found.tzinfo is not None
    assert found.replace(tzinfo=None) == datetime(2026, 1, 2, 3, 4, 5)
    for name in (
        "Y-20260102-030405.params.toml",
        "X-20260102-030405.toml",
        "X-late.params.toml",
        "20260102-030405.params.toml",
    ):
        assert backed_up_at(axis, Path(name)) is None
