"""Mutation test of the modules with numbers and decisions: which one-line faults do the matching tests detect?

`python tests/study/mutants.py` runs all rooms of `ROOMS`, `python tests/study/mutants.py effects figures` these. It prints a table
(module, mutants, killed, survivors by group) and every survivor. `--json FILE` keeps the outcomes; with it a later run tries only
what survived before (`--all` tries everything again). `--jobs 2` uses two processes. Run it by hand: it takes about an hour.
`--quick` takes what survives in place as a survivor without importing it anew, and has hypothesis try 20 examples at the most: in a
fraction of the time, and it may name a few too many. `--sample 200` tries so many of each room, drawn with `--seed`.

Each mutant is one changed node of the syntax tree: signs, factors, numbers, comparisons (turned over, or at their boundary),
boolean decisions, calls left out, min against max and the like. Text for people, type annotations and decorators stay. The tests of
the room that call the changed function run in forked children, first with it in place of the old one; then, for what survived that
and for values of a module (all tests), with the module imported from the changed tree. No file is written.

Why not a ready tool (tried with versions of August 2026): mutmut 3.8 changes function bodies only and leaves out decorated functions,
so that no published coefficient (a value of a module) and no property is ever mutated. cosmic-ray 8.7 makes 4864 mutants of
hil/effects alone, most of them `*` against each of ten other operators, and starts Python for each: 5 s, so seven hours there.
"""

from __future__ import annotations

import argparse
import ast
import gc
import importlib
import importlib.machinery
import importlib.util
import inspect
import json
import os
import pickle
import random
import resource
import signal
import sys
import tempfile
import threading
import time
import traceback
import types
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNIT = "tests/unit/hil"


