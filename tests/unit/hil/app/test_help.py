"""`hil help` on a terminal: the page is set for its width, and a link says which page it names."""

from __future__ import annotations

import io
import re
import sys

import pytest

from hil.app.main import main


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_on_a_terminal_a_page_is_set_for_its_width(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "70")
    monkeypatch.setenv("TERM", "xterm")
    shown = Terminal()
    monkeypatch.setattr(sys, "stdout", shown)
    assert main(["help", "recovery"]) == 0
    text = re.sub(r"\x1b\[[0-9;]*m", "", shown.getvalue())
    lines = text.splitlines()
    assert max(map(len, lines)) <= 70
    assert "(first_axis.md)" in " ".join(text.split())
    assert not [line for line in lines if line.startswith("|")]
