"""What ties campaigns and tables to the machine's zero: one machine that stays, and `hil` connected to it again and again.

Simulated time, the drive on a virtual CAN bus or in process, the laser on its terminal. Homing 37 takes the place where the axis
stands, 1 and 17 go to a limit switch (1 on to the index pulse), none leaves the drive's zero as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from support import bench_axis

import hil.machine.bench_wiring
from drivers.drive import DriveState
from drivers.errors import ProtocolError
from hil.app.main import main
from hil.axis.axis_file import AxisConfig, HomingConfig, load_axis
from hil.calibration.explore import Exploration
from hil.calibration.job import run_calibration, run_verification
from hil.correction.compensation import Compensation
from hil.correction.store import SealedStore
from hil.desk.zero_statement import ZeroStatement
from hil.diagnosis.loop.job import run_loop
from hil.diagnosis.loop.procedure import Turning
from hil.doctor.procedure import doctor
from hil.lost_motion.job import lost_motion_config, run_lost_motion
from hil.machine.events import Event, Point
from hil.machine.machine import Machine
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import connected, connected_drive
from hil.records.zero import FILE, ZeroError, read_zero, write_zero
from sim_backends.bench import Bench, BenchParameters, known_bench
from sim_backends.faults import Fault, FaultKind

READING, KEY = bench_axis.PASSWORDS["HIL_PASSWORD"], bench_axis.PASSWORDS["HIL_KEY_PASSWORD"]
METHODS = {"37": (37, 0.0), "1": (1, 0.0), "17": (17, -5.0), "none": None}
TRAVEL_MM = (-2.0, 502.0)
SWITCH_MM = -7.0  # the limit switch lies at -5 mm, and an axis stops behind it


@dataclass
class Site:
    """A machine that stays while `hil` comes and goes. reach_mm: where its motor has been since it was last asked."""

    axis: AxisConfig
    bench: Bench
    reach_mm: list[float] = field(default_factory=list)

    def motor_mm(self) -> float:
        """Where the shaft really is, whatever the drive calls it."""
        return 10.0 * self.bench.servo.motor_rev

    def moved(self) -> tuple[float, float]:
        self.reach_mm.append(self.motor_mm())
        found = min(self.reach_mm), max(self.reach_mm)
        self.reach_mm.clear()
        return found

    @contextmanager
    def machine(self, *, connection: AxisConfig | None = None) -> Iterator[Machine]:
        with connected(connection or self.axis) as machine:
            yield machine

    def store(self) -> SealedStore:
        return SealedStore.of(self.axis, READING, KEY)

    def calibrate(self) -> None:
        """On a connection of its own."""
        with self.machine() as machine:
            run_calibration(machine, self.store())


Make = Callable[..., Site]


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Make]:
    benches: list[Bench] = []

    def make(homing: str, face: str = "canopen", machine: str = "geometric") -> Site:
        parameters: BenchParameters = replace(known_bench(machine, 5), homing_method=37)
        bench = Bench(parameters)
        benches.append(bench)
        path = bench_axis.lay_out(tmp_path, machine=machine, sections=2, runs=1)
        made = METHODS[homing]
        keys = "" if made is None else f"homing = {{ method = {made[0]}, home_position_mm = {made[1]} }}"
        text = path.read_text().replace("seed = 5", f'seed = 5\nface = "{face}"\n{keys}')
        if made is None:
            text = text.replace("runs = 1", "runs = 1\nhome = false")
        path.write_text(text.replace("dwell_s = 0.3\nreading_s = 0.3", "dwell_s = 0.05\nreading_s = 0.1"))
        here = Site(load_axis(path), bench)
        bench.clock.attach(lambda _now, _dt: here.reach_mm.append(here.motor_mm()), bearable=bench.servo.bearable)
        monkeypatch.setattr(hil.machine.bench_wiring, "make_bench", lambda *_args: bench)
        return here

    yield make
    for bench in benches:
        bench.close()


def stopping_after(rows: int) -> Callable[[Event], None]:
    """An operator's Ctrl-C after so many measured rows."""
    left = [rows]

    def listen(event: Event) -> None:
        if isinstance(event.found, Point):
            left[0] -= 1
            if not left[0]:
                raise KeyboardInterrupt

    return listen