@dataclass(frozen=True)
class Room:
    """Modules by pattern, and the tests that have to detect a fault in them."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]


RISES = ("rise", "published_rise", "running_lost_motion")
ROOMS = {
    "effects": Room(
        ("hil/effects/*.py",),
        (f"{UNIT}/effects/test_reference_values.py", f"{UNIT}/effects", "tests/contract/test_effects.py"),
    ),
    "figures": Room(
        tuple(
            f"hil/figures/{name}.py"
            for name in ("iso230", "uncertainty", "alignment", "material", "reading", "latency")
        ),
        (f"{UNIT}/figures",),
    ),
    "runout": Room(
        ("hil/probe/runout.py", "hil/probe/store.py"),
        (f"{UNIT}/probe/test_runout.py", f"{UNIT}/probe/test_runout_store.py"),
    ),
    "backlash": Room(
        (*(f"hil/backlash/{name}.py" for name in ("trace", "torque_fit", "result")), "hil/axis/backlash.py"),
        (f"{UNIT}/backlash", f"{UNIT}/axis/test_axis_backlash.py"),
    ),
    "lost_motion": Room(
        (
            *(f"hil/lost_motion/{name}.py" for name in ("at_load", "estimate", "fit", "circle/figures")),
            *(f"hil/correction/{name}.py" for name in RISES),
        ),
        (
            *(f"{UNIT}/lost_motion/test_{name}.py" for name in ("by_hand", "at_load", "fit", "circle", "lost_motion")),
            *(f"{UNIT}/correction/test_{name}.py" for name in (*RISES, "lost_motion_engine")),
        ),
    ),
    "sealed": Room(
        ("hil/correction/sealed/*.py",),
        (
            *(f"{UNIT}/correction/test_{name}.py" for name in ("sealed", "seen")),
            "tests/hostile/test_files.py",
            "tests/unit/test_security_page.py",
        ),
    ),
    "scaling": Room(("drivers/scaling.py",), ("tests/unit/drivers/test_scaling.py",)),
    "cia402": Room(
        ("drivers/cia402/state_machine.py", "drivers/cia402/modes.py"), ("tests/wire/test_cia402_vectors.py",)
    ),
    "parameters": Room(
        ("hil/parameters/[!p]*.py", "hil/parameters/pre*.py"),  # all but the page, which a browser's tests judge
        (
            f"{UNIT}/parameters",
            "tests/integration/test_parameter_jobs.py",
            *(
                f"tests/integration/test_params_{name}.py"
                for name in ("download", "dcf", "side_by_side", "verb", "table_verb")
            ),
            # they take most of the time
            "--deselect=tests/integration/test_params_dcf.py::test_all_published_device_dcfs_pass_a_dry_run",
            "--deselect=tests/integration/test_parameter_jobs.py::test_what_the_screen_says_of_each_outcome",
        ),
    ),
    "correction": Room(
        tuple(f"hil/correction/{name}.py" for name in ("tables", "fold", "compensation", "manual", "bound")),
        tuple(
            f"{UNIT}/correction/test_{name}.py"
            for name in ("fold", "tables", "manual", "correction_bound", "compensation")
        ),
    ),
    "drive_table": Room(
        tuple(f"hil/drive_table/{name}.py" for name in ("curve", "quantise", "proof", "change")),
        (f"{UNIT}/drive_table", "tests/integration/test_drive_table_proof.py"),
    ),
}

SIGN, FACTOR, NUMBER = "sign", "factor or unit", "number"
TURNED, BOUNDARY, DECISION, SWAP, CALL = (
    "comparison turned over",
    "boundary",
    "decision",
    "name swapped",
    "call left out",
)
GROUPS = (SIGN, FACTOR, TURNED, DECISION, SWAP, CALL, NUMBER, BOUNDARY)

OPERATORS: dict[type[ast.operator], tuple[str, ast.operator]] = {
    ast.Add: (SIGN, ast.Sub()),
    ast.Sub: (SIGN, ast.Add()),
    ast.Mult: (FACTOR, ast.Div()),
    ast.Div: (FACTOR, ast.Mult()),
    ast.FloorDiv: (FACTOR, ast.Mult()),
    ast.Mod: (FACTOR, ast.Mult()),
    ast.Pow: (FACTOR, ast.Mult()),
    ast.LShift: (FACTOR, ast.RShift()),
    ast.RShift: (FACTOR, ast.LShift()),
    ast.BitAnd: (DECISION, ast.BitOr()),
    ast.BitOr: (DECISION, ast.BitAnd()),
    ast.BitXor: (DECISION, ast.BitOr()),
}
COMPARISONS: dict[type[ast.cmpop], tuple[tuple[str, ast.cmpop], ...]] = {
    ast.Lt: ((BOUNDARY, ast.LtE()), (TURNED, ast.GtE())),
    ast.LtE: ((BOUNDARY, ast.Lt()), (TURNED, ast.Gt())),
    ast.Gt: ((BOUNDARY, ast.GtE()), (TURNED, ast.LtE())),
    ast.GtE: ((BOUNDARY, ast.Gt()), (TURNED, ast.Lt())),
    ast.Eq: ((TURNED, ast.NotEq()),),
    ast.NotEq: ((TURNED, ast.Eq()),),
    ast.In: ((TURNED, ast.NotIn()),),
    ast.NotIn: ((TURNED, ast.In()),),
    ast.Is: ((TURNED, ast.IsNot()),),
    ast.IsNot: ((TURNED, ast.Is()),),
}
PAIRS = (
    ("sin", "cos"),
    ("min", "max"),
    ("minimum", "maximum"),
    ("floor", "ceil"),
    ("any", "all"),
    ("argmin", "argmax"),
)
NAMES = dict(PAIRS) | {after: before for before, after in PAIRS}
TEXTS = {"NFC": "NFKC", "big": "little", "little": "big"}
TIMED_OUT = "timed out"
"""An outcome that counts as detected, and is tried again by a later run: the host may have been busy."""
MOST_BYTES = 4 << 30
"""Memory of a child: a loop that no longer ends may fill a list until its time is over."""
PARTS = (ast.operator, ast.cmpop, ast.boolop, str)
"""Nodes without a text of their own: the whole expression is shown."""
MULTIPLIES = (ast.Mult, ast.Div, ast.FloorDiv, ast.Mod, ast.Pow, ast.LShift, ast.RShift)
NO_DECISION = {"strict", "frozen", "slots", "kw_only", "repr", "compare"}
"""Keywords that guard against a programmer's slip and decide nothing in correct code."""


@dataclass
class Mutant:
    """One change of a syntax tree; `put(True)` makes it, `put(False)` takes it back."""

    line: int
    group: str
    change: str
    put: Callable[[bool], None]


