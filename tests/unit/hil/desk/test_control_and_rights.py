"""Who holds control, and what he may do."""

from pathlib import Path

import pytest
from support.bench_axis import PASSWORDS, lay_out

from drivers.errors import InputError
from hil.axis.axis_file import load_axis
from hil.correction.sealed import WrongPasswordError
from hil.desk.control import SILENT_S, ControlHeldError, DeskControl, NotInControlError
from hil.desk.roles import LockedError, Rights, Role


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_one_holder_at_a_time() -> None:
    control = DeskControl()
    assert control.holder() is None
    token = control.take("first")
    assert control.holds(token)
    assert len(token) >= 43  # 256 bits
    with pytest.raises(ControlHeldError, match="held by first"):
        control.take("second")
    control.release(token)
    second = control.take("second")
    assert second != token
    with pytest.raises(NotInControlError):
        control.require(token)
    with pytest.raises(NotInControlError):
        control.release(None)


def test_taken_over_only_from_a_holder_without_a_sign_of_life() -> None:
    clock = Clock()
    control = DeskControl(clock)
    first = control.take("first")
    clock.now_s += SILENT_S
    control.sign_of_life(first)
    clock.now_s += SILENT_S
    with pytest.raises(ControlHeldError, match="without a sign of life"):
        control.take_over("second")
    clock.now_s += 0.1
    holder = control.holder()
    assert holder is not None
    assert holder.lost
    second = control.take_over("second")
    assert not control.holds(first)
    control.sign_of_life(first)
    clock.now_s += SILENT_S - 1.0
    assert control.holds(second)
    assert control.holder() is not None
    assert not control.holder().lost  # type: ignore[union-attr]


def test_every_change_of_hands_is_told() -> None:
    control, told = DeskControl(), []
    control.on_change = lambda: told.append(control.holder())
    token = control.take("first")
    control.release(token)
    assert [None if one is None else one.name for one in told] == ["first", None]


def test_the_builder_is_who_can_open_the_builders_key(tmp_path: Path) -> None:
    rights = Rights(load_axis(lay_out(tmp_path)))
    with pytest.raises(LockedError):
        rights.require(locked=True)
    rights.require(locked=False)
    with pytest.raises(WrongPasswordError):
        rights.become_builder("wrong")
    assert rights.role is Role.OPERATOR
    rights.become_builder(PASSWORDS["HIL_KEY_PASSWORD"])
    rights.require(locked=True)
    assert rights.store is None
    rights.become_builder(PASSWORDS["HIL_KEY_PASSWORD"], PASSWORDS["HIL_PASSWORD"])
    assert rights.store is not None
    assert rights.store.builder_key is not None
    rights.forget()
    assert (rights.role, rights.store) == (Role.OPERATOR, None)


def test_no_builder_without_a_key(tmp_path: Path) -> None:
    path = lay_out(tmp_path)
    (tmp_path / "builder.key").unlink()
    with pytest.raises(InputError, match="hil sign --new-key"):
        Rights(load_axis(path)).become_builder("anything")