Verb = Callable[[Site, Machine, Callable[[Event], None], bool], object]
VERBS: dict[str, Verb] = {
    "calibrate": lambda site, machine, listen, resume: run_calibration(machine, site.store(), listen, resume=resume),
    "verify": lambda site, machine, listen, resume: run_verification(
        machine, site.store().load(), listen, resume=resume
    ),
    "lost-motion": lambda site, machine, listen, resume: run_lost_motion(
        machine, lost_motion_config(site.axis), None, listen, resume=resume
    ),
    "close-loop": lambda site, machine, listen, resume: run_loop(
        machine, site.store(), Turning(Exploration(2, 6, 0.0)), listen, resume=resume
    ),
}


ZEROS = [
    *(("37", verb) for verb in VERBS),
    *(("1", "calibrate"), ("17", "verify"), ("none", "lost-motion"), ("1", "close-loop"), ("none", "calibrate")),
]
"""Method 37 refuses in every verb; each other method with the verbs in turn."""


def rows_of(site: Site) -> list[str]:
    return [
        line for path in sorted(site.axis.store.directory.glob("*/*.csv")) for line in path.read_text().splitlines()
    ]


# -- interrupted, and gone on with -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("homing", "verb"), ZEROS)
def test_resume_goes_on_in_the_same_zero_or_not_at_all(site: Make, homing: str, verb: str) -> None:
    here = site(homing)
    if verb == "verify":
        with here.machine() as machine:
            run_calibration(machine, here.store())
            with pytest.raises(
                KeyboardInterrupt
            ):  # on the same connection, so that with 37 there is something to resume
                run_verification(machine, here.store().load(), stopping_after(1))
    else:
        with here.machine() as machine, pytest.raises(KeyboardInterrupt):
            VERBS[verb](here, machine, stopping_after(4), False)
    before, was_at = rows_of(here), here.motor_mm()
    here.moved()
    assert abs(was_at) > 1.0  # it would be another zero

    with here.machine() as machine:
        if homing == "37":
            with pytest.raises(ZeroError, match="homing method 37 depends on where the axis stands"):
                VERBS[verb](here, machine, lambda _event: None, True)
            assert here.moved() == (was_at, was_at)
            assert machine.session.drive.sample().state is not DriveState.ENABLED
            assert rows_of(here) == before
            return
        with pytest.raises(KeyboardInterrupt):
            VERBS[verb](here, machine, stopping_after(1), True)
    low, high = here.moved()
    assert low >= (TRAVEL_MM[0] if homing == "none" else SWITCH_MM)
    assert high <= TRAVEL_MM[1]
    assert here.bench.servo.position_actual_counts / 1e5 == pytest.approx(here.motor_mm(), abs=0.006)
    assert len(rows_of(here)) > len(before)


@pytest.mark.parametrize("method", [37, 17])
def test_a_homing_that_ended_in_another_frame_is_refused_and_not_believed_later(site: Make, method: int) -> None:
    """The drive takes 607Ch with the other sign: nothing moves in that frame, now or when the drive says that it is homed."""
    here = site("37" if method == 37 else "17")
    here.axis = replace(here.axis, drive=replace(here.axis.drive, homing=HomingConfig(method, home_position_mm=20.0)))
    servo = here.bench.servo
    plain = servo.start_homing
    servo.start_homing = lambda how, fast, slow, offset: plain(how, fast, slow, -offset)  # type: ignore[method-assign]
    with here.machine() as machine:
        checks = {check.name: check for check in doctor(machine.session, home=True)}
    assert checks["zero"].good
    assert not checks["homing"].good
    assert "was to show 20 mm and shows -" in checks["homing"].detail
    here.moved()
    error, words = (ZeroError, "--new-zero") if method == 37 else (ProtocolError, "the other sign")
    for _ in range(2):
        with here.machine() as machine, pytest.raises(error, match=words):
            machine.session.prepare()
        low, high = here.moved()
        assert high - low < (0.01 if method == 37 else 10.0)  # nothing but the way to the switch
        here.bench.clock.sleep_s(1.0)


@pytest.mark.parametrize(("homing", "verb"), ZEROS)
def test_a_later_verb_on_a_new_connection(site: Make, homing: str, verb: str) -> None:
    """Not a resume: 37 is refused all the same, once the axis has a zero; the rest stays in it."""
    here = site(homing)
    here.calibrate()
    zero, was_at = read_zero(here.axis.zero_path), here.motor_mm()
    here.moved()
    with here.machine() as machine:
        if homing == "37":
            with pytest.raises(ZeroError, match="with a new zero"):
                VERBS[verb](here, machine, lambda _event: None, False)
            assert here.moved() == (was_at, was_at)
            return
        with pytest.raises(KeyboardInterrupt):
            VERBS[verb](here, machine, stopping_after(1), False)
    assert here.moved()[1] <= TRAVEL_MM[1]
    after = read_zero(here.axis.zero_path)
    assert zero is not None
    assert after is not None
    assert (after.id, after.method) == (zero.id, zero.method)


