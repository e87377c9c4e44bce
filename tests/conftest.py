"""Fixtures that more than one corner of the tests uses; anything of a single corner lives there."""

from __future__ import annotations

import gc
import os
import re
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings
from support.bench_axis import PASSWORDS

from hil.correction.sealed import Cost, save_private_key

if TYPE_CHECKING:
    from support.panel import Person

Until = Callable[[Callable[[], bool], str], None]
VCAN = ("vcan0", "vcan1")
BENCH = Path(__file__).parent / "bench"
GUEST_SUMMARY = "vcan guest"

settings.register_profile("no deadline", deadline=None)  # an example waits on a busy host
settings.load_profile("no deadline")


def vcan_here() -> bool:
    """Whether this kernel has SocketCAN and both virtual interfaces, or is the guest (where it must have them)."""
    if os.environ.get("HIL_VCAN") == "guest":
        return True
    try:
        for interface in VCAN:
            with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
                raw.bind((interface,))
    except (AttributeError, OSError):
        return False
    return True


def pytest_addoption(parser: pytest.Parser) -> None:
    """`pytest tests/contract/test_effects.py --effects FILE.py` runs the suite on a user's own effects.

    `pytest tests/integration/test_modbus_fault_campaign.py --seeds 7` runs that campaign whole; two cores have no time for it.
    """
    parser.addoption("--effects", metavar="FILE.py", action="append", default=[], help="Python code with EFFECTS = (…)")
    parser.addoption(
        "--seeds",
        metavar="N",
        type=int,
        default=1,
        help="faults of each kind in the campaigns, and times as many machines in a study, 1",
    )
    parser.addoption("--fresh", action="store_true", help="diagnose machines again that an earlier run has diagnosed")


def pytest_configure(config: pytest.Config) -> None:
    """Signals that the shell has set to be ignored (nohup, a background job) are put back for the processes that tests start.

    A handler of Python's is not inherited by them, so that this process itself goes on under nohup.
    """
    if hasattr(config, "workerinput"):
        gc.disable()  # until all tests are collected
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: None)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Two processes for the whole suite; named files stay in this one, where a debugger and -s work.

    The two begin with an environment as `.ci/run` has it: threads of small matrix products would wait for one another (minutes, where
    other programs compute too), and where nothing compiled is kept, each run rewrites the assertions of 367 files twice, 16 s each.
    """
    if config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return 0
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    return 2


OUTSIDE = {"guest", "browser", "linuxcnc", "vcan"}
"""Markers of what needs more than this computer computing."""


MARKED = re.compile(rf"mark\.({'|'.join(('outside', *OUTSIDE))})\b|MARKS")
MARKED_VCAN = re.compile(r"mark\.vcan\b")


def may_be_outside(path: Path, marked: re.Pattern[str] = MARKED) -> bool:
    """Whether a file's text marks a test so. The rigs that the tests in contract/ share are marked in `support`."""
    return "contract" in path.parts or marked.search(path.read_text(encoding="utf-8")) is not None


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """`-m outside`, and `-m vcan` of the guest, read the files alone that have such tests: half of them in each of four processes, and
    ten."""
    marked = {"outside": MARKED, "vcan": MARKED_VCAN}.get(config.option.markexpr)
    if marked is None or not collection_path.name.startswith("test_") or not collection_path.is_file():
        return None
    return None if may_be_outside(collection_path, marked) else True


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Benchmarks run alone or not at all; the guest starts first, it takes longest, and has what needs SocketCAN."""
    paths = {item.path for item in items}
    benchmarks = {path for path in paths if BENCH in path.parents}
    read_outside = {path for path in paths if path in benchmarks or may_be_outside(path)}
    elsewhere = None if vcan_here() else pytest.mark.skip(reason="runs in the guest (test_vcan_guest.py)")
    for item in items:
        names = {marker.name for marker in item.iter_markers()}
        if names & OUTSIDE or item.path in benchmarks:
            item.add_marker("outside")
        if item.get_closest_marker("outside") and item.path not in read_outside:
            raise pytest.UsageError(
                f"{item.nodeid} is marked `outside`, and its file does not say so: `-m outside` would not read it"
            )
        if "vcan" in names and elsewhere is not None:
            item.add_marker(elsewhere)
    items.sort(key=lambda item: "guest" not in item.keywords)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Garbage is not looked for while 9000 tests are collected, nor later among what that made: a tenth of the time of
    collecting, and a twentieth of the time of all tests.

    Only in the processes of xdist: study/mutants.py asks the collector for functions.
    """
    if hasattr(session.config, "workerinput"):
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show what ran in the guest, whose tests count as one here."""
    for reports in terminalreporter.stats.values():
        for report in reports:
            for name, text in getattr(report, "user_properties", ()):
                if name == GUEST_SUMMARY and getattr(report, "when", None) == "call":
                    terminalreporter.section(GUEST_SUMMARY)
                    terminalreporter.line(text)


@pytest.fixture(autouse=True, scope="session")
def quick_scrypt() -> Iterator[None]:
    """Stores and keys that tests make stretch their password over 1 MiB: at its true cost each takes 0.2 s, some ten minutes in all.

    What programs of their own make has the true cost, and `test_sealed` tests what that is.
    """
    quick = Cost(n=1 << 10, r=8, p=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.correction.sealed.sealing.DEFAULT_COST", quick)
        patch.setitem(save_private_key.__kwdefaults__, "cost", quick)
        yield


@pytest.fixture(autouse=True, scope="session")
def quick_flush(request: pytest.FixtureRequest) -> Iterator[None]:
    """Nothing waits until a disk has written, some milliseconds twice a row: power does not fail in here.

    Tests of what is flushed when put their own in place; processes that tests start flush, and so do the benchmarks.
    """
    with pytest.MonkeyPatch.context() as patch:
        if not any(BENCH in path.parents for path in {item.path for item in request.session.items}):
            patch.setattr(os, "fsync", lambda _handle: None)
        yield


@pytest.fixture(scope="module")
def person() -> Iterator[Person]:
    """A headless browser that knows nothing of an earlier one."""
    from support import panel  # noqa: PLC0415  (selenium is slow to import)

    with panel.browser() as one:
        yield one


@pytest.fixture
def passwords(monkeypatch: pytest.MonkeyPatch) -> None:
    """Passwords of the store and of the builder that `support.bench_axis` lays out, where the verbs look for them."""
    for name, value in PASSWORDS.items():
        monkeypatch.setenv(name, value)


@pytest.fixture
def until() -> Until:
    """until(condition, what): wait for something real on a wire or in another process; fails after 20 s, naming `what`."""

    def wait(condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 20.0
        while not condition():
            if time.monotonic() > deadline:
                pytest.fail(f"not within 20 s: {what}")
            time.sleep(0.005)

    return wait


@pytest.fixture(scope="session")
def vcan_in_place() -> bool:
    """Whether the tests marked `vcan` run in this very kernel."""
    return vcan_here()
