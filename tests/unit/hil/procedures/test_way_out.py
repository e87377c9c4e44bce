"""What must be done on the way out is done, whatever interrupts it."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from drivers.errors import LinkLostError
from hil.procedures.way_out import completed


@dataclass
class Undo:
    """Raises these, one at each call, then does it."""

    errors: list[BaseException]
    done: list[int] = field(default_factory=list)

    def __call__(self) -> None:
        if self.errors:
            raise self.errors.pop(0)
        self.done.append(1)


def test_an_interrupt_is_heard_once_it_is_done() -> None:
    undo = Undo([KeyboardInterrupt()])
    with pytest.raises(KeyboardInterrupt):
        completed(undo)
    assert undo.done == [1]


def test_a_second_interrupt_is_obeyed() -> None:
    undo = Undo([KeyboardInterrupt(), KeyboardInterrupt()])
    with pytest.raises(KeyboardInterrupt):
        completed(undo)
    assert undo.done == []


def test_an_error_is_raised_only_where_none_is_under_way() -> None:
    completed(Undo([LinkLostError("gone")]))
    with pytest.raises(LinkLostError):
        completed(Undo([LinkLostError("gone")]), raising=True)
    with pytest.raises(KeyboardInterrupt):
        completed(Undo([KeyboardInterrupt(), LinkLostError("gone")]), raising=True)
