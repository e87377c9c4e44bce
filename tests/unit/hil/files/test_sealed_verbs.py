"""`hil sign`, `seal`, `open` and `check` as a user sees them."""

from __future__ import annotations

import argparse
import io
import json
import re
from pathlib import Path

import pytest

from drivers.errors import InputError
from hil.correction.sealed import DamagedError, ForeignSignatureError, WrongPasswordError, load_private_key
from hil.correction.sealed import seal as sealed_bytes
from hil.files.command_options import add_check, add_open, add_seal, add_sign


def call(*argv: str) -> int:
    parser = argparse.ArgumentParser(prog="hil")
    subparsers = parser.add_subparsers(required=True)
    for add_verb in (add_seal, add_open, add_sign, add_check):
        add_verb(subparsers)
    args = parser.parse_args(argv)
    code: int = args.run(args)
    return code


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory with two tables and a key pair, and the passwords in the environment; no keyboard."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HIL_PASSWORD", "reading of the tables")
    monkeypatch.setenv("HIL_KEY_PASSWORD", "building of the tables")
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    Path("pitch.json").write_text('{"pitch": 1}')
    Path("backlash.json").write_text('{"backlash": 2}')
    assert call("sign", "--new-key", "builder") == 0
    return tmp_path


def test_seal_check_open(place: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    assert call("seal", "pitch.json", "backlash.json", "--out", "axis.sealed", "--key", "builder.key") == 0
    assert call("check", "axis.sealed", "--builder", "builder.pub", "--json", "check.json") == 0
    facts = json.loads(Path("check.json").read_text())
    assert facts["good"] is True
    assert facts["entries"] == {"pitch.json": 12, "backlash.json": 15}
    capfdbinary.readouterr()
    assert call("open", "axis.sealed", "--builder", "builder.pub", "--entry", "pitch.json") == 0
    assert capfdbinary.readouterr().out == b'{"pitch": 1}'
    assert call("open", "axis.sealed", "--builder", "builder.pub", "--out", "out", "--json", "open.json") == 0
    assert Path("out/backlash.json").read_text() == '{"backlash": 2}'
    assert json.loads(Path("open.json").read_text())["entries"]["pitch.json"]["written"] == "out/pitch.json"
    with pytest.raises(InputError, match="exists already; --force"):
        call("open", "axis.sealed", "--builder", "builder.pub", "--out", "out")
    assert call("open", "axis.sealed", "--builder", "builder.pub", "--out", "out", "--force") == 0


def test_check_and_open_print_the_header(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("seal", "pitch.json", "--out", "axis.sealed", "--key", "builder.key") == 0
    assert call("seal", "backlash.json", "--out", "axis.sealed", "--key", "builder.key", "--update") == 0
    capsys.readouterr()
    assert call("check", "axis.sealed", "--builder", "builder.pub", "--json", "check.json") == 0
    shown = capsys.readouterr().out
    assert re.search(r"counter +2\n", shown)
    assert re.search(r"resealed +20\d\d-", shown)
    assert re.search(r"bound to +nothing\n", shown)
    assert json.loads(Path("check.json").read_text())["binding"]["counter"] == 2
    assert call("open", "axis.sealed", "--builder", "builder.pub", "--entry", "pitch.json", "--json", "open.json") == 0
    assert "counter: 2\n" in capsys.readouterr().err
    assert json.loads(Path("open.json").read_text())["binding"]["of"] == {}


def test_individual_passwords_and_update(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("own.txt").write_text("own secret of the pitch\n")
    seal_both = ["seal", "pitch.json", "backlash.json", "--out", "axis.sealed", "--key", "builder.key"]
    assert call(*seal_both, "--entry-password", "pitch.json=own.txt") == 0
    read_pitch = ["open", "axis.sealed", "--builder", "builder.pub", "--entry", "pitch.json"]
    with pytest.raises(WrongPasswordError, match=r"axis\.sealed: wrong password for entry pitch\.json"):
        call(*read_pitch)
    Path("backlash.json").write_text("changed")
    assert call("seal", "backlash.json", "--out", "axis.sealed", "--key", "builder.key", "--update") == 0
    assert call("open", "axis.sealed", "--builder", "builder.pub", "--entry", "backlash.json", "--out", "o") == 0
    assert Path("o/backlash.json").read_text() == "changed"
    capsys.readouterr()
    assert call(*read_pitch, "--password-file", "own.txt") == 0


def test_check_says_what_is_wrong_with_exit_1(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call("seal", "pitch.json", "--out", "axis.sealed", "--key", "builder.key")
    good = Path("axis.sealed").read_bytes()
    call("sign", "--new-key", "stranger")
    assert call("check", "axis.sealed", "--builder", "stranger.pub", "--json", "c.json") == 1
    assert json.loads(Path("c.json").read_text())["kind"] == "ForeignSignatureError"
    for bad, says in ((good[:-1] + bytes([good[-1] ^ 1]), "signature does not fit"), (good[:-5], "ends after")):
        Path("axis.sealed").write_bytes(bad)
        capsys.readouterr()
        assert call("check", "axis.sealed", "--builder", "builder.pub") == 1
        assert says in capsys.readouterr().out
    Path("axis.sealed").write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    with pytest.raises(DamagedError, match=r"axis\.sealed: "):
        call("open", "axis.sealed", "--builder", "builder.pub")


def test_detached_signature(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("sign", "pitch.json", "--key", "builder.key") == 0
    assert call("check", "pitch.json", "--builder", "builder.pub") == 0
    Path("pitch.json").write_text('{"pitch": 2}')
    assert call("check", "pitch.json", "--builder", "builder.pub") == 1
    assert "NOT GOOD: signature does not fit" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"no signature backlash\.json\.sig"):
        call("check", "backlash.json", "--builder", "builder.pub")


def test_sign_a_sealed_file_anew(place: Path) -> None:
    call("seal", "pitch.json", "--out", "axis.sealed", "--key", "builder.key")
    call("sign", "--new-key", "next")
    with pytest.raises(ForeignSignatureError):
        call("sign", "axis.sealed", "--key", "next.key")
    assert call("sign", "axis.sealed", "--key", "next.key", "--builder", "builder.pub") == 0
    assert call("check", "axis.sealed", "--builder", "next.pub") == 0
    assert call("check", "axis.sealed", "--builder", "builder.pub") == 1


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["seal", "absent.json", "--out", "s", "--key", "builder.key"], r"absent\.json: cannot be read"),
        (["seal", "pitch.json", "./pitch.json", "--out", "s", "--key", "builder.key"], "a second file of the name"),
        (["seal", "pitch.json", "--out", "backlash.json", "--key", "builder.key"], "not a sealed file; it is not over"),
        (["seal", "pitch.json", "--out", "s", "--key", "builder.pub"], "not a password-protected private key"),
        (["seal", "pitch.json", "--out", "s", "--key", "builder.key", "--entry-password", "x"], "expected NAME=FILE"),
        (["seal", "pitch.json", "--out", "s", "--key", "builder.key", "--entry-password", "x=y"], "names entry x"),
        (["seal", "pitch.json", "--out", "no/where/s", "--key", "builder.key"], r"no/where/s: cannot be written"),
        (["seal", "pitch.json", "--out", "s", "--key", "builder.key", "--update"], r"s: cannot be read"),
        (["sign", "--new-key", "builder"], "never overwritten"),
        (["sign", "pitch.json"], "nothing to sign with"),
        (["sign", "pitch.json", "--new-key", "x"], "takes no FILE"),
        (["check", "pitch.json", "--builder", "builder.key"], "not a public key"),
        (["open", "pitch.json", "--builder", "builder.pub"], r"pitch\.json: is not a sealed file"),
    ],
)
def test_bad_input_is_refused_in_one_line(place: Path, argv: list[str], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        call(*argv)
    assert "\n" not in str(caught.value)
    assert not Path("s").exists()


def test_no_password_and_no_keyboard(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HIL_PASSWORD")
    with pytest.raises(InputError, match="no reading password: give --password-file FILE or set HIL_PASSWORD"):
        call("seal", "pitch.json", "--out", "s", "--key", "builder.key")
    monkeypatch.setenv("HIL_KEY_PASSWORD", "wrong")
    with pytest.raises(WrongPasswordError, match=r"builder\.key"):
        call("seal", "pitch.json", "--out", "s", "--key", "builder.key")
    Path("empty").write_text("\n")
    with pytest.raises(InputError, match="holds no password"):
        call("sign", "pitch.json", "--key", "builder.key", "--key-password-file", "empty")


def test_the_keyboard_asks_twice_for_a_new_password(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.delenv("HIL_KEY_PASSWORD")
    monkeypatch.setattr("sys.stdin", Terminal())
    answers = iter(["the first of two", "the other of them", *["the same twice over"] * 2])
    monkeypatch.setattr("getpass.getpass", lambda _prompt: next(answers))
    with pytest.raises(InputError, match="the two entries differ"):
        call("sign", "--new-key", "second")
    assert not Path("second.key").exists()
    assert call("sign", "--new-key", "second") == 0
    monkeypatch.setattr("getpass.getpass", lambda _prompt: "the same twice over")
    assert call("sign", "pitch.json", "--key", "second.key") == 0


def test_a_new_password_has_a_least_strength(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    both = ["pitch.json", "backlash.json", "--out", "axis.sealed", "--key", "builder.key"]
    Path("short.txt").write_text("short")
    with pytest.raises(InputError, match=r"password of backlash\.json is new and has 5 characters"):
        call("seal", *both, "--entry-password", "backlash.json=short.txt")
    assert not Path("axis.sealed").exists()
    old = load_private_key("builder.key", "building of the tables")
    Path("axis.sealed").write_bytes(sealed_bytes({"pitch.json": b"1"}, "short", old))
    assert call("seal", "pitch.json", *both[2:], "--update", "--entry-password", "pitch.json=short.txt") == 0
    monkeypatch.setenv("HIL_KEY_PASSWORD", "building")
    with pytest.raises(InputError, match="password of the new key is new and has 8 characters"):
        call("sign", "--new-key", "another")
    assert not Path("another.key").exists()