class Finder:
    """All mutants of one module's tree, in the order of its text."""

    def __init__(self) -> None:
        self.found: list[Mutant] = []

    def offer(self, holder: ast.AST, name: str, index: int | None, group: str, new: object) -> None:
        """Keep the change of `holder.name` (or of its element `index`) to `new`."""
        old = getattr(holder, name) if index is None else getattr(holder, name)[index]

        def put(changed: bool) -> None:
            value = new if changed else old
            if index is None:
                setattr(holder, name, value)
            else:
                getattr(holder, name)[index] = value

        line_of = next(n for n in (old, holder, *ast.walk(holder)) if hasattr(n, "lineno"))
        before = ast.unparse(holder if isinstance(old, PARTS) else old)
        if isinstance(new, ast.AST) and not isinstance(new, PARTS):
            ast.fix_missing_locations(ast.copy_location(new, line_of))
        put(True)
        after = ast.unparse(holder if isinstance(old, PARTS) else new)  # type: ignore[arg-type]
        put(False)
        self.found.append(Mutant(line_of.lineno, group, f"{before} → {after}"[:150].replace("\n", " "), put))

    def walk(self, node: ast.AST, factor: bool = False) -> None:
        """factor: the children are operands of a product or a power."""
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params", "format_spec", "exc", "type_comment"):
                continue
            if isinstance(node, ast.keyword) and node.arg in NO_DECISION:
                continue
            for index, child in enumerate(value) if isinstance(value, list) else ((None, value),):
                if isinstance(child, ast.AST):
                    self.node(node, name, index, child, factor)

    def node(self, holder: ast.AST, name: str, index: int | None, node: ast.AST, factor: bool) -> None:
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            return
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return
        self.in_place(node)
        self.conditions(node)

        def offer(group: str, new: object) -> None:
            self.offer(holder, name, index, group, new)

        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            offer(SIGN if isinstance(node.op, ast.USub) else DECISION, node.operand)
        elif isinstance(node, ast.Constant):
            self.constant(node, factor, offer)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "abs":
            offer(SIGN, node.args[0])
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            offer(CALL, ast.Pass())
        self.walk(node, factor=isinstance(node, ast.BinOp) and isinstance(node.op, MULTIPLIES))

    def in_place(self, node: ast.AST) -> None:
        """Changes of an operator or a name within a node."""
        if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS and not _joins_text(node):
            self.offer(node, "op", None, *OPERATORS[type(node.op)])
        elif isinstance(node, ast.BoolOp):
            self.offer(node, "op", None, DECISION, ast.Or() if isinstance(node.op, ast.And) else ast.And())
        elif isinstance(node, ast.Compare):
            for i, comparison in enumerate(node.ops):
                for group, other in COMPARISONS[type(comparison)]:
                    self.offer(node, "ops", i, group, other)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
            field = "id" if isinstance(node, ast.Name) else "attr"
            if getattr(node, field) in NAMES:
                self.offer(node, field, None, SWAP, NAMES[getattr(node, field)])

    def conditions(self, node: ast.AST) -> None:
        """A condition that is a plain value or call turned over; comparisons and the like change in place."""
        changed_elsewhere = ast.Compare | ast.BoolOp | ast.UnaryOp | ast.Constant
        test = getattr(node, "test", None)
        if test is not None and not isinstance(test, changed_elsewhere):
            self.offer(node, "test", None, DECISION, ast.UnaryOp(ast.Not(), test))
        for i, one in enumerate(getattr(node, "ifs", ())):
            if not isinstance(one, changed_elsewhere):
                self.offer(node, "ifs", i, DECISION, ast.UnaryOp(ast.Not(), one))

    @staticmethod
    def constant(node: ast.Constant, factor: bool, offer: Callable[[str, object], None]) -> None:
        value = node.value
        if isinstance(value, bool):
            offer(DECISION, ast.Constant(not value))
        elif isinstance(value, int | float):
            changed = value + 1 if isinstance(value, int) else value * 1.1 or 1.0
            offer(FACTOR if factor else NUMBER, ast.Constant(changed))
        elif isinstance(value, str) and value in TEXTS:
            offer(DECISION, ast.Constant(TEXTS[value]))


def _joins_text(node: ast.BinOp | ast.AugAssign) -> bool:
    sides = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.value,)
    return any(
        isinstance(s, ast.JoinedStr) or (isinstance(s, ast.Constant) and isinstance(s.value, str)) for s in sides
    )


