"""Work in a process of its own: its answer, its errors, its end, and one at a time."""

import inspect
import json
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest

from hil.desk.error_log import ErrorLog
from hil.desk.worker_process import Computed, ComputingError, Passes, Work, WorkerProcess
from hil.diagnosis.page import DIAGNOSE
from hil.report.job import COMPARE, HISTORY, REPORT

ECHO = "import json, sys; json.dump({'made': [json.load(sys.stdin)['work'], sys.argv[1]]}, sys.stdout)"
REFUSES = "import json, sys; sys.stdin.read(); print(json.dumps({'error': 'holds no rows'})); sys.exit(1)"
CRASHES = "import sys; sys.stdin.read(); sys.exit('no memory left')"
NEVER_ENDS = "import sys, threading; sys.stdin.read(); threading.Event().wait()"


@pytest.fixture
def log(tmp_path: Path) -> ErrorLog:
    return ErrorLog(tmp_path / "errors.log")


def aside(text: str, errors: ErrorLog | None = None) -> WorkerProcess:
    return WorkerProcess(Path("X.toml"), errors or ErrorLog(Path("errors.log")), (sys.executable, "-c", text))


def ended(one: WorkerProcess) -> Computed:
    give_up_s = time.monotonic() + 30.0
    while one.computed.running:
        assert time.monotonic() < give_up_s, "it has not ended"
        time.sleep(0.005)
    return one.computed


def test_what_was_made_is_told() -> None:
    one = aside(ECHO)
    assert one.computed == Computed()
    one.start({"work": "history"})
    assert one.computed.number == 1
    done = ended(one)
    assert (done.running, done.work, done.made, done.error) == (False, "history", ("history", "X.toml"), "")
    one.start({"work": "again"})
    assert ended(one).number == 2


@pytest.mark.parametrize(
    ("text", "said"), [(REFUSES, "holds no rows"), (CRASHES, "no memory left")], ids=["refuses", "crashes"]
)
def test_what_went_wrong_is_told_in_one_line(text: str, said: str) -> None:
    one = aside(text)
    one.start({"work": "diagnose"})
    assert ended(one).error == said


def test_a_mistake_of_the_program_leaves_its_traceback_in_a_file(log: ErrorLog) -> None:
    one = aside("import sys; sys.stdin.read(); 1 / 0", log)
    one.start({"work": "diagnose"})
    assert ended(one).error == f"ZeroDivisionError: division by zero; the traceback is in {log.path}"
    assert "Traceback (most recent call last)" in log.path.read_text()


def test_an_answer_that_nobody_foresaw_is_an_error_and_not_computed_for_ever(log: ErrorLog) -> None:
    one = aside("import sys; sys.stdin.read(); print('{\"made\": 7}')", log)
    one.start({"work": "history"})
    done = ended(one)
    assert (done.running, done.made) == (False, ())
    assert done.error.startswith("TypeError: ")
    assert done.error.endswith(f"; the traceback is in {log.path}")


def test_one_at_a_time_and_it_can_be_given_up() -> None:
    one = aside(NEVER_ENDS)
    one.start({"work": "diagnose"})
    with pytest.raises(ComputingError, match="diagnose"):
        one.start({"work": "report"})
    assert one.computed.running
    one.close()
    assert (one.computed.running, one.computed.error) == (False, "cancelled")


def test_the_request_is_plain_json() -> None:
    asked = Work("report", "a.b:c").request([Passes("before", (Path("a.csv"), Path("b.csv")))])
    assert json.loads(json.dumps(asked)) == asked
    assert asked == {"work": "report", "function": "a.b:c", "campaigns": [["before", ["a.csv", "b.csv"]]]}


@pytest.mark.parametrize("work", [DIAGNOSE, REPORT, COMPARE, HISTORY], ids=lambda work: work.name)
def test_the_function_of_each_computation_is_there(work: Work) -> None:
    module, _, name = work.function.partition(":")
    assert list(inspect.signature(getattr(import_module(module), name)).parameters)[:1] == ["axis"]
