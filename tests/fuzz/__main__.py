"""Coverage-guided fuzzing of every parser and protocol face: `python tests/fuzz [TARGET …] --runs 100000`, one target after the other.

Atheris (libFuzzer) guides the mutations by the coverage of drivers, hil and sim_backends. A finding is written to tests/fuzz/found;
minimised it belongs into tests/fuzz/cases, which every run of the tests repeats. Prints executions and time of
each target.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import re
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fuzz.targets import Target

HERE = Path(__file__).parent
FOUND = HERE / "found"
PAGE = HERE.parents[1] / "hil/docs/security.md"
COUNTS = HERE / "counts.json"
"""Executions so far, by target."""
TOTAL = "Executions so far: "
"""How the line of the page begins that sums them up."""
SLOWEST_S = 10
"""One input that takes longer is a finding."""
MOST_MB = 1024


def fuzz(name: str, target: Target, runs: int, seconds: int) -> None:
    """One target in this process, which libFuzzer ends."""
    import atheris  # noqa: PLC0415  (not on every Python)

    with tempfile.TemporaryDirectory() as work:
        corpus, words = Path(work) / "corpus", Path(work) / "words"
        corpus.mkdir()
        cases = HERE / "cases" / name.replace(" ", "_")
        for number, seed in enumerate([*target.seeds, *(path.read_bytes() for path in sorted(cases.glob("*")))]):
            (corpus / f"seed{number}").write_bytes(seed)
        words.write_text(
            "".join('"' + "".join(f"\\x{byte:02x}" for byte in word.encode()) + '"\n' for word in target.words)
        )
        FOUND.mkdir(exist_ok=True)
        options: dict[str, object] = {
            "runs": runs,
            "max_total_time": seconds,
            "max_len": target.longest,
            "timeout": SLOWEST_S,
            "rss_limit_mb": MOST_MB,
            "artifact_prefix": f"{FOUND}/{name.replace(' ', '_')}-",
            "print_final_stats": 1,
            "verbosity": 0,
        }
        if target.words:
            options["dict"] = words
        atheris.Setup([sys.argv[0], *(f"-{key}={value}" for key, value in options.items()), str(corpus)], target)
        atheris.Fuzz()


def main() -> int:
    """Exit status 0 where nothing was found."""
    parser = argparse.ArgumentParser(description="Coverage-guided fuzzing of every parser and protocol face.")
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="names (default: all)")
    parser.add_argument("--runs", type=int, default=100_000, help="executions of each target")
    parser.add_argument("--seconds", type=int, default=0, help="at most so long each, 0 for no bound")
    parser.add_argument("--list", action="store_true", help="print the names")
    parser.add_argument("--json", metavar="FILE", help="write executions and findings by target")
    parser.add_argument("--write", action="store_true", help=f"add the executions to {COUNTS.name} and {PAGE.name}")
    args = parser.parse_args()
    sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]
    targets = _targets()
    if args.list:
        print("\n".join(targets))
        return 0
    if unknown := [name for name in args.targets if name not in targets]:
        parser.error(f"no target {unknown[0]!r}, expected one of {', '.join(targets)}")
    table: dict[str, dict[str, object]] = {}
    for name in args.targets or targets:
        began = time.monotonic()
        status, said = _in_child(lambda name=name: fuzz(name, targets[name], args.runs, args.seconds))
        counted = re.search(r"number_of_executed_units:\s+(\d+)", said)
        runs = int(counted[1]) if counted else 0
        good = status == 0 and runs > 0
        took_s = round(time.monotonic() - began)
        table[name] = {"executions": runs, "seconds": took_s, "good": good}
        print(f"{name:<28} {runs:>9} executions {took_s:>7} s  {'nothing found' if good else 'FOUND'}", flush=True)
        if not good:
            print(said[-3000:], flush=True)
        if args.write and good:
            add({name: runs})
        if args.json:
            Path(args.json).write_text(json.dumps(table, indent=1) + "\n")
    return 0 if all(each["good"] for each in table.values()) else 1


def add(runs: Mapping[str, int]) -> None:
    """Add executions that found nothing to the counts, and their sum to the page."""
    counts: dict[str, int] = json.loads(COUNTS.read_text(encoding="utf-8"))
    for name, count in runs.items():
        counts[name] = counts.get(name, 0) + count
    in_order = {name: counts[name] for name in sorted(counts, key=str.lower)}
    COUNTS.write_text(json.dumps(in_order, indent=1) + "\n", encoding="utf-8")
    head = PAGE.read_text(encoding="utf-8").partition(TOTAL)[0]
    PAGE.write_text(f"{head}{TOTAL}{summed(counts)}\n", encoding="utf-8")


def summed(counts: Mapping[str, int]) -> str:
    """The counts in one sentence."""
    least = min(counts.values())
    return f"{sum(counts.values()):,} on {len(counts)} targets, at least {least:,} on each. Everything found was corrected."


def _targets() -> Mapping[str, Target]:
    """The targets, with the code that they try instrumented; said on standard error, module by module."""
    import atheris  # noqa: PLC0415

    with tempfile.TemporaryFile() as quiet:
        kept = os.dup(2)
        os.dup2(quiet.fileno(), 2)
        try:
            with atheris.instrument_imports(include=["drivers", "hil", "sim_backends"]):
                targets: Mapping[str, Target] = importlib.import_module("fuzz.targets").TARGETS
        finally:
            os.dup2(kept, 2)
            os.close(kept)
    return targets


def _in_child(work: Callable[[], None]) -> tuple[int, str]:
    """Exit status and error output of work in a forked process: the instrumented code is imported once for all targets."""
    with tempfile.TemporaryFile() as said:
        child = os.fork()
        if not child:
            os.dup2(said.fileno(), 2)
            try:
                work()
            except BaseException:  # noqa: BLE001 - the child must end here
                traceback.print_exc()
            os._exit(70)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        said.seek(0)
        return status, said.read().decode("utf-8", "replace")


if __name__ == "__main__":
    sys.exit(main())
