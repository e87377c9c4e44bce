"""Waits after wrong passwords and tokens, and who is forgotten first of many browsers."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.bench_axis import PASSWORDS, lay_out

from hil.axis.axis_file import load_axis
from hil.correction.sealed.errors import WrongPasswordError
from hil.desk.backoff import LONGEST_S, BackOff
from hil.desk.desk import Desk
from hil.desk.roles import LockedError, Role
from hil.ui.screen.browsers import Browsers


def test_each_wrong_one_after_the_first_doubles_the_wait() -> None:
    now_s = [0.0]
    backoff = BackOff(lambda: now_s[0])
    waits = []
    for _ in range(9):
        backoff.wrong("a")
        waits.append(backoff.wait_s("a"))
    assert waits == [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, LONGEST_S]
    assert backoff.wait_s("b") == 0.0
    now_s[0] = 59.0
    assert backoff.wait_s("a") == 1.0
    backoff.right("a")
    assert backoff.wait_s("a") == 0.0
    assert backoff.wrong("a") == 1


def test_passwords_are_not_looked_at_during_the_wait(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    desk = Desk(load_axis(lay_out(tmp_path)))
    now_s = [0.0]
    desk.backoff = BackOff(lambda: now_s[0])
    token = desk.control.take("test")
    for _ in range(3):
        with pytest.raises(WrongPasswordError):
            desk.become_builder(token, "wrong")
        now_s[0] += desk.backoff.wait_s("X") if desk.backoff.wait_s("X") < 2.0 else 0.0
    assert "wrong password at axis X, 3 in a row" in caplog.text
    assert PASSWORDS["HIL_KEY_PASSWORD"] not in caplog.text
    assert "wrong password at axis X: wrong" not in caplog.text
    with pytest.raises(LockedError, match="looked at in 2 s"):
        desk.become_builder(token, PASSWORDS["HIL_KEY_PASSWORD"])
    assert desk.rights.role is Role.OPERATOR
    now_s[0] += 2.0
    desk.become_builder(token, PASSWORDS["HIL_KEY_PASSWORD"])
    assert desk.rights.role is Role.BUILDER


def test_a_browser_with_control_is_not_forgotten_for_newcomers() -> None:
    known = Browsers("en")
    holder = known.of("holder")
    holder.tokens["X"] = "token"
    for number in range(300):
        known.of(str(number))
    assert known.of("holder") is holder