def test_an_axis_whose_drive_has_kept_its_zero_is_not_homed_again(site: Make) -> None:
    here = site("37", face="virtual")  # says itself that it is homed
    with here.machine() as machine, pytest.raises(KeyboardInterrupt):
        run_calibration(machine, here.store(), stopping_after(4))
    with here.machine() as machine:
        run_calibration(machine, here.store(), resume=True)
    with here.machine() as machine:
        result = run_verification(machine, here.store().load())
    assert abs(result.records.error_um).max() < 10.0
    assert here.moved()[1] <= TRAVEL_MM[1]
    assert here.bench.servo.position_actual_counts / 1e5 == pytest.approx(here.motor_mm(), abs=1e-6)


def test_an_absolute_encoder_stated_by_the_axis_file_is_not_homed_again(site: Make) -> None:
    here = site("37")
    path = here.axis.path
    path.write_text(path.read_text().replace("[scaling]", "absolute_encoder = true\n\n[scaling]"))
    absolute = load_axis(path)
    for _ in range(2):
        with connected(absolute) as machine:
            run_calibration(machine, here.store())
    assert here.bench.servo.position_actual_counts / 1e5 == pytest.approx(here.motor_mm(), abs=1e-6)


def test_killed_between_homing_and_the_first_row_a_fresh_axis_is_not_fresh_any_more(
    site: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = site("37")
    with here.machine() as machine:
        drive = machine.session.drive
        order = drive._start_homing

        def killed() -> None:
            order()
            raise KeyboardInterrupt

        monkeypatch.setattr(drive, "_start_homing", killed)
        with pytest.raises(KeyboardInterrupt):
            run_calibration(machine, here.store())
    here.bench.servo.power_on()
    here.bench.servo.move_absolute(3_000_000, 1e7, 1e7)
    here.bench.clock.sleep_s(2.0)
    here.bench.servo.power_off()
    with here.machine() as machine, pytest.raises(ZeroError, match="--new-zero"):
        run_calibration(machine, here.store())
    assert here.motor_mm() == pytest.approx(30.0)


def test_new_zero_is_the_way_out_and_the_old_tables_are_refused(site: Make) -> None:
    here = site("37")
    here.calibrate()
    old: Compensation = here.store().load()
    here.bench.servo.power_on()
    here.bench.servo.move_absolute(0, 1e7, 1e7)  # somebody brings it to its zero
    here.bench.clock.sleep_s(20.0)
    here.bench.servo.power_off()
    with here.machine() as machine:
        assert machine.session.zero is not None
        machine.session.zero.anew = True
        run_calibration(machine, here.store())
        with pytest.raises(ZeroError, match="tables were made in another zero"):
            run_verification(machine, old)
        with pytest.raises(ZeroError, match="tables were made in another zero"):
            machine.session.compensation = old  # the first corrected move of a script
        run_verification(machine, here.store().load())


def test_a_zero_taken_anew_in_a_connection_that_lasts_is_homed_anew(site: Make) -> None:
    """As behind the screen: the job before homed, and the drive kept that; a zero that is asked for is not that one."""
    here = site("37")
    with here.machine() as machine:
        keeper = machine.session.zero
        assert keeper is not None
        with machine.session.one_job():
            run_calibration(machine, here.store())
        first = read_zero(here.axis.zero_path)
        machine.session.drive.disable()
        here.bench.servo.power_on()
        here.bench.servo.move_absolute(1_000_000, 1e7, 1e7)  # to where its zero is to be
        here.bench.clock.sleep_s(10.0)
        here.bench.servo.power_off()
        with machine.session.one_job(), ZeroStatement(anew=True).applied(machine.session):
            machine.session.prepare()
        assert not keeper.anew
        second = read_zero(here.axis.zero_path)
        assert first is not None
        assert second is not None
        assert second.id != first.id
        shift_mm = here.motor_mm() - machine.session.drive.sample().position_load_mm
        assert shift_mm == pytest.approx(10.0, abs=0.01)


# -- the reference position --------------------------------------------------------------------------------------------------
def move_zero(here: Site, homing: str, mm: float) -> None:
    """The switch is set elsewhere, a coupling slips, or another tool homes the drive: by `mm`, unknown to anybody."""
    counts = mm * 1e5
    servo = here.bench.servo
    own = servo._switches
    if homing == "none":
        servo._frame += counts
    elif homing == "1":
        own._p = replace(own._p, index_offset_counts=own._p.index_offset_counts + counts)
    else:
        own._p = replace(own._p, negative_limit_counts=own._p.negative_limit_counts + counts)


@pytest.mark.parametrize(
    ("homing", "verb"), [("1", "calibrate"), ("17", "verify"), ("none", "lost-motion"), ("17", "close-loop")]
)
def test_a_reference_position_found_elsewhere_is_refused(site: Make, homing: str, verb: str) -> None:
    here = site(homing)
    here.calibrate()
    before = rows_of(here)
    move_zero(here, homing, 0.3)
    with here.machine() as machine, pytest.raises(ZeroError, match=r"from where it was .*at most 100 µm"):
        VERBS[verb](here, machine, lambda _event: None, False)
    assert rows_of(here) == before


@pytest.mark.parametrize(("mm", "refused"), [(0.09, False), (0.11, True)])
def test_how_far_is_the_axis_files_to_say(site: Make, mm: float, refused: bool) -> None:
    here = site("17")
    here.calibrate()
    move_zero(here, "17", mm)
    with here.machine() as machine:
        if refused:
            with pytest.raises(ZeroError, match="reference_within_um"):
                run_verification(machine, here.store().load())
        else:
            run_verification(machine, here.store().load())


@pytest.mark.parametrize(("homing", "refused"), [("1", False), ("17", False), ("none", True)])
def test_an_instrument_that_was_switched_off_leaves_the_drives_zero_as_the_only_tie(
    site: Make, homing: str, refused: bool
) -> None:
    here = site(homing)
    here.calibrate()
    here.bench.laser._sequence = 0  # it counts anew
    here.bench.laser._runaway += 123_456  # from elsewhere
    zero = read_zero(here.axis.zero_path)
    assert zero is not None
    assert zero.reference is not None
    earlier = datetime.fromisoformat(zero.reference.time) - timedelta(hours=1.0)  # than simulated time has passed
    write_zero(here.axis.zero_path, replace(zero, reference=replace(zero.reference, time=earlier.isoformat())))
    with here.machine() as machine:
        if refused:
            with pytest.raises(ZeroError, match="nothing shows that it is the same"):
                run_verification(machine, here.store().load())
        else:
            result = run_verification(machine, here.store().load())
            assert abs(result.records.error_um).max() < 10.0


def test_a_beam_that_was_broken_meanwhile_is_for_a_person_to_say(site: Make) -> None:
    here = site("1")
    here.calibrate()
    here.bench.laser._runaway += 123_456  # its samples are numbered on
    for zeroed in (False, True):
        with here.machine() as machine:
            assert machine.session.zero is not None
            machine.session.zero.instrument_zeroed = zeroed
            if not zeroed:
                with pytest.raises(ZeroError, match="--instrument-zeroed"):
                    run_verification(machine, here.store().load())
            else:
                run_verification(machine, here.store().load())
    with here.machine() as machine:
        run_verification(machine, here.store().load(), seed=2)  # it was kept


# -- what is kept, and what it is held against -------------------------------------------------------------------------------
def test_campaigns_and_tables_keep_the_zero(site: Make) -> None:
    here = site("17")
    here.calibrate()
    zero = read_zero(here.axis.zero_path)
    assert zero is not None
    assert zero.reference is not None
    assert (zero.method, zero.home_position_mm, zero.homes) == (17, -5.0, True)
    assert zero.reference.motor_mm == pytest.approx(here.axis.measurement.reference_mm, abs=0.01)
    assert zero.reference.sequence is not None
    assert {"vendor", "product", "serial"} == set(zero.drive)
    assert read_zero(here.axis.store.directory / "calibrate-001" / FILE) == zero
    kept = here.store().load().zero
    assert kept is not None
    assert kept.id == zero.id


def test_another_drive_is_another_zero(site: Make) -> None:
    here = site("1")
    here.calibrate()
    text = here.axis.zero_path.read_text()
    here.axis.zero_path.write_text(text.replace('"serial": ', '"serial": 1'))
    with here.machine() as machine, pytest.raises(ZeroError, match="was made with drive"):
        run_verification(machine, here.store().load())


def test_another_homing_is_another_zero(site: Make) -> None:
    here = site("1")
    here.calibrate()
    path = here.axis.path
    path.write_text(
        path.read_text().replace("method = 1, home_position_mm = 0.0", "method = 17, home_position_mm = -5.0")
    )
    with connected(load_axis(path)) as machine, pytest.raises(ZeroError, match="would home by homing method 17"):
        run_verification(machine, here.store().load())


def test_rows_from_before_zeros_were_kept_are_not_gone_on_with_by_a_homing_that_depends_on_the_place(
    site: Make,
) -> None:
    here = site("37")
    with here.machine() as machine, pytest.raises(KeyboardInterrupt):
        run_calibration(machine, here.store(), stopping_after(3))
    here.axis.zero_path.unlink()
    (here.axis.store.directory / "calibrate-001" / FILE).unlink()
    with here.machine() as machine, pytest.raises(ZeroError, match="what was measured before would be lost"):
        run_calibration(machine, here.store(), resume=True)


@pytest.mark.parametrize(
    ("homing", "verdict", "said"), [("37", "RISK", "homing method 37"), ("1", "good", "homing method 1 to 0 mm")]
)
def test_doctor_names_the_risk(site: Make, homing: str, verdict: str, said: str) -> None:
    here = site(homing)
    with here.machine() as machine:
        found = {check.name: check for check in doctor(machine.session, move=False)}
    assert said in found["zero"].detail
    assert found["zero"].verdict == verdict
    assert found["zero"].good


@pytest.mark.usefixtures("passwords")
@pytest.mark.outside
def test_a_store_that_states_no_zero_warns_in_a_line_and_is_used(
    site: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    here = site("1")
    with here.machine() as machine:
        tables = run_calibration(machine, here.store()).tables
    replace(here.store(), zero_path=None).save_tables(tables)
    assert main(["verify", str(here.axis.path)]) == 0
    assert "states no zero of axis X" in capsys.readouterr().err
    here.store().save_tables(tables)
    assert main(["verify", str(here.axis.path)]) == 0
    assert "states no zero" not in capsys.readouterr().err


@pytest.mark.usefixtures("passwords")
def test_the_verbs_say_it_in_a_line_and_take_the_word_of_a_person(
    site: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    here = site("37")
    path = str(here.axis.path)
    assert main(["calibrate", path]) == 0
    was_at = here.motor_mm()
    capsys.readouterr()
    for verb in (
        ["verify"],
        ["calibrate"],
        ["lost-motion"],
        ["close-loop", "--person", "none"],
        ["calibrate", "--resume"],
    ):
        assert main([verb[0], path, *verb[1:]]) == 2
        (line,) = [text for text in capsys.readouterr().err.splitlines() if text.startswith("hil:")]
        assert "homing method 37" in line
        assert here.motor_mm() == was_at
    assert main(["calibrate", path, "--resume", "--new-zero"]) == 2
    assert "a resumed job takes no new zero" in capsys.readouterr().err
    here.bench.servo.power_on()
    here.bench.servo.move_absolute(0, 1e7, 1e7)
    here.bench.clock.sleep_s(20.0)
    here.bench.servo.power_off()
    assert main(["calibrate", path, "--new-zero"]) == 0


def test_a_beam_that_comes_back_within_a_job_gives_the_instrument_a_new_zero(site: Make) -> None:
    here = site("1")
    with here.machine() as machine:
        machine.session.resume_within_s = 30.0
        rows = [0]

        def lose(event: Event) -> None:
            if not isinstance(event.found, Point):
                return
            rows[0] += 1
            if rows[0] == 2:
                now_s = here.bench.clock.now_ns() / 1e9
                here.bench.laser.schedule((Fault(FaultKind.BEAM_LOST, now_s + 0.5, 3.0),))

        run_calibration(machine, here.store(), lose)
    zero = read_zero(here.axis.zero_path)
    assert zero is not None
    assert zero.reference is not None
    assert abs(zero.reference.offset_mm) > 1.0  # what the counter missed
    with here.machine() as machine:
        run_verification(machine, here.store().load())


def test_an_axis_without_its_instrument_is_looked_after_as_well(site: Make) -> None:
    here = site("37")
    here.calibrate()
    was_at = here.motor_mm()
    with (
        connected_drive(here.axis) as drive,
        Supervisor([WatchedAxis(drive)]) as axis,
        pytest.raises(ZeroError, match="would be lost"),
    ):
        axis.get_ready(home=True)
    assert here.motor_mm() == was_at
