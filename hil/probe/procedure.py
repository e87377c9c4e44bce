"""System D (JPH08348B2): a touch probe's run-out measured on the machine (M90), corrected (M91 to M93), and a bore centred with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from drivers.clock import NS_PER_S, Clock
from drivers.errors import FollowingErrorError, MotionTimeoutError, StateError
from hil.machine.events import Event, Listener, Measured, silent
from hil.probe.codes import CodeError, HandShake, HandshakePhase
from hil.probe.machine_file import AngleConfig, BossConfig, FaceConfig, Feature, ProbeMachineConfig, ReferenceConfig
from hil.probe.runout import (
    ANGLES_DEG,
    Ball,
    Centring,
    CorrectionCode,
    FourFeeds,
    MeasurementRefusedError,
    RunOut,
    Touch,
    boss_mm,
    check_radius,
    check_repeat,
    mean_feeds,
    run_out,
)
from hil.probe.session import ControlWires, ProbeSession
from hil.probe.store import RunOutStore
from hil.records.rows import UM_PER_MM


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

    Without an approach in Z the probe has to be at the face's height. Afterwards the machine is at its initial
    position. The result is returned whether or not it closes; `RunOutMeasurement.refusal` decides. keep: receives each
    turn when it is complete.
    Raises ContactError, LimitError, StateError and CapabilityError as `ProbeSession` does.
    """
    config, block = session.config, session.config.block
    began_ns = session.clock.now_ns()
    session.prepare()
    found_at = {name: session.place(name) for name in config.axes}
    across = {} if block.y_mm is None else {"y": block.y_mm}
    session.approach({**across, "x": block.start_mm}, block.z_mm)
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
    session.leave(found_at)
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
            axis = session.config.x if name == "x" else session.config.require_y(session.config.codes.name(code))
            targets[name] = session.place(name) + amount_mm
            axis.limits.check_target(targets[name])
    counters = {"x": 0.0, "y": 0.0}
    for name, target_mm in targets.items():
        listener(Event(session.config.codes.name(code), f"driving {name} to {target_mm:.4f} mm"))
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

    Without an approach in Z the probe has to be in the bore already. Afterwards the machine is where the correction moved it.
    Raises InputError without a bore or Y axis, StateError for a probe outside the bore, and as `ProbeSession.touch` and
    `correct`.
    """
    bore = session.config.require_bore()
    session.config.require_y("centring a bore")
    session.prepare()
    for name, middle_mm in (("x", bore.x_mm), ("y", bore.y_mm)):
        if session.config.approach is None and abs(session.place(name) - middle_mm) > bore.reach_mm:
            raise StateError(
                f"{name} is at {session.place(name):.3f} mm, expected the probe in the bore, within {bore.reach_mm:g} mm of"
                f" {middle_mm:g} mm; nothing was moved"
            )
    session.approach({"x": bore.x_mm, "y": bore.y_mm}, bore.z_mm)
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
class FeatureMeasurement:
    """A face, its angle, a boss or a reference position, measured with the run-out in force.

    touches: the contacts in their order; spindle_deg: the spindle's angle; corrected, uncorrected: the results by name, mm,
    µm and degrees as their names say, with and without the run-out
    """

    name: str
    touches: tuple[Touch, ...]
    spindle_deg: float
    corrected: Mapping[str, float]
    uncorrected: Mapping[str, float]


def measure_feature(
    session: ProbeSession, known: RunOut, name: str, *, spindle_deg: float | None = None, listener: Listener = silent
) -> FeatureMeasurement:
    """Touches what a section of the machine file describes ("face", "angle", "boss" or "reference") and corrects the result.

    spindle_deg: angle to which the spindle is turned before; None: as it stands. All contacts are made at that angle, and
    afterwards the machine is where it was. Without an approach in Z the probe has to be at the height for it.
    Raises InputError without such a section, and as `ProbeSession.touch`.
    """
    config, feature = session.config, session.config.require_feature(name)
    session.prepare()
    found_at = {axis: session.place(axis) for axis in config.axes}
    first, total = ways(feature)[0], len(ways(feature))
    session.approach(first.ordered(first.places[0]), feature.z_mm, spindle_deg)
    touches: list[Touch] = []
    for number in range(total):
        way, what = ways(feature)[number], f"contact {number + 1}"
        listener(Event(name, what, number, total))
        _follow(session, way)
        contact_mm = session.touch(way.axis, way.direction, feature.search_mm)
        x_mm, y_mm = (contact_mm if axis == way.axis else session.place(axis) for axis in ("x", "y"))
        touches.append(Touch(way.axis, way.direction, (x_mm, y_mm)))
        listener(Event(name, what, number + 1, total, Measured(what, contact_mm, "mm")))
        if isinstance(feature, BossConfig) and number == 1:  # Y is touched through the middle, as in a bore
            feature = replace(feature, x_mm=(touches[0].at_mm[0] + touches[1].at_mm[0]) / 2.0)
    angle_deg = session.angle_deg
    _follow(session, _way_back(feature))
    session.leave(found_at)
    ball = Ball.of(known, angle_deg, config.probe.pretravel_mm)
    corrected, uncorrected = (_results(feature, touches, one) for one in (ball, ball.uncorrected))
    return FeatureMeasurement(name, tuple(touches), angle_deg, corrected, uncorrected)


@dataclass(frozen=True)
class ProbePath:
    """Places of X and Y, one after the other, to where an axis is fed in a direction."""

    places: tuple[tuple[float, float], ...]
    axis: str
    direction: int = 1

    def ordered(self, place: tuple[float, float]) -> dict[str, float]:
        """A place in the order of moving: first the axis that is fed, so that it is clear of the face."""
        targets = {"x": place[0], "y": place[1]}
        return {self.axis: targets.pop(self.axis), **targets}


def _follow(session: ProbeSession, way: ProbePath) -> None:
    for place in way.places:
        for name, target_mm in way.ordered(place).items():
            session.move(name, target_mm)


def _of_face(face: FaceConfig, across_by_mm: float = 0.0) -> ProbePath:
    start = face.start_mm(across_by_mm)
    return ProbePath(((start["x"], start["y"]),), face.axis, face.direction)


def ways(feature: Feature) -> list[ProbePath]:
    """The ways to the contacts. Round a boss they are sides of a square."""
    if isinstance(feature, BossConfig):
        x, y, c = feature.x_mm, feature.y_mm, feature.clear_mm
        return [
            ProbePath(((x - c, y),), "x", 1),
            ProbePath(((x - c, y + c), (x + c, y + c), (x + c, y)), "x", -1),
            ProbePath(((x + c, y - c), (x, y - c)), "y", 1),
            ProbePath(((x + c, y - c), (x + c, y + c), (x, y + c)), "y", -1),
        ]
    if isinstance(feature, ReferenceConfig):
        return [_of_face(face) for face in feature.faces.values()]
    if isinstance(feature, AngleConfig):
        return [_of_face(feature), _of_face(feature, feature.apart_mm)]
    return [_of_face(feature)]


def _way_back(feature: Feature) -> ProbePath:
    """From the last contact to where the first one was fed from."""
    first = ways(feature)[0]
    if isinstance(feature, BossConfig):
        corner = (first.places[0][0], feature.y_mm + feature.clear_mm)
        return replace(first, places=(corner, *first.places), axis="x")
    return first


def _results(feature: Feature, touches: Sequence[Touch], ball: Ball) -> dict[str, float]:
    """What the contacts give for a ball, by name."""
    if isinstance(feature, BossConfig):
        x_mm, width_x_mm = boss_mm(ball, touches[0], touches[1])
        y_mm, width_y_mm = boss_mm(ball, touches[2], touches[3])
        return {"x_mm": x_mm, "y_mm": y_mm, "width_x_mm": width_x_mm, "width_y_mm": width_y_mm}
    if isinstance(feature, ReferenceConfig):
        x_mm, y_mm = (ball.face_mm(touch) for touch in touches)
        off = {}
        if feature.nominal_mm is not None:
            off = {"off_x_um": x_mm - feature.nominal_mm[0], "off_y_um": y_mm - feature.nominal_mm[1]}
        return {"x_mm": x_mm, "y_mm": y_mm, **{name: UM_PER_MM * off_mm for name, off_mm in off.items()}}
    if isinstance(feature, AngleConfig):
        across = 1 - touches[0].index
        across_mm = (touches[0].at_mm[across] + touches[1].at_mm[across]) / 2.0
        face_mm = ball.inclined_face_mm(touches[0], touches[1], across_mm)
        return {"angle_deg": ball.angle_deg(touches[0], touches[1]), "face_mm": face_mm, "across_mm": across_mm}
    return {"face_mm": ball.face_mm(touches[0])}


@dataclass(frozen=True)
class HandledCode:
    """A code that a control gave: its number, and what was done about it."""

    number: int
    did: RunOutMeasurement | Correction

    @property
    def name(self) -> str:
        return f"M{self.number}"


def serve_codes(
    session: ProbeSession,
    wires: ControlWires,
    store: RunOutStore,
    now: Callable[[], datetime],
    *,
    times: int | None = None,
    wait_s: float | None = None,
    keep: Callable[[HandledCode], None] = lambda _handled: None,
    listener: Listener = silent,
) -> list[HandledCode]:
    """Handles the codes of a control as they come, `times` in all (None: until interrupted); each is given to `keep`.

    Between two codes the axes are without power. wait_s: longest wait for a code; None: without limit. A code that is not
    handled, for whatever reason, gets no MFIN and ends this: the control waits, and nothing moves.
    Raises CodeError, MeasurementRefusedError for a run-out that is refused, InputError for a correction without one in
    force, MotionTimeoutError after wait_s, and as `measure_run_out` and `correct`.
    """
    codes, clock = session.config.codes, session.clock
    shake = HandShake(codes, clock.now_ns() / NS_PER_S)
    handled: list[HandledCode] = []
    waiting_since_s = clock.now_ns() / NS_PER_S

    def look() -> int | None:
        return shake.saw(wires.inputs(), clock.now_ns() / NS_PER_S)

    listener(Event("codes", "waiting for a code"))
    while times is None or len(handled) < times or shake.phase is not HandshakePhase.WAITING:
        acknowledged = shake.mfin
        number = look()
        if acknowledged and not shake.mfin:
            _acknowledge(wires, on=False)
        if number is not None:
            listener(Event("codes", f"M{number}"))
            session.beside = lambda: _still(look())
            try:
                handled.append(HandledCode(number, _handle(session, store, number, now, listener)))
                session.rest()
                look()
            finally:
                session.beside = lambda: None
            shake.done(clock.now_ns() / NS_PER_S)
            _acknowledge(wires, on=True)
            keep(handled[-1])
            listener(Event("codes", f"M{number} handled, MFIN on"))
            waiting_since_s = clock.now_ns() / NS_PER_S
        elif wait_s is not None and clock.now_ns() / NS_PER_S - waiting_since_s > wait_s:
            raise MotionTimeoutError(f"no code within {wait_s:g} s, {len(handled)} handled before")
        clock.sleep_s(codes.poll_s)
    return handled


def _still(number: int | None) -> None:
    """A reading while a code is handled gives no new one."""
    if number is not None:
        raise CodeError(f"M{number} came while another code was handled")


def _acknowledge(wires: ControlWires, *, on: bool) -> None:
    """Switches MFIN. Raises CodeError where it does not follow."""
    wires.set_mfin(on)
    if wires.mfin() is not on:
        raise CodeError(f"MFIN was switched {'on' if on else 'off'}, and the drive shows it otherwise")


def _handle(
    session: ProbeSession, store: RunOutStore, number: int, now: Callable[[], datetime], listener: Listener
) -> RunOutMeasurement | Correction:
    session.check()
    if number == session.config.codes.measure:
        measured, refusal = measure_and_store(session, store, now, listener)
        if refusal is not None:
            raise MeasurementRefusedError(f"M{number} gets no MFIN: {refusal}")
        return measured
    known, _ = store.load()
    return correct(session, known, session.config.codes.corrections[number], listener)


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
