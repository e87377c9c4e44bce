"""The hand-shake of M codes: step by step without a wire, and on virtual drives with a control that does its part wrong."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from support import probe_files
from support.probe_files import connected_probe

from drivers.errors import InputError, MotionTimeoutError
from hil.probe.codes import CodeError, HandShake, HandshakePhase, number_shown
from hil.probe.machine_file import CodesConfig, ProbeMachineConfig, load_probe_machine
from hil.probe.procedure import Correction, HandledCode, serve_codes
from hil.probe.runout import CorrectionCode, MeasurementRefusedError, RunOut
from hil.probe.store import RunOutStore
from hil.probe.wiring import control_wires, probe_bench
from sim_backends.control_wires import ControlFault, SimulatedControl, Wires
from sim_backends.plant.touch_probe import Chip, Face, Stylus
from sim_backends.probe import ProbeParameters
from sim_backends.probe_bench import ProbeBench

WIRED = CodesConfig("x", strobe_bit=4, code_bits=(5, 6), mfin_bit=16, settle_s=0.02, work_s=60.0, release_s=5.0)
STROBE, M91, M92 = 1 << 4, 1 << 5, 1 << 6
OTHER = 1 << 0  # a limit switch at the same terminals


# -- what the wires show -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("inputs", "number"),
    [(0, None), (M91, None), (OTHER, None), (STROBE, 90), (STROBE | M91, 91), (STROBE | M92 | OTHER, 92)],
)
def test_a_number_in_binary_counts_only_with_its_strobe(inputs: int, number: int | None) -> None:
    assert number_shown(WIRED, inputs) == number


def test_two_digits_in_bcd() -> None:
    bcd = replace(WIRED, coding="bcd", code_bits=tuple(range(8, 16)), first=0)
    assert number_shown(bcd, STROBE | 0x93 << 8) == 93
    with pytest.raises(CodeError, match="9Bh, which is no number in BCD"):
        number_shown(bcd, STROBE | 0x9B << 8)


def test_a_line_for_each_code_needs_no_strobe() -> None:
    lines = CodesConfig("x", coding="lines", code_bits=(8, 9, 10, 11))
    assert [number_shown(lines, inputs) for inputs in (0, 1 << 8, 1 << 11, OTHER)] == [None, 90, 93, None]
    with pytest.raises(CodeError, match=r"inputs \[8, 9\] are on at once"):
        number_shown(lines, 3 << 8)


def test_a_cable_that_carries_nothing_is_no_idle_control() -> None:
    alive = replace(WIRED, alive_bit=7)
    assert number_shown(alive, 1 << 7) is None
    with pytest.raises(CodeError, match="control off or cable broken"):
        number_shown(alive, 0)


# -- the steps ---------------------------------------------------------------------------------------------------------------
def waiting() -> HandShake:
    shake = HandShake(WIRED, 0.0)
    assert shake.saw(0, 0.0) is None
    return shake


def working() -> HandShake:
    shake = waiting()
    assert shake.saw(STROBE | M91, 1.0) is None
    assert shake.saw(STROBE | M91, 1.03) == 91
    return shake


def test_code_mfin_strobe_off_mfin_off() -> None:
    shake = working()
    assert (shake.phase, shake.mfin) == (HandshakePhase.WORKING, False)
    assert shake.saw(STROBE | M91, 9.0) is None
    shake.done(10.0)
    assert shake.mfin
    assert shake.saw(STROBE | M91, 10.1) is None
    assert shake.mfin
    assert shake.saw(0, 10.2) is None
    assert (shake.phase, shake.mfin) == (HandshakePhase.WAITING, False)
    shake.saw(STROBE, 11.0)
    assert shake.saw(STROBE, 11.1) == 90


def test_a_code_has_to_stay_the_same_before_it_counts() -> None:
    shake = waiting()
    shake.saw(STROBE, 1.0)
    assert shake.saw(STROBE | M91, 1.03) is None  # its bits came after the strobe
    assert shake.saw(STROBE | M91, 1.04) is None
    assert shake.saw(STROBE | M91, 1.06) == 91
    bounced = waiting()
    bounced.saw(STROBE, 1.0)
    bounced.saw(0, 1.01)
    assert bounced.saw(STROBE, 1.03) is None
    assert bounced.saw(STROBE, 1.06) == 90


def test_a_code_of_somebody_else_is_left_to_him() -> None:
    shake = HandShake(replace(WIRED, code_bits=(5, 6, 7)), 0.0)
    shake.saw(0, 0.0)
    for time_s in (1.0, 1.1, 100.0):
        assert shake.saw(STROBE | 1 << 7, time_s) is None  # M94
    assert shake.saw(STROBE | M91, 101.0) is None  # without a strobe of its own
    assert (shake.phase, shake.mfin) == (HandshakePhase.FOREIGN, False)
    shake.saw(0, 102.0)
    shake.saw(STROBE | M91, 103.0)
    assert shake.saw(STROBE | M91, 103.1) == 91


def test_a_strobe_that_was_there_before_starts_nothing() -> None:
    shake = HandShake(WIRED, 0.0)
    assert [shake.saw(STROBE | M91, time_s) for time_s in (0.0, 0.1, 4.9)] == [None] * 3
    with pytest.raises(CodeError, match="on for 5 s since the start"):
        shake.saw(STROBE | M91, 5.1)


@pytest.mark.parametrize(
    ("inputs", "time_s", "said"),
    [
        (0, 2.0, "the strobe of M91 went off before MFIN"),
        (M91, 2.0, "the strobe of M91 went off before MFIN"),
        (STROBE | M92, 2.0, "M92 came while M91 was handled"),
        (STROBE | M91, 62.0, "M91 was not handled within 60 s"),
    ],
)
def test_what_ends_the_work(inputs: int, time_s: float, said: str) -> None:
    shake = working()
    with pytest.raises(CodeError, match=said):
        shake.saw(inputs, time_s)
    assert not shake.mfin
    assert shake.saw(STROBE | M91, time_s + 0.1) is None  # and no code is taken up again


def test_a_strobe_that_stays_and_a_second_code_behind_mfin() -> None:
    for inputs, time_s, said in (
        (STROBE | M91, 15.1, "still on 5 s after MFIN"),
        (STROBE | M92, 10.1, "M92 came with the"),
    ):
        shake = working()
        shake.done(10.0)
        with pytest.raises(CodeError, match=said):
            shake.saw(inputs, time_s)
        assert not shake.mfin


# -- the machine file ----------------------------------------------------------------------------------------------------------
def test_which_code_sets_which_axis_is_a_setting() -> None:
    other = replace(WIRED, both=91, x=92, y=93)
    assert [other.correction(f"M{number}") for number in (91, 92, 93)] == [
        CorrectionCode.M93,
        CorrectionCode.M91,
        CorrectionCode.M92,
    ]
    assert other.name(CorrectionCode.M91) == "M92"
    with pytest.raises(InputError, match="code is M94, expected one of M92, M93, M91"):
        other.correction("M94")


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("x = 90", "expected four different numbers"),
        ('drive = "x"\nstrobe_bit = 20', "code_bits is empty"),
        ('drive = "x"\ncode_bits = [20]', "strobe_bit is missing"),
        ('drive = "x"\nstrobe_bit = 20\ncode_bits = [20, 21]', "expected different inputs"),
        ('drive = "z"\nstrobe_bit = 20\ncode_bits = [21]', "drive is z, expected x, y or spindle"),
    ],
)
def test_what_is_wrong_in_the_machine_file(tmp_path: Path, section: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_probe_machine(probe_files.lay_out(tmp_path, more=f"[codes]\n{section}"))


# -- the machine ---------------------------------------------------------------------------------------------------------------
STYLUS = Stylus(2.0, (0.030, -0.012))
TRUTH = ProbeParameters(STYLUS, (Face((105.0, 40.0, 0.0)),))
WIRES = 'drive = "x"\nstrobe_bit = 20\ncode_bits = [21, 22]\nalive_bit = 23\n'


class At:
    """A machine with a control that gives these codes."""

    def __init__(self, tmp_path: Path, program: str, codes: str = "", truth: ProbeParameters = TRUTH) -> None:
        more = f"[codes]\n{WIRES}{codes}\n[bench]\nprogram = {program}"
        path = probe_files.lay_out(tmp_path, start_mm=102.7, search_mm=0.6, block="turns = 1", more=more)
        self.config: ProbeMachineConfig = load_probe_machine(path)
        self.bench: ProbeBench = probe_bench(self.config, truth)
        self.store = RunOutStore(tmp_path / "store", "mill")
        self.kept: list[HandledCode] = []
        self.power_at_mfin: list[bool] = []

    @property
    def control(self) -> SimulatedControl:
        assert self.bench.control is not None
        return self.bench.control

    @property
    def wires(self) -> Wires:
        return self.control.wires

    def serve(self, times: int | None = None, wait_s: float | None = 20.0) -> list[HandledCode]:
        with (
            connected_probe(self.config, touching=("x", "y"), bench=self.bench) as session,
            control_wires(self.config, session.drives) as wires,
        ):
            now = datetime(2026, 1, 1, tzinfo=UTC)
            return serve_codes(session, wires, self.store, lambda: now, times=times, wait_s=wait_s, keep=self.note)

    def note(self, handled: HandledCode) -> None:
        self.kept.append(handled)
        assert self.wires.outputs == 1 << 16
        self.power_at_mfin.append(any(servo.powered for servo in self.bench.servos.values()))

    def is_quiet(self) -> bool:
        servos = self.bench.servos.values()
        still = all(not servo.powered and not servo.velocity_actual_counts_s for servo in servos)
        return still and self.wires.outputs == 0


def test_a_program_measures_and_corrects_and_gets_its_mfin_each_time(tmp_path: Path) -> None:
    at = At(tmp_path, "[90, 91, 92]")
    before = at.bench.place("x"), at.bench.place("y")
    handled = at.serve(3)
    assert [one.name for one in handled] == ["M90", "M91", "M92"]
    assert (at.control.finished, at.control.alarm) == ([90, 91, 92], "")
    moved = at.bench.place("x") - before[0], at.bench.place("y") - before[1]
    assert moved == pytest.approx(STYLUS.offset_mm, abs=1e-3)
    assert at.is_quiet()
    assert at.kept == handled
    assert at.power_at_mfin == [False] * 3


def test_the_setting_decides_which_axis_a_code_moves(tmp_path: Path) -> None:
    at = At(tmp_path, "[92, 93]", "both = 91\nx = 92\ny = 93")
    at.store.save(RunOut(0.030, -0.012, 2.0), datetime(2026, 1, 1, tzinfo=UTC))
    first, second = at.serve(2)
    assert isinstance(first.did, Correction)
    assert isinstance(second.did, Correction)
    assert first.did.driven_mm == pytest.approx((0.030, 0.0))
    assert second.did.driven_mm == pytest.approx((0.0, -0.012))


@pytest.mark.parametrize("coding", ["lines", "bcd"])
def test_other_ways_to_wire_a_code(tmp_path: Path, coding: str) -> None:
    bits = {"lines": "[18, 19, 24, 25]", "bcd": "[18, 19, 21, 22, 24, 25, 26, 27]"}[coding]
    at = At(tmp_path, "[91]", f'coding = "{coding}"\nfirst = {90 if coding == "lines" else 0}')
    path = at.config.path
    text = path.read_text().replace("code_bits = [21, 22]", f"code_bits = {bits}")
    path.write_text(text.replace("strobe_bit = 20\n", "") if coding == "lines" else text)
    at.config = load_probe_machine(path)
    at.bench = probe_bench(at.config, TRUTH)
    at.store.save(RunOut(0.030, -0.012, 2.0), datetime(2026, 1, 1, tzinfo=UTC))
    assert [one.name for one in at.serve(1)] == ["M91"]
    assert at.control.finished == [91]


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (ControlFault.STROBE_LOST, "strobe of M90 went off before MFIN"),
        (ControlFault.CODE_CHANGED, "M91 came while M90 was handled"),
        (ControlFault.ALIVE_LOST, "control off or cable broken"),
    ],
)
def test_a_control_that_fails_while_its_code_is_handled_stops_the_machine(
    tmp_path: Path, fault: ControlFault, said: str
) -> None:
    at = At(tmp_path, "[90, 91]")
    at.control.fault, at.control.fault_after_ns = fault, 800_000_000
    with pytest.raises(CodeError, match=said):
        at.serve(2)
    assert at.is_quiet()
    assert at.control.finished == []
    assert not at.store.path.exists()
    assert at.bench.clock.now_ns() < 2_500_000_000  # M90 takes longer


def test_a_strobe_that_stays_on_takes_mfin_back(tmp_path: Path) -> None:
    at = At(tmp_path, "[91]")
    at.store.save(RunOut(0.030, -0.012, 2.0), datetime(2026, 1, 1, tzinfo=UTC))
    at.control.fault = ControlFault.STROBE_STUCK
    with pytest.raises(CodeError, match="still on 5 s after MFIN; MFIN was taken back"):
        at.serve(1)
    assert at.is_quiet()


def test_a_bouncing_strobe_is_no_code(tmp_path: Path) -> None:
    at = At(tmp_path, "[91]")
    at.store.save(RunOut(0.030, -0.012, 2.0), datetime(2026, 1, 1, tzinfo=UTC))
    at.control.fault = ControlFault.BOUNCE
    assert [one.name for one in at.serve(1)] == ["M91"]  # not M90, whose bits a strobe alone shows
    hasty = At(tmp_path / "hasty", "[91]", "settle_s = 0.0")
    hasty.control.fault = ControlFault.BOUNCE
    with pytest.raises(CodeError, match="the strobe of M90 went off before MFIN"):
        hasty.serve(1)


def test_a_cable_that_is_dead_from_the_start(tmp_path: Path) -> None:
    at = At(tmp_path, "[90]")
    at.control.fault = ControlFault.ALIVE_LOST_WAITING
    with pytest.raises(CodeError, match="control off or cable broken"):
        at.serve(1)
    assert at.is_quiet()


def test_a_run_out_that_is_refused_gets_no_mfin(tmp_path: Path) -> None:
    at = At(tmp_path, "[90]", truth=replace(TRUTH, chips=(Chip(0.05, 1, 1),)))
    with pytest.raises(MeasurementRefusedError, match="M90 gets no MFIN: the contacts do not close"):
        at.serve(1)
    assert at.is_quiet()
    assert at.control.finished == []


def test_a_correction_without_a_run_out_in_force_gets_no_mfin(tmp_path: Path) -> None:
    at = At(tmp_path, "[91]")
    with pytest.raises(InputError, match="cannot be read"):
        at.serve(1)
    assert at.is_quiet()


def test_no_code_within_the_stated_wait(tmp_path: Path) -> None:
    at = At(tmp_path, "[]")
    with pytest.raises(MotionTimeoutError, match="no code within 3 s, 0 handled before"):
        at.serve(1, wait_s=3.0)
    assert at.bench.clock.now_ns() == pytest.approx(3e9, rel=0.02)
