"""The drive's parameters on the operator's screen: a real browser, and a drive with forty parameters on a Modbus line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from support import panel
from support.bench_axis import AXIS, PASSWORDS
from support.modbus_parameters import COUNT, NEW, OLD, FortyFace, write_map
from support.panel import Person

from drivers.clock import WallClock
from drivers.raw_parameters import DriveIdentity
from hil.axis.axis_file import load_drive_axis
from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key
from hil.parameters.journal import Noted
from hil.parameters.set_file import ParameterSet, read_set, write_set
from hil.parameters.wiring import journal_of
from sim_backends.modbus_drive import tcp_server
from sim_backends.modbus_registers import Bank, Cell, Space

pytestmark = panel.MARKS
KEY = PASSWORDS["HIL_KEY_PASSWORD"]
FIRST = [entry.raw for entry in NEW.entries[:2]]
COARSE = AXIS.replace("1_000_000", "500")
"""Its travel fits the drive's registers of 16 bits."""
ELEMENTS = {
    *(f"parameters.{name}" for name in ("instructions", "messages", "file", "bring", "backup", "compare", "verify")),
    *(
        f"parameters.{name}"
        for name in ("download", "store", "restore", "interrupted", "unfinished", "resume", "rollback")
    ),
    *(f"parameters.{name}" for name in ("outcome", "differing", "same", "step", "progress", "backed_up", "table")),
    *(f"parameters.{name}" for name in ("read", "search", "all", "list.at", "edit.what", "edit.value", "change")),
    *("stop", "control.who", "header.state"),
}


class Face(FortyFace):
    """With a position, so that somebody can look at it."""

    def __init__(self) -> None:
        super().__init__()
        self.banks = {**self.banks, Space.INPUT_REGISTERS: Bank([Cell(0, "H", lambda: 0)], gaps_readable=False)}


@pytest.fixture
def face() -> Face:
    return Face()


@pytest.fixture
def axis(face: Face, tmp_path: Path) -> Iterator[Path]:
    write_map(tmp_path)
    with tcp_server({7: face}, WallClock()) as (_, port):
        path, key = tmp_path / "X.toml", new_key()
        path.write_text(
            f'{COARSE}\n[drive]\nbackend = "modbus"\nregister_map = "forty.toml"\nurl = "tcp://127.0.0.1:{port}"\nunit = 7\n'
        )
        save_private_key(tmp_path / "builder.key", key, KEY, cost=Cost(n=1 << 10, r=8, p=1))
        save_public_key(tmp_path / "builder.pub", key.public_key())
        yield path


def comes_to(person: Person, outcome: str, differing: int) -> None:
    person.waits_to_read("parameters.outcome", outcome)
    person.waits_to_read("parameters.differing", str(differing))


def cut_off(axis_file: Path, backup: Path) -> None:
    """As a power cut leaves it: a download in the journal, of one parameter of those it was to write, without an end."""
    axis, identity = load_drive_axis(axis_file), read_set(backup).identity
    assert isinstance(identity, DriveIdentity)
    old, new = (int(each.entries[0].raw or 0).to_bytes(2, "big") for each in (OLD, NEW))
    journal_of(axis).begin("X", "cut off", "", identity, [Noted("p0", "p0", old, new)], store=False)