def mutants_of(path: Path) -> tuple[ast.Module, list[tuple[str, Mutant]]]:
    """The tree of a module, and its mutants, each with a key that other changes of the file do not move."""
    tree, finder, seen = ast.parse(path.read_text()), Finder(), Counter[str]()
    finder.walk(tree)
    keyed = []
    for mutant in finder.found:
        text = f"{path.relative_to(ROOT)}: [{mutant.group}] {mutant.change}"
        seen[text] += 1
        keyed.append((f"{text} #{seen[text]}", mutant))
    return tree, keyed


class FromTree(importlib.machinery.SourceFileLoader):
    """Imports one module from a syntax tree, every other as always."""

    def __init__(self, name: str, path: Path, tree: ast.Module) -> None:
        super().__init__(name, str(path))
        self.tree = tree

    def find_spec(self, name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def get_code(self, fullname: str) -> object:  # type: ignore[override]
        return compile(self.tree, self.path, "exec", dont_inherit=True)


class FewExamples:
    """pytest plugin: hypothesis tries no more than 20 examples of any test."""

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        from hypothesis import settings  # noqa: PLC0415

        for item in items:
            function: Any = getattr(item.obj, "__func__", item.obj)
            own = getattr(function, "_hypothesis_internal_use_settings", None)
            if own is not None and own.max_examples > 20:
                function._hypothesis_internal_use_settings = settings(own, max_examples=20)


def run_tests(tests: tuple[str, ...], plugins: tuple[object, ...] = (), *, quick: bool = False) -> int:
    """pytest over `tests` in this process, first failure ends it, no shrinking of what hypothesis finds."""
    from hypothesis import HealthCheck, Phase, settings  # noqa: PLC0415

    plugins = (*plugins, FewExamples()) if quick else plugins

    plain: dict[str, Any] = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}
    settings.register_profile("mutants", derandomize=True, phases=[Phase.explicit, Phase.generate], **plain)
    settings.load_profile("mutants")
    late = "ignore::pytest.PytestAssertRewriteWarning"  # hypothesis is loaded before pytest here
    options = ["-W", late, "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--tb=no"]
    return int(pytest.main([*options, *tests], plugins=list(plugins)))


def child(work: Callable[[], int]) -> int:
    """Fork; the process id of a child that is silent, leads its own group and ends with work()'s status."""
    pid = os.fork()
    if pid:
        return pid
    status = 70
    try:
        os.setsid()
        quiet = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(quiet, stream)
        resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))
        status = work()
    except BaseException:  # noqa: BLE001  (nothing may return into the parent's code)
        traceback.print_exc()
    finally:
        os._exit(status)


def warm_up(tests: tuple[str, ...], quick: bool) -> float:
    """Check that the tests pass as things are, load here what they load from elsewhere; the seconds they take."""
    kept = Path(os.environ["PYTEST_DEBUG_TEMPROOT"]) / "loaded.pickle"

    def work() -> int:
        status = run_tests(tests, quick=quick)
        kept.write_bytes(pickle.dumps([(n, getattr(m, "__file__", None)) for n, m in sys.modules.items()]))
        return status

    warnings.simplefilter("ignore")  # what a library says of being loaded early
    for _ in range(2):  # the second time counts: with everything loaded
        began = time.monotonic()
        if os.waitstatus_to_exitcode(os.waitpid(child(work), 0)[1]) != 0:
            raise SystemExit(f"the tests do not pass unchanged: {' '.join(tests)}")
        loaded = pickle.loads(kept.read_bytes())
        kept.unlink()
        for name, file in loaded:
            if file and "site-packages" in file and not name.startswith(("xdist", "_pytest", "pytest", "__editable__")):
                try:
                    importlib.import_module(name)
                except Exception:  # noqa: BLE001  (an optional part of a library; the child loads it itself)
                    continue
    return time.monotonic() - began


