"""The pytest plugin `hil.testing`: fixtures for tests of scripts (`hil help scripts`). What they need is imported when one is used."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hil.script.open_axis import OpenAxis
    from hil.testing.drive import SimulatedDrive

WIRES = ("virtual", "vcan0", "slcan")
MACHINES = ("simulated_drive", "simulated_axis")
"""Fixtures of a machine, the first of which in a test `fault` acts on."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds `--hil-wire`."""
    parser.getgroup("hil").addoption(
        "--hil-wire",
        choices=WIRES,
        default="virtual",
        help="CAN bus of simulated_drive: python-can's virtual bus in this process, vcan0, or an slcan adapter on a pseudo-terminal",
    )


@pytest.fixture
def simulated_axis(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[OpenAxis]:
    """An open axis as of `hil.open`, on a simulated machine with a laser, its drive on a virtual CAN bus in this process.

    Time is simulated: it passes while the axis moves, is watched or read, as fast as the processor allows.
    """
    from hil.script.open_axis import open_axis  # noqa: PLC0415  (loads slowly)
    from hil.testing.drive import lay_out  # noqa: PLC0415

    with open_axis(lay_out(tmp_path, monkeypatch)) as axis:
        yield axis


@pytest.fixture
def simulated_drive(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[SimulatedDrive]:
    """A CiA 402 drive with its axis and laser, on the CAN bus of `--hil-wire`, in real time; `hil.open(simulated_drive.axis_file)`
    connects it, as often as the script does."""
    from hil.testing.drive import running_drive  # noqa: PLC0415  (loads slowly)

    with running_drive(request.config.getoption("--hil-wire"), tmp_path, monkeypatch) as drive:
        yield drive


@pytest.fixture
def fault(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """fault("KIND@SECONDS+SECONDS=SIZE"): what goes wrong with the machine of the test, in how many seconds from now, for how long.

    As `--fault` of `hil sim drive`; times and size may be left out: `fault("beam-lost")` is now. Faults of the bus, as
    `fault("tpdo-lost+0.5")`, are those of simulated_drive alone.
    """
    from hil.testing.drive import fault_of  # noqa: PLC0415  (loads slowly)

    found = [name for name in MACHINES if name in request.fixturenames]
    if not found:
        raise pytest.UsageError(f"the fixture fault needs {' or '.join(MACHINES)} in the same test")
    return fault_of(request.getfixturevalue(found[0]))
