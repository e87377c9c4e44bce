"""A file that only one may work with at a time, whatever name it is called by and whatever file has its name meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import InputError
from hil.records.files import held_by_name


def _linked(path: Path) -> Path:
    link = path.with_name("link.toml")
    link.symlink_to(path)
    return link


def _twin(path: Path) -> Path:
    twin = path.with_name("twin.toml")
    twin.hardlink_to(path)
    return twin


def _renamed(path: Path) -> Path:
    return path.rename(path.with_name("renamed.toml"))


def _replaced(path: Path) -> None:
    """As editors do it: the name goes to a new file."""
    new = path.with_suffix(".new")
    new.write_bytes(path.read_bytes())
    new.replace(path)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "axis.toml"
    path.write_text("[axis]\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("other", [_twin, _renamed], ids=["hard link", "renamed"])
def test_the_file_is_held_by_any_name(path: Path, other: Callable[[Path], Path]) -> None:
    with held_by_name(path), pytest.raises(InputError, match="in use already"), held_by_name(other(path)):
        pass


@pytest.mark.parametrize("through_link_first", [True, False])
def test_a_link_holds_the_name_that_it_leads_to(path: Path, through_link_first: bool) -> None:
    """Also once that name is another file's, so that holding the file alone would not do."""
    first, second = (_linked(path), path) if through_link_first else (path, _linked(path))
    with held_by_name(first):
        _replaced(path)
        with pytest.raises(InputError, match="in use already"), held_by_name(second):
            pass


def test_a_relative_name_is_held_as_the_whole_one(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(path.parent)
    with held_by_name(path.name):
        _replaced(path)
        with pytest.raises(InputError, match="in use already"), held_by_name(path):
            pass
    with held_by_name(path):
        pass
