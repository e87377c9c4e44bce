"""Simulated time: who is advanced when, by how much, and who may ask for longer or shorter steps."""

from sim_backends.clock import SimClock


class Part:
    def __init__(self, bears_ns: int = 0) -> None:
        self.steps: list[tuple[int, float]] = []
        self.settled_at: list[int] = []
        self.bears_ns = bears_ns

    def advance(self, now_ns: int, dt_s: float) -> None:
        self.steps.append((now_ns, dt_s))

    def bearable(self, now_ns: int) -> int:
        return self.bears_ns

    def settle(self) -> None:
        self.settled_at.append(len(self.steps))


def test_steps_are_short_and_add_up() -> None:
    clock, part = SimClock(0.005), Part()
    clock.attach(part.advance)
    clock.sleep_s(0.012)
    assert part.steps == [(5_000_000, 0.005), (10_000_000, 0.005), (12_000_000, 0.002)]
    assert clock.now_ns() == 12_000_000


def test_a_moment_that_is_past_costs_nothing() -> None:
    clock, part = SimClock(), Part()
    clock.attach(part.advance, settle=part.settle)
    clock.sleep_until_ns(0)
    assert part.steps == []
    assert part.settled_at == []


def test_steps_grow_only_if_everybody_bears_it() -> None:
    clock, patient, less = SimClock(0.005), Part(1_000_000_000), Part(20_000_000)
    clock.attach(patient.advance, bearable=patient.bearable)
    clock.attach(less.advance, bearable=less.bearable)
    clock.sleep_s(0.05)
    assert [dt for _, dt in patient.steps] == [0.02, 0.02, 0.01]
    silent = Part()
    clock.attach(silent.advance)
    clock.sleep_s(0.01)
    assert [dt for _, dt in silent.steps] == [0.005, 0.005]


def test_who_bears_less_than_the_clocks_step_gets_less() -> None:
    clock, silent, hasty = SimClock(0.005), Part(), Part(2_000_000)
    clock.attach(silent.advance)
    clock.attach(hasty.advance, bearable=hasty.bearable)
    clock.sleep_s(0.005)
    assert [dt for _, dt in silent.steps] == [0.002, 0.002, 0.001]


def test_nothing_to_bear_still_moves_on() -> None:
    clock, part = SimClock(), Part(0)
    clock.attach(part.advance, bearable=part.bearable)
    clock.sleep_until_ns(3)
    assert [now for now, _ in part.steps] == [1, 2, 3]


def test_settling_comes_once_per_sleep_after_all_steps() -> None:
    clock, part = SimClock(0.005), Part()
    clock.attach(part.advance, settle=part.settle)
    clock.sleep_s(0.02)
    clock.sleep_s(0.005)
    assert part.settled_at == [4, 5]


def test_deadline_ends_in_simulated_time() -> None:
    clock = SimClock()
    deadline = clock.deadline(1.5)
    clock.sleep_s(1.0)
    assert not deadline.expired
    clock.sleep_s(0.5)
    assert deadline.expired
