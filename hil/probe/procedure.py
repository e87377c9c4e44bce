"""System D (JPH08348B2): a touch probe's run-out measured on the machine (M90), corrected (M91 to M93), and a bore centred with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from drivers.clock import NS_PER_S, Clock
from drivers.errors import FollowingErrorError, StateError
from hil.machine.events import Event, Listener, Measured, silent
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.runout import (
    ANGLES_DEG,
    Centring,
    CorrectionCode,
    FourFeeds,
    MeasurementRefusedError,
    RunOut,
    check_radius,
    check_repeat,
    mean_feeds,
    run_out,
)
from hil.probe.session import ProbeSession
from hil.probe.store import RunOutStore


@dataclass(frozen=True)
class RunOutMeasurement:
    """The contacts of one M90 cycle and their result. mode: "latch" or "step"; seconds: machine time."""

    turns: tuple[FourFeeds, ...]
    run_out: RunOut
    mode: str
    seconds: float

    @property
    def feeds(self) -> FourFeeds:
        """Mean of the turns."""
        return mean_feeds(self.turns)

    def refusal(self, config: ProbeMachineConfig) -> str | None:
        """Why the result must not be put into force: a turn does not close, turns do not repeat, or the radius differs
        from the ball's; else None.
        """
        block, probe = config.block, config.probe
        try:
            for turn in self.turns:
                turn.check_closure(block.closure_limit_um)
            check_repeat(self.turns, block.repeat_limit_um)
            if block.radius_limit_um is not None and probe.tip_radius_mm is not None:
                check_radius(self.run_out, probe.tip_radius_mm, block.radius_limit_um)
        except MeasurementRefusedError as error:
            return str(error)
        return None


def measure_and_store(
    session: ProbeSession, store: RunOutStore, now: Callable[[], datetime], listener: Listener = silent
) -> tuple[RunOutMeasurement, str | None]:
    """M90; the result is put into force, or refused with the reason. Either way it is added to the history.

    The turns completed before an error are added too, with the error. Raises as `measure_run_out`.
    """
    over: list[FourFeeds] = []
    try:
        measured = measure_run_out(session, listener, over.append)
    except BaseException as error:
        if over:
            said = " ".join(str(error).split())
            verdict = f"broken off: {type(error).__name__}{': ' if said else ''}{said}"
            store.append(now(), session.mode, tuple(over), _found(session.config, over), verdict)
        raise
    refusal, when = measured.refusal(session.config), now()
    if refusal is None:
        store.save(measured.run_out, when)
    verdict = "stored" if refusal is None else f"refused: {refusal}"
    store.append(when, measured.mode, measured.turns, measured.run_out, verdict)
    return measured, refusal


def measure_run_out(
    session: ProbeSession, listener: Listener = silent, keep: Callable[[FourFeeds], None] = lambda _turn: None
) -> RunOutMeasurement:
    """M90: touches the block's face with the spindle at 0, 90, 180 and 270°, each time from the same start.

    The probe has to be in front of the face, with nothing else in its way. Afterwards the machine is at its initial
    position. The result is returned whether or not it closes; `RunOutMeasurement.refusal` decides. keep: receives each
    turn when it is complete.
    Raises ContactError, LimitError, StateError and CapabilityError as `ProbeSession` does.
    """
    config, block = session.config, session.config.block
    began_ns = session.clock.now_ns()
    session.prepare()
    found_at = {name: session.place(name) for name in config.axes}
    if block.y_mm is not None:
        session.move("y", block.y_mm)
    session.move("x", block.start_mm)
    turns: list[FourFeeds] = []
    total = block.turns * len(ANGLES_DEG)
    for turn in range(block.turns):
        feeds: list[float] = []
        for angle_deg in ANGLES_DEG:
            what, done = contact_name(turn + 1, angle_deg), turn * len(ANGLES_DEG) + len(feeds)
            listener(Event("run-out", what, done, total))
            session.orient(angle_deg)
            contact_mm = session.touch("x", block.facing, block.search_mm, block.free_mm)
            feeds.append(block.facing * (contact_mm - block.start_mm))
            listener(Event("run-out", what, done + 1, total, Measured(what, feeds[-1], "mm")))
        turns.append(FourFeeds(*feeds))
        keep(turns[-1])
    listener(Event("run-out", "back to where it was found", total, total))
    for name in (
        "spindle",
        "x",
        "y",
    ):  # every angle is clear at the start position; elsewhere only the initial angle is known to be
        if name in found_at:
            session.move(name, found_at[name])
    seconds = (session.clock.now_ns() - began_ns) / NS_PER_S
    return RunOutMeasurement(tuple(turns), _found(config, turns), session.mode, seconds)


def contact_name(turn: int, angle_deg: int) -> str:
    """Name of the feed to a contact of M90; turns count from 1."""
    return f"turn {turn}, {angle_deg}°"


def _found(config: ProbeMachineConfig, turns: Sequence[FourFeeds]) -> RunOut:
    block, pretravel_mm = config.block, config.probe.pretravel_mm
    return run_out(mean_feeds(turns), block.distance_mm, facing=block.facing, pretravel_mm=pretravel_mm)


@dataclass(frozen=True)
class Correction:
    """A correction that was driven, mm. counter_mm: its remainder in X and Y at the end."""

    code: CorrectionCode
    driven_mm: tuple[float, float]
    counter_mm: tuple[float, float]


def correct(session: ProbeSession, known: RunOut, code: CorrectionCode, listener: Listener = silent) -> Correction:
    """M91, M92, M93: moves X, Y or both by the run-out at the spindle's present angle.

    A counter starts at the correction and ends at zero, within a pulse: the spindle axis is then where the ball's
    centre was. Raises LimitError before any motion, FollowingErrorError for a counter that does not end at zero.
    """
    session.prepare()
    driven = known.correction_mm(code, session.angle_deg)
    pulse_mm = session.config.probe.pulse_mm
    targets: dict[str, float] = {}
    for name, wanted, amount_mm in (("x", code.in_x, driven[0]), ("y", code.in_y, driven[1])):
        if wanted:
            axis = session.config.x if name == "x" else session.config.require_y(code.value)
            targets[name] = session.place(name) + amount_mm
            axis.limits.check_target(targets[name])
    counters = {"x": 0.0, "y": 0.0}
    for name, target_mm in targets.items():
        listener(Event(code.value, f"driving {name} to {target_mm:.4f} mm"))
        session.move(name, target_mm)
        counters[name] = target_mm - session.place(name)
        if abs(counters[name]) > pulse_mm:
            raise FollowingErrorError(
                f"the counter of {name} ends at {1000 * counters[name]:+.2f} µm, expected 0 within {1000 * pulse_mm:g} µm"
            )
    return Correction(code, driven, (counters["x"], counters["y"]))


@dataclass(frozen=True)
class BoreCentre:
    """The centre of a bore, and the correction that was driven afterwards."""

    centring: Centring
    correction: Correction


def centre_bore(session: ProbeSession, known: RunOut, code: CorrectionCode, listener: Listener = silent) -> BoreCentre:
    """Touches a bore on both sides in X, then in Y through its middle, moves to half the travel, and makes the
    correction.

    The probe has to be in the bore already: Z is not moved. Afterwards the machine is where the correction moved it.
    Raises InputError without a bore or Y axis, StateError for a probe outside the bore, and as `ProbeSession.touch` and
    `correct`.
    """
    bore = session.config.require_bore()
    session.config.require_y("centring a bore")
    session.prepare()
    for name, middle_mm in (("x", bore.x_mm), ("y", bore.y_mm)):
        if abs(session.place(name) - middle_mm) > bore.reach_mm:
            raise StateError(
                f"{name} is at {session.place(name):.3f} mm, expected the probe in the bore, within {bore.reach_mm:g} mm of"
                f" {middle_mm:g} mm; nothing was moved"
            )
    session.move("x", bore.x_mm)
    session.move("y", bore.y_mm)
    contacts: dict[str, tuple[float, float]] = {}
    for number, name in enumerate(("x", "y")):
        listener(Event("bore", f"both sides in {name}", number, 2))
        low_mm = session.touch(name, -1, bore.reach_mm)
        high_mm = session.touch(name, 1, bore.reach_mm)
        contacts[name] = (low_mm, high_mm)
        session.move(name, (low_mm + high_mm) / 2.0)
    listener(Event("bore", "half the travel", 2, 2))
    centring = Centring(contacts["x"], contacts["y"], known, session.angle_deg, session.config.probe.pretravel_mm)
    return BoreCentre(centring, correct(session, known, code, listener))


@dataclass(frozen=True)
class Schedule:
    """The result of a schedule: number of measurements, and of refused ones."""

    done: int
    refused: int


def on_schedule(
    job: Callable[[], str | None], clock: Clock, every_s: float, times: int | None = None, listener: Listener = silent
) -> Schedule:
    """Runs a job now and at every multiple of `every_s` from now, `times` in all (None: until interrupted).

    job() returns why its measurement was refused, or None. A refusal is reported and the schedule continues; an error
    ends it, since a stopped machine is not moved again without an order. A time missed because the job took longer is
    left out.
    """
    start_ns, period_ns = clock.now_ns(), round(every_s * NS_PER_S)
    done = refused = 0
    while True:
        refusal = job()
        done += 1
        if refusal is not None:
            refused += 1
            listener(Event("schedule", f"refused: {refusal}"))
        if times is not None and done >= times:
            return Schedule(done, refused)
        turns_gone = (clock.now_ns() - start_ns) // period_ns
        due_ns = start_ns + (turns_gone + 1) * period_ns
        wait_s = (due_ns - clock.now_ns()) / NS_PER_S
        listener(Event("schedule", f"{done} measured, {refused} refused; the next in {wait_s:.0f} s"))
        clock.sleep_until_ns(due_ns)