class Children:
    """So many processes at a time, each with a time limit; `ended` says which are done."""

    def __init__(self, jobs: int, limit_s: float) -> None:
        self.jobs, self.limit_s = jobs, limit_s
        self.running: dict[int, tuple[str, Mutant, float]] = {}

    def start(
        self, key: str, mutant: Mutant, work: Callable[[], int], limit_s: float | None = None
    ) -> Iterator[tuple[str, Mutant, str]]:
        while len(self.running) >= self.jobs:
            yield from self.ended()
        self.running[child(work)] = (key, mutant, time.monotonic() + (self.limit_s if limit_s is None else limit_s))

    def ended(self) -> Iterator[tuple[str, Mutant, str]]:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid in self.running:
            key, mutant, _ = self.running.pop(pid)
            yield key, mutant, TIMED_OUT if os.WIFSIGNALED(status) else "survived" if status == 0 else "killed"
        for late in [p for p, (_, _, until) in self.running.items() if time.monotonic() > until]:
            os.killpg(late, signal.SIGKILL)
        if not pid:
            time.sleep(0.005)

    def rest(self) -> Iterator[tuple[str, Mutant, str]]:
        while self.running:
            yield from self.ended()


@dataclass(eq=False)
class Trial:
    """What is tried in a room: the mutants `chosen`, by key, but those whose outcome is `known`; quick: see the module's text."""

    chosen: set[str]
    known: dict[str, str]
    children: Children
    quick: bool

    def open(self, key: str) -> bool:
        """Whether a mutant is to be tried."""
        return key in self.chosen and key not in self.known


def functions_of(code: types.CodeType) -> dict[tuple[str, int], types.CodeType]:
    """Code of a module's functions and methods by qualified name and line; what is inside them goes with them."""
    found = {}
    for one in code.co_consts:
        if isinstance(one, types.CodeType):
            if one.co_flags & inspect.CO_OPTIMIZED:
                found[one.co_qualname, one.co_firstlineno] = one
            else:  # a class
                found |= functions_of(one)
    return found


Place = tuple[str, str, int]
"""File, qualified name and first line of a function."""


