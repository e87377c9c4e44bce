"""Everything marked `vcan`, run in the guest: its tests count as one here and are listed one by one where they fail.

Where this kernel has vcan0 and vcan1 itself those tests run in place and this one has nothing to do. Where neither can be had it
fails, so that nobody takes an unproven bus for a proven one; HIL_NO_VCAN_GUEST=1 turns that into a skip.
"""

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
RUN = ROOT / "tests" / "vcan_guest" / "run.py"
LIMIT_S = 2700
PREPARED_S = 900
NO_GUEST = 125
HOW = (
    "The tests on SocketCAN need either interfaces vcan0 and vcan1 (modprobe vcan; ip link add vcan0 type vcan; ip link set vcan0"
    " up; the same for vcan1) or, to start a kernel that has them, an apt archive with"
    " user-mode-linux, or qemu-system-x86 (sh hil/bootstrap.sh pytest installs it). HIL_NO_VCAN_GUEST=1 skips them."
)


def pytest_here(*arguments: str) -> list[str]:
    return [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-o",
        "addopts=",
        *OPTIONS,
        *arguments,
    ]


OPTIONS = ("--strict-markers", "--import-mode=importlib")


def collected() -> list[str]:
    """Node ids of the tests marked `vcan`."""
    answer = subprocess.run(
        pytest_here("--collect-only", "-q", "-m", "vcan", "tests"),
        cwd=ROOT,
        env={name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")},
        capture_output=True,
        text=True,
        check=False,
        timeout=PREPARED_S,
    )
    if answer.returncode:
        pytest.fail(f"collecting the tests failed:\n{answer.stdout}{answer.stderr}")
    return [line for line in answer.stdout.splitlines() if "::" in line]


def prepare() -> list[str]:
    """Fetch what tests in the guest use and only the host can get; what could not be had, for the summary."""
    lines = []
    for script in sorted((ROOT / "tests").glob("*/*/prepare.py")):
        answer = subprocess.run(
            [sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=PREPARED_S
        )
        if answer.returncode:
            lines.append(f"  {answer.stderr.strip()}")
    return lines


@pytest.mark.guest
def test_what_needs_socketcan_passes_in_the_guest(
    tmp_path: Path, record_property: Callable[[str, object], None], vcan_in_place: bool
) -> None:
    if vcan_in_place:
        pytest.skip("vcan0 and vcan1 exist here: the tests marked vcan run in place")
    if os.environ.get("HIL_NO_VCAN_GUEST"):
        pytest.skip("HIL_NO_VCAN_GUEST is set: the tests on SocketCAN have NOT been run")
    wanted = collected()
    unprepared = prepare()
    files = sorted({node.partition("::")[0] for node in wanted})
    inside = pytest_here("-q", "-ra", "-m", "vcan", "--junitxml=/hil-job/out/junit.xml", *files)
    guest = subprocess.run(
        [sys.executable, str(RUN), "--out", str(tmp_path), "--timeout", str(LIMIT_S), "--", *inside],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT_S + 60,
    )
    if guest.returncode == NO_GUEST:
        pytest.fail(f"{guest.stdout}{guest.stderr.strip()}\n{HOW}", pytrace=False)
    junit = tmp_path / "junit.xml"
    if not junit.exists():
        pytest.fail(f"the guest ended with {guest.returncode}:\n{guest.stdout}\n{guest.stderr}", pytrace=False)

    cases = list(ElementTree.parse(junit).iter("testcase"))
    outcomes = Counter(outcome(case) for case in cases)
    reasons = Counter(reason(case) for case in cases if outcome(case) == "skipped")
    skipped = [f"  skipped {number}: {why}" for why, number in reasons.items()]
    counts = ", ".join(f"{number} {name}" for name, number in sorted(outcomes.items()))
    record_property("vcan guest", "\n".join([f"vcan: {counts}; {guest.stderr.strip()}", *unprepared, *skipped]))

    bad = [case for case in cases if outcome(case) in ("failed", "error")]
    if bad:
        parts = [f"{label(case)}: {reason(case)}\n{''.join(case.itertext())}" for case in bad]
        pytest.fail(f"in the guest {counts}\n\n" + "\n\n".join(parts), pytrace=False)
    assert len(cases) == len(wanted), f"of {len(wanted)} tests the guest ran {len(cases)}:\n{guest.stdout}"
    assert guest.returncode == 0, guest.stdout


def outcome(case: ElementTree.Element) -> str:
    for tag, name in (("failure", "failed"), ("error", "error"), ("skipped", "skipped")):
        if case.find(tag) is not None:
            return name
    return "passed"


def label(case: ElementTree.Element) -> str:
    return f"{case.get('classname')}::{case.get('name')}"


def reason(case: ElementTree.Element) -> str:
    return next((child.get("message", "") for child in case if child.tag in ("failure", "error", "skipped")), "")
