"""The commands of the pages do what the pages say: each page is run in a folder of its own, and its output compared."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from support.commissioning import shortened
from support.docs import COMMISSIONING, PAGES, blocks, holds, outputs, page_output, run_commands, run_page
from support.sim_process import sim

pytestmark = pytest.mark.outside

RUN = [
    name
    for name, path in PAGES.items()
    if any(block.info == ("sh",) or block.info[:1] == ("text",) for block in blocks(path.read_text(encoding="utf-8")))
]


Commissioned = Callable[[], tuple[Path, dict[str, str]]]


@pytest.fixture(scope="module")
def commissioned(tmp_path_factory: pytest.TempPathFactory) -> Commissioned:
    """A folder in which the commands of the page "commissioning" were run, and what they printed: once for all pages that continue
    there, in whichever process they are tested."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    @cache
    def made() -> tuple[Path, dict[str, str]]:
        folder, printed = shared / "commissioned", shared / "commissioned.json"
        with (shared / "commissioned.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not printed.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                printed.write_text(json.dumps(run_page(COMMISSIONING, folder)), encoding="utf-8")
        return folder, json.loads(printed.read_text(encoding="utf-8"))

    return made


@pytest.mark.parametrize("page", RUN)
def test_a_page_does_what_it_says(page: str, tmp_path: Path, commissioned: Commissioned) -> None:
    said = page_output(page, tmp_path, commissioned)
    for command, block in outputs(PAGES[page].read_text(encoding="utf-8")):
        assert holds(block.text, said[command]), (
            f"{page}, line {block.line}: {command} prints\n{said[command]}\n(python tests/study/docs_output.py --write)"
        )


def test_the_readmes_lines_for_a_real_drive(tmp_path: Path) -> None:
    """As typed, but for the names of the ports, over a drive and a laser in a process of their own; the measurement is a short one."""
    text = PAGES["README"].read_text(encoding="utf-8")
    block = next(block for block in blocks(text) if block.info == ("sh", "hardware") and "drives new" in block.text)
    link, *commands = block.commands
    assert link.startswith("sudo ip link set can0 up ")
    assert len(block.text.splitlines()) <= 10
    with sim("drive", "--interface", "slcan-pty", "--laser", "--machine", "geometric") as machine:
        place = machine.place
        channel, port = place["drive"]["channel"], place["laser"]["port"]
        for command in commands:
            typed = command.replace("--channel can0", f"--interface slcan --channel {channel}").replace(
                "/dev/ttyUSB0", port
            )
            run_commands([typed], tmp_path, "README")
            if " drives new " in command:
                shortened(tmp_path / "X.toml")
    assert (tmp_path / "X-campaign/tables.sealed").exists()
    assert (tmp_path / "verified.html").exists()
