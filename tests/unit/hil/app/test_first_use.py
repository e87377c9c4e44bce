"""What a person meets at the first use: passwords, the end of the input, JSON on standard output, tables in a narrow pipe."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.bench_axis import lay_out

from drivers.errors import InputError
from hil.app import main as terminal
from hil.axis.axis_file import load_axis
from hil.axis.identity import identity
from hil.correction.sealed import Binding, WrongKeyPasswordError, WrongPasswordError
from hil.doctor.procedure import Check
from hil.ui.terminal.axis_options import tell_bench
from hil.ui.terminal.options import KEY, READING
from hil.ui.terminal.output import binding_facts, print_table, write_json
from hil.ui.terminal.passwords import MEANING, password, password_source


class Keyboard:
    """A terminal at which nothing but these lines is typed; then the input ends."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
        self.lines = list(lines)
        monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
        monkeypatch.setattr("getpass.getpass", self.typed)

    def typed(self, _prompt: str) -> str:
        if not self.lines:
            raise EOFError
        return self.lines.pop(0)


@pytest.fixture(autouse=True)
def _no_stdin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", argparse.Namespace(isatty=lambda: False))


@pytest.mark.parametrize(("variable", "what"), [(READING, "reading password"), (KEY, "builder key's password")])
def test_a_password_that_is_asked_for_says_what_it_is_for(
    variable: str, what: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Keyboard(monkeypatch, "a long enough one")
    assert password(None, variable, what, {}) == "a long enough one"
    assert MEANING[variable] in capsys.readouterr().err


def test_a_new_password_is_asked_for_twice_with_what_it_has_to_be(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Keyboard(monkeypatch, "a long enough one", "a long enough other")
    with pytest.raises(InputError, match="differ"):
        password(None, READING, "reading password", {}, new=True)
    assert "at least 15 characters" in capsys.readouterr().err


@pytest.mark.parametrize("variable", [READING, KEY])
def test_a_password_that_is_chosen_now_is_not_said_to_have_been_chosen(
    variable: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Keyboard(monkeypatch, "a long enough one", "a long enough one")
    assert password(None, variable, "password of the new key", {}, new=True) == "a long enough one"
    told = capsys.readouterr().err
    assert "will open" in told
    assert "chosen with" not in told
    assert "whoever made them" not in told


def test_a_new_password_that_is_too_short_is_refused_before_it_is_asked_for_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    Keyboard(monkeypatch, "short")
    with pytest.raises(InputError, match="has 5 characters, 5 of them different: expected at least 15"):
        password(None, KEY, "password of the new key", {}, new=True)
    Keyboard(monkeypatch, "short", "short")  # of entries that exist, which are sealed again with the password they have
    assert password(None, READING, "reading password", {}, new=True) == "short"


def test_a_wrong_password_says_where_it_was_taken_from() -> None:
    """The environment goes before the file that the axis file names: without this nobody would look for it there."""
    args = {"axis": "x.toml", "password_file": None, "key_password_file": None}
    reading, key, both = WrongPasswordError("wrong"), WrongKeyPasswordError("wrong"), {READING: "a", KEY: "b"}

    def told(error: InputError, environment: dict[str, str], **more: object) -> str:
        return password_source(error, argparse.Namespace(**(args | more)), environment)

    assert "that of HIL_PASSWORD in the environment, which goes before password_file of an axis file" in told(
        reading, both
    )
    assert "that of HIL_KEY_PASSWORD in the environment" in told(key, both)
    assert told(reading, both, password_file="p") == "; the password is that of --password-file p"
    assert "that of password_file of x.toml" in told(reading, {KEY: "b"})
    assert not told(InputError("wrong"), both)
    assert not told(reading, both, table_password=["pitch=p"])


def test_the_line_of_a_wrong_key_password_names_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setenv(KEY, "a long enough one")
    assert terminal.main(["sign", "--new-key", str(tmp_path / "builder")]) == 0
    monkeypatch.setenv(KEY, "another long one")
    capsys.readouterr()
    assert terminal.main(["sign", str(tmp_path / "builder.pub"), "--key", str(tmp_path / "builder.key")]) == 2
    assert "the password is that of HIL_KEY_PASSWORD in the environment" in capsys.readouterr().err


def test_the_end_of_the_input_at_a_password_says_what_happened(monkeypatch: pytest.MonkeyPatch) -> None:
    Keyboard(monkeypatch)
    with pytest.raises(InputError, match=r"ended at its prompt \(Ctrl-D\); nothing was moved or written"):
        password(None, READING, "reading password", {})


def test_the_axis_files_password_comes_after_those_that_are_given(tmp_path: Path) -> None:
    (tmp_path / "usual").write_text("of the bench\n")
    (tmp_path / "given").write_text("given\n")
    usual = tmp_path / "usual"
    assert password(None, READING, "reading password", {}, usual=usual) == "of the bench"
    assert password(None, READING, "reading password", {READING: "from the shell"}, usual=usual) == "from the shell"
    assert password(str(tmp_path / "given"), READING, "reading password", {READING: "x"}, usual=usual) == "given"


def _verb(monkeypatch: pytest.MonkeyPatch, run: object) -> None:
    def build(_argv: object) -> argparse.ArgumentParser:
        parser = argparse.ArgumentParser()
        parser.add_argument("--json")
        parser.set_defaults(run=run)
        return parser

    monkeypatch.setattr(terminal, "build_parser", build)


def test_a_question_that_the_input_ends_at_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ask(_args: argparse.Namespace) -> int:
        raise EOFError

    _verb(monkeypatch, ask)
    assert terminal.main([]) == terminal.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert "Ctrl-D" in line


def test_json_alone_is_on_standard_output(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def work(args: argparse.Namespace) -> int:
        print("words")
        print_table(["figure", "µm"], [["A", "1.00"]])
        write_json(args.json, {"A_um": 1.0})
        return 0

    _verb(monkeypatch, work)
    assert terminal.main(["--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == {"A_um": 1.0}
    assert "words" in err
    assert "1.00" in err
    assert not Path("-").exists()


def test_a_dry_run_gives_its_plan_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    verbs = [["verify", "--seed", "3"], ["calibrate"], ["backlash"], ["lost-motion"], ["doctor"]]
    axis = str(lay_out(tmp_path / "axis"))
    monkeypatch.delenv("HIL_PASSWORD", raising=False)
    for verb, *options in verbs:
        assert terminal.main([verb, axis, *options, "--dry-run", "--json", str(tmp_path / "plan.json")]) == 0
        printed = capsys.readouterr().out
        told = json.loads((tmp_path / "plan.json").read_text())
        assert told == {"dry_run": True, "plan": [line for line in printed.splitlines() if line.strip()]}
        assert "would" in printed
    assert terminal.main(["verify", axis, "--dry-run", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["dry_run"] is True


def test_a_table_in_a_pipe_keeps_to_columns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [
        ["zero", "homing method 1 to 0 mm, which seeks the negative limit switch and the index pulse beside it " * 2]
    ]
    for columns in (60, 100):
        monkeypatch.setenv("COLUMNS", str(columns))
        print_table(["check", ("found", "left")], rows)
        widest = max(map(len, capsys.readouterr().out.splitlines()))
        assert 0.8 * columns <= widest <= columns
    monkeypatch.delenv("COLUMNS")
    print_table(["check", ("found", "left")], rows)
    assert max(map(len, capsys.readouterr().out.splitlines())) > 100


def test_what_a_sealed_file_is_bound_to_is_said_in_words() -> None:
    drive = {"vendor": 1249, "product": 1026, "serial": 7}
    zero = {"made": "2026-11-25T16:38:14+00:00", "drive": drive}
    axes = {
        "X": {"zero": zero, "made_with": {"backlash": {}, "units": {"608Fh:01": 1e6, "608Fh:02": 1.0}}},
        "Y": {},
        "Z": {"zero": [1]},
    }
    facts = binding_facts(Binding(3, "2026-11-26T08:00:00+00:00", {"axes": axes}))
    assert facts["bound to X"] == (
        "the zero of 2026-11-25T16:38:14+00:00, the drive with vendor 1249, product 1026, serial 7,"
        " 2 settings of the drive as they were"
    )
    assert facts["bound to Y"] == facts["bound to Z"] == "no zero and no drive"
    assert "{" not in "".join(facts.values())


def test_the_bench_says_that_it_forgets_what_was_written_and_a_drive_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axis = load_axis(lay_out(tmp_path / "axis"))
    tell_bench(axis)
    assert "the next one does not find what was written" in capsys.readouterr().out
    tell_bench(replace(axis, drive=replace(axis.drive, backend="canopen")))
    assert not capsys.readouterr().out


def test_a_drive_on_modbus_is_named_by_its_unit_in_a_report(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path / "axis"))
    modbus = replace(axis.drive, backend="modbus", unit=5, url="tcp://h:502", register_map="leadshine_el7")
    said = identity(replace(axis, drive=modbus))["Drive"]
    assert said == "Modbus unit 5 on tcp://h:502, leadshine_el7"


def test_a_risk_is_not_called_good() -> None:
    assert Check("zero", True, "…", True).verdict == "RISK"
    assert Check("note", True, "…").verdict == "note"
    assert Check("zero", False, "…", True).verdict == "NOT GOOD"
    assert Check("zero", True, "…").verdict == "good"