@dataclass(eq=False)
class Called:
    """pytest plugin: which functions of some files each test calls, and each file's tests while they are prepared; the time of each,
    s."""

    files: set[str]
    took_s: dict[str, float] = field(default_factory=dict)
    by_test: dict[str, set[Place]] = field(default_factory=dict)
    by_file: dict[str, set[Place]] = field(default_factory=dict)
    now: set[Place] = field(default_factory=set)

    def _note(self, frame: types.FrameType, event: str, _argument: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename in self.files:
            self.now.add((code.co_filename, code.co_qualname, code.co_firstlineno))

    def _into(self, places: set[Place]) -> Iterator[None]:
        self.now = places
        threading.setprofile(self._note)
        sys.setprofile(self._note)
        try:
            yield
        finally:
            sys.setprofile(None)
            threading.setprofile(None)  # type: ignore[arg-type]

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_setup(self, item: Any) -> Iterator[None]:
        yield from self._into(self.by_file.setdefault(str(item.path), set()))

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_call(self, item: Any) -> Iterator[None]:
        began = time.monotonic()
        yield from self._into(self.by_test.setdefault(item.nodeid, set()))
        self.took_s[item.nodeid] = time.monotonic() - began


@dataclass(eq=False)  # pytest keeps plugins in sets
class InPlace:
    """pytest plugin: with all tests collected, each mutant of a function's body gets a fork in which the function has its new code.

    Ten times as quick as importing everything anew. What survives here, and what is no function's body, is tried by `try_all`.
    """

    paths: list[Path]
    trial: Trial
    kept: Path
    took_s: dict[str, float] = field(default_factory=dict)

    def pytest_runtestloop(self, session: Any) -> bool:
        from _pytest.main import pytest_runtestloop  # noqa: PLC0415  (the parent has loaded it before the fork)

        live: dict[tuple[str, str, int], list[types.FunctionType]] = {}
        for one in gc.get_objects():
            if type(one) is types.FunctionType:  # not isinstance: that asks an object for its class, and some raise
                code = one.__code__
                live.setdefault((code.co_filename, code.co_qualname, code.co_firstlineno), []).append(one)

        touching = self.touching(session)
        known: dict[str, str] = {}
        tests_of: dict[str, list[str]] = {}

        def note(outcomes: Iterator[tuple[str, Mutant, str]]) -> None:
            sure = ("killed", "survived", TIMED_OUT) if self.trial.quick else ("killed",)
            known.update((key, outcome) for key, _, outcome in outcomes if outcome in sure and tests_of[key])

        def work(swaps: list[tuple[types.FunctionType, types.CodeType]], tests: set[str]) -> int:
            for function, code in swaps:
                function.__code__ = code
            session.items = [item for item in session.items if item.nodeid in tests]
            try:
                pytest_runtestloop(session)
            except (session.Failed, session.Interrupted):
                return 1
            return 1 if session.testsfailed else 0

        for path in self.paths:
            tree, found = mutants_of(path)
            plain = functions_of(compile(tree, str(path), "exec", dont_inherit=True))
            for key, mutant in found:
                if not self.trial.open(key):
                    continue
                mutant.put(True)
                changed = functions_of(compile(tree, str(path), "exec", dont_inherit=True))
                mutant.put(False)
                swaps = [
                    (function, code)
                    for place, code in changed.items()
                    if code != plain[place]
                    for function in live.get((str(path), *place), [])
                    if code.co_freevars == function.__code__.co_freevars
                ]
                if swaps:
                    places = [place for place, code in changed.items() if code != plain[place]]
                    tests = set().union(*(touching.get((str(path), *place), set()) for place in places))
                    tests_of[key] = [item.nodeid for item in session.items if item.nodeid in tests]
                    limit_s = 5.0 + 5.0 * sum(
                        self.took_s.get(test, 1.0) for test in tests
                    )  # a thread may wait for ever
                    one = partial(work, swaps, tests)
                    note(self.trial.children.start(key, mutant, one, limit_s))
        note(self.trial.children.rest())
        tests_of[""] = [item.nodeid for item in session.items]
        self.kept.write_bytes(pickle.dumps((known, tests_of)))
        return True

    def touching(self, session: Any) -> dict[Place, set[str]]:
        """The tests that call each function of the modules. What the preparation of a test calls is put down to all tests of its file,
        as they may share what was prepared. Puts the quickest files and tests first, if they pass so."""
        from _pytest.main import pytest_runtestloop  # noqa: PLC0415  (as above)

        called = Called({str(path) for path in self.paths})

        def work() -> int:
            session.config.pluginmanager.register(called)
            pytest_runtestloop(session)
            self.kept.write_bytes(pickle.dumps((called.by_test, called.by_file, called.took_s)))
            return 0

        os.waitpid(child(work), 0)
        by_test, by_file, self.took_s = pickle.loads(self.kept.read_bytes())
        in_file = Counter[str]()
        for item in session.items:
            in_file[str(item.path)] += self.took_s.get(item.nodeid, 0.0)
        quick_first = sorted(
            session.items, key=lambda item: (in_file[str(item.path)], str(item.path), self.took_s.get(item.nodeid, 0.0))
        )

        def unchanged() -> int:
            session.items = quick_first
            pytest_runtestloop(session)
            return 1 if session.testsfailed else 0

        if os.waitstatus_to_exitcode(os.waitpid(child(unchanged), 0)[1]) == 0:
            session.items = quick_first
        found: dict[Place, set[str]] = {}
        for item in session.items:
            for place in by_test.get(item.nodeid, set()) | by_file.get(str(item.path), set()):
                found.setdefault(place, set()).add(item.nodeid)
        return found


def killed_in_place(paths: list[Path], tests: tuple[str, ...], trial: Trial) -> dict[str, list[str]]:
    """Adds outcomes to those known; the tests that can notice each mutant of a function's body, by "" all, the quickest first."""
    kept = Path(os.environ["PYTEST_DEBUG_TEMPROOT"]) / "killed.pickle"
    plugin = InPlace(paths, trial, kept)
    os.waitpid(child(lambda: run_tests(tests, (plugin,), quick=trial.quick)), 0)
    found, tests_of = pickle.loads(kept.read_bytes())
    kept.unlink()
    trial.known.update(found)
    return tests_of  # type: ignore[no-any-return]


def try_all(path: Path, tests_of: dict[str, list[str]], trial: Trial) -> Iterator[tuple[str, Mutant, str]]:
    """(key, mutant, outcome) of every chosen mutant of one module, imported anew where the outcome is not known.

    tests_of: the tests that can notice a mutant, where that is known; those of "" for others."""
    tree, found = mutants_of(path)
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")

    def work(tests: tuple[str, ...]) -> int:
        sys.meta_path.insert(0, FromTree(name, path, tree))  # type: ignore[arg-type]
        return run_tests(tests, quick=trial.quick)

    for key, mutant in found:
        if trial.open(key):
            mutant.put(True)
            those = tuple(tests_of.get(key) or tests_of[""])
            yield from trial.children.start(key, mutant, lambda those=those: work(those))  # type: ignore[misc]
            mutant.put(False)
        elif key in trial.chosen:
            yield key, mutant, trial.known[key]
    yield from trial.children.rest()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=f"of {', '.join(ROOMS)}; all where none is named")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, help="outcomes, kept and taken up again")
    parser.add_argument("--all", action="store_true", help="try again what was killed before")
    parser.add_argument("--quick", action="store_true", help="what survives in place is not imported anew")
    parser.add_argument("--sample", type=int, default=0, help="so many mutants of each room, 0 for all")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--only", default="", help="only modules whose path contains this")
    given = parser.parse_args()
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    os.chdir(ROOT)
    with tempfile.TemporaryDirectory() as directory:  # what the tests leave, and what children tell
        os.environ["PYTEST_DEBUG_TEMPROOT"] = directory
        run(given)