def test_a_set_from_backup_to_stored_and_what_was_cut_off(
    person: Person, axis: Path, face: Face, tmp_path: Path
) -> None:
    with panel.served(axis) as (address, _):
        person.goes_to(f"{address}axis/X/lost_motion")
        person.waits(lambda: person.finds("lost_motion.no_instrument").is_displayed(), "an axis without an instrument")
        person.goes_to(f"{address}axis/X/parameters")
        person.waits(lambda: person.names() >= ELEMENTS, "every element is there")
        assert not person.finds("parameters.backup").is_enabled()
        person.takes_control()
        person.clicks("parameters.backup")
        assert any(".params.toml will be written" in line for line in person.agrees())
        person.waits(lambda: f"{COUNT} parameters backed up" in person.reads("parameters.backed_up"), "backed up")
        (backup,) = tmp_path.glob("X-*.params.toml")
        person.waits(
            lambda: person.reads("parameters.file").startswith("Backup of 20"), "the backup is chosen, by its date"
        )

        new = tmp_path / "elsewhere" / "new.toml"
        new.parent.mkdir()
        write_set(new, ParameterSet("new", None, NEW.entries[:2]))
        person.finds("parameters.bring").find_element("css selector", "input[type=file]").send_keys(str(new))
        person.waits(lambda: "new" in person.reads("parameters.file"), "the set brought is chosen")
        person.clicks("parameters.compare")
        comes_to(person, "the drive differs", 2)
        person.waits(lambda: len(person.table("parameters.table")) == 2, "both differences")
        old = [entry.raw for entry in OLD.entries[:2]]
        assert [(row[0], row[2], row[3]) for row in person.table("parameters.table")] == [
            (f"p{number}", str(old[number]), str(FIRST[number])) for number in range(2)
        ]
        assert not person.finds("parameters.download").is_enabled()  # nothing is written without the builder

        person.becomes_builder(KEY)
        person.clicks("parameters.download")
        assert any("what differs is written and read back, all or nothing" in line for line in person.agrees())
        comes_to(person, "written and read back", 0)
        person.waits(
            lambda: [row[5] for row in person.table("parameters.table")] == ["written", "written"], "row by row"
        )
        assert face.ram[:2] == FIRST
        person.clicks("parameters.verify")
        comes_to(person, "the drive holds the set", 0)
        person.clicks("parameters.store")
        person.agrees()
        comes_to(person, "stored, as the drive says; not proven by a restart", 0)
        assert face.flash[:2] == FIRST
        person.clicks("parameters.restore")
        person.agrees()
        comes_to(person, "written and read back", 0)
        person.clicks("parameters.verify")
        comes_to(person, "the drive differs", 2)

        assert not person.finds("parameters.interrupted").is_displayed()
        cut_off(axis, backup)
        person.goes_to(f"{address}axis/X/parameters")
        person.waits(lambda: "“cut off”" in person.reads("parameters.unfinished"), "it is told")
        person.clicks("parameters.rollback")
        assert any("given back what it held" in line for line in person.agrees())
        person.waits_to_read("parameters.outcome", "put back, as before")
        person.waits(lambda: not person.finds("parameters.interrupted").is_displayed(), "nothing is left over")
        assert face.ram == [entry.raw for entry in OLD.entries]
    is_read_after_a_restart(person, axis)


def test_a_parameter_is_searched_for_and_changed(person: Person, axis: Path, face: Face) -> None:
    with panel.served(axis) as (address, _):
        person.goes_to(f"{address}axis/X/parameters")
        person.takes_control()
        person.becomes_builder(KEY)
        person.clicks("parameters.read")
        person.waits(lambda: "of 50 parameters" in person.reads("parameters.list.at"), "all are listed")
        person.types("parameters.search", "P17")
        person.waits(lambda: len(person.table("parameters.all")) == 1, "one is found")
        cells = person.finds("parameters.all").find_elements("css selector", "tbody td")
        next(one for one in cells if one.text == "p17").click()
        person.waits(lambda: person.reads("parameters.edit.what").startswith("p17"), "it is chosen")
        person.types("parameters.edit.value", "3")
        person.clicks("parameters.change")
        old = OLD.entries[17].raw
        assert any(line.startswith(f"p17: {old} → 3") for line in person.agrees())
        person.waits(lambda: [row[2] for row in person.table("parameters.all")] == ["3"], "it is read again")
        assert [number for number in range(COUNT) if face.ram[number] != OLD.entries[number].raw] == [17]
        person.clicks("parameters.restore")
        assert any(line.startswith(f"p17: 3 → {old}") for line in person.agrees())
        person.waits(lambda: face.ram[17] == old, "as before the last download")


def is_read_after_a_restart(person: Person, axis: Path) -> None:
    """What the last job did, once the server was started again."""
    with panel.served(axis) as (address, _):
        person.goes_to(f"{address}axis/X/parameters")
        person.waits_to_read("parameters.outcome", "put back, as before")
        assert "before the last start of the screen" in person.reads("parameters.kept")
        person.waits(lambda: [row[5] for row in person.table("parameters.table")] == ["put back"], "row by row")
