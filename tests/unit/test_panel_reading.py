"""Contents of a folder on the screen: what was read while a job ran is not taken for what the job has left."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest
from nicegui import run, ui

from hil.ui.screen.pieces import FolderContents
from hil.ui.screen.view import View


class Desk:
    computed = SimpleNamespace(number=0, running=False)

    def __init__(self) -> None:
        self.phase = "running"

    def job(self) -> Any:
        return SimpleNamespace(number=1, phase=self.phase)


def test_what_was_read_while_the_job_ran_is_not_current_once_it_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    desk, looks = Desk(), []

    async def attempt(work: Callable[[], Awaitable[None]]) -> None:
        await work()

    async def at_once(read: Callable[[], str]) -> str:
        found = read()
        desk.phase = "done"  # the job ends while its folder is read
        return found

    monkeypatch.setattr(ui, "timer", lambda _period_s, look: looks.append(look))
    monkeypatch.setattr(run, "io_bound", at_once)
    reading = FolderContents(cast(View, SimpleNamespace(desk=desk, attempt=attempt)), lambda: f"while {desk.phase}")
    assert (reading.value, reading.current) == (None, False)
    asyncio.run(looks[0]())
    assert (reading.value, reading.current) == ("while running", False)
    asyncio.run(looks[0]())
    assert (reading.value, reading.current) == ("while done", True)