def run(given: argparse.Namespace) -> None:
    outcomes: dict[str, str] = {}
    if given.json and given.json.exists():
        outcomes = json.loads(given.json.read_text())
    known = {} if given.all else {key: outcome for key, outcome in outcomes.items() if outcome == "killed"}
    rows: list[tuple[str, Counter[str], Counter[str]]] = []
    survivors: list[str] = []
    for name in given.rooms or ROOMS:
        room = ROOMS[name]
        children = Children(given.jobs, 10.0 + 4.0 * warm_up(room.tests, given.quick))
        found = {pattern: sorted(ROOT.glob(pattern)) for pattern in room.modules}
        if gone := [pattern for pattern, paths in found.items() if not paths]:
            raise SystemExit(f"room {name}: no module {', '.join(gone)}")
        paths = sorted(path for several in found.values() for path in several if given.only in str(path))
        chosen = [key for path in paths for key, _ in mutants_of(path)[1]]
        if given.sample and given.sample < len(chosen):
            chosen = random.Random(given.seed).sample(chosen, given.sample)
        trial = Trial(set(chosen), known, children, given.quick)
        tests_of = killed_in_place(paths, room.tests, trial)
        for path in paths:
            every, left = Counter[str](), Counter[str]()
            present = {key for key, _ in mutants_of(path)[1]}
            outcomes = {
                k: v for k, v in outcomes.items() if k in present or not k.startswith(f"{path.relative_to(ROOT)}: ")
            }
            for key, mutant, outcome in try_all(path, tests_of, trial):
                every[mutant.group] += 1
                outcomes[key] = outcome
                if outcome == "survived":
                    left[mutant.group] += 1
                    survivors.append(key.replace(": ", f":{mutant.line}: ", 1))
            if every:
                rows.append((str(path.relative_to(ROOT)), every, left))
                print(
                    f"{rows[-1][0]}: {every.total() - left.total()} of {every.total()} killed",
                    file=sys.stderr,
                    flush=True,
                )
            if given.json:
                given.json.write_text(json.dumps(outcomes, indent=0, ensure_ascii=False))
    print_table(rows, survivors)


def print_table(rows: list[tuple[str, Counter[str], Counter[str]]], survivors: list[str]) -> None:
    """Markdown: per module mutants, killed, score and survivors of each group; then each survivor."""
    print("| module | mutants | killed | % |", " | ".join(GROUPS), "|\n|---|" + "---:|" * (3 + len(GROUPS)))
    whole = ("all", sum((r[1] for r in rows), Counter[str]()), sum((r[2] for r in rows), Counter[str]()))
    for name, every, left in (*rows, whole):
        mutants, killed = every.total(), every.total() - left.total()
        counts = " | ".join(str(left[g] or "") for g in GROUPS)
        print(f"| {name} | {mutants} | {killed} | {100 * killed / max(mutants, 1):.0f} | {counts} |")
    print("\nSurvivors:")
    for key in survivors:
        print(f"- {key}")


if __name__ == "__main__":
    main()
