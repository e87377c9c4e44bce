"""A time-out counts the time in which the process listened; the peer's lateness is held against it, this process's own is not."""

import pytest

from drivers.clock import IO_SLICE_S, NS_PER_S
from drivers.listening import EXCUSED_S, Listening


class Host:
    """A clock on which a wait of a slice lasts `times` as long."""

    def __init__(self, times: float = 1.0) -> None:
        self.now_s, self.times = 0.0, times

    def now_ns(self) -> int:
        return round(self.now_s * NS_PER_S)

    def time_out_s(self, within: Listening) -> float:
        began_s = self.now_s
        while slice_s := within.next_slice_s():
            self.now_s += max(1e-6, slice_s * self.times)
        return self.now_s - began_s


@pytest.mark.parametrize("within_s", [0.001, 0.1, 0.5, 3.0])
def test_a_process_that_runs_freely_waits_for_the_time_out(within_s: float) -> None:
    host = Host()
    assert host.time_out_s(Listening(within_s, host.now_ns)) == pytest.approx(within_s, abs=1e-6)


@pytest.mark.parametrize(("within_s", "times"), [(0.1, 2.0), (0.1, 9.0), (0.5, 2.5)])
def test_one_that_gets_a_share_of_a_processor_waits_as_much_longer(within_s: float, times: float) -> None:
    host = Host(times)
    assert host.time_out_s(Listening(within_s, host.now_ns)) == pytest.approx(within_s * times, abs=times * IO_SLICE_S)


def test_a_delay_is_made_up_for_within_bounds() -> None:
    host = Host(1000.0)
    assert host.time_out_s(Listening(0.1, host.now_ns)) < 0.1 + EXCUSED_S + 1000.0 * IO_SLICE_S


def test_a_wait_on_a_bus_that_does_not_advance_the_clock_ends() -> None:
    within, slices = Listening(0.1, lambda: 0), 1
    within.next_slice_s()
    while within.next_slice_s(in_vain=True):
        slices += 1
    assert slices == pytest.approx(0.1 / IO_SLICE_S, abs=1)


def test_what_comes_before_a_slice_is_over_counts() -> None:
    """Else traffic that never pauses would extend the time-out for ever."""
    host = Host(0.5)
    assert host.time_out_s(Listening(0.1, host.now_ns)) == pytest.approx(0.1, abs=IO_SLICE_S)
