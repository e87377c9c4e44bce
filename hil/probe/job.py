"""Jobs of a machine with a touch probe (system D): M90 measured and stored, M91 to M93 driven, a bore centred; for
terminal and screen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from drivers.clock import NS_PER_S, Clock, Waiting, WallClock
from drivers.drive import ServoDrive
from hil.correction.sealed import load_private_key, load_public_key
from hil.desk.job import Job, Workplace
from hil.desk.plan import Move, Plan, PlannedWrite
from hil.machine.events import Listener, silent
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.procedure import (
    BoreCentre,
    Correction,
    FeatureMeasurement,
    HandledCode,
    RunOutMeasurement,
    centre_bore,
    correct,
    measure_and_store,
    measure_feature,
    serve_codes,
    ways,
)
from hil.probe.runout import ANGLES_DEG, CorrectionCode, RunOut
from hil.probe.session import ProbeSession
from hil.probe.store import RunOutStore, Seal
from hil.probe.wiring import control_wires, probe_bench, probe_drives, probe_session
from hil.records.rows import UM_PER_MM
from sim_backends.probe_bench import ProbeBench

MEASURE, CORRECT, CENTRE, OTHER = "probe measure", "probe correct", "probe centre", "probe other"

Ask = Callable[[], str]
OnConnected = Callable[[ProbeSession], None]
"""Is called with the session as soon as it is connected."""


RUN_OUT = "run-out"
"""Name of the opened store of the run-out at a desk."""


def opened_store(config: ProbeMachineConfig, reading: Ask, key: Ask | None = None) -> RunOutStore:
    """The store of the machine's run-out. A sealed one asks for its passwords, that of the builder's key first.

    key: only where something is to be written. Raises WrongPasswordError for the key's, and InputError; a wrong reading
    password shows when the store is read.
    """
    place = config.store
    if not place.sealed:
        return RunOutStore(place.directory, config.name)
    private = None if key is None else load_private_key(place.builder_key, key())
    password = reading()
    public = load_public_key(place.builder_public) if private is None else private.public_key()
    store = RunOutStore(place.directory, config.name, Seal(password, public, private))
    if private is not None:
        store.check_password()  # now, not after the measurement
    return store


# -- the machine -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ProbePlace:
    """The machine of a job: its file, its store, and, on the bench, the simulated machine with its drives.

    begun: start of the work; waiting: the object through which its clock waits; on_connected: called with each session as soon as it
    is connected
    """

    config: ProbeMachineConfig
    store: RunOutStore
    bench: ProbeBench | None
    drives: Mapping[str, ServoDrive]
    begun: datetime
    waiting: Waiting | None
    listener: Listener
    on_connected: OnConnected

    @property
    def clock(self) -> Clock:
        """The machine's clock: wall clock, or the bench's."""
        return WallClock(self.waiting) if self.bench is None else self.bench.clock

    def now(self) -> datetime:
        """The date in UTC; on the bench, the start plus the simulated time since."""
        if self.bench is None:
            return _date()
        return self.begun + timedelta(seconds=self.bench.clock.now_ns() / NS_PER_S)

    @contextmanager
    def session(self, *touching: str, mode: str | None = None) -> Iterator[ProbeSession]:
        """A connected session; real drives are released between the turns of a schedule. Raises as `probe_drives`."""
        with ExitStack() as stack:
            drives = self.drives or stack.enter_context(probe_drives(self.config, waiting=self.waiting))
            session = stack.enter_context(probe_session(self.config, drives, touching=touching, mode=mode))
            self.on_connected(session)
            yield session


def _date() -> datetime:
    return datetime.now(UTC).replace(microsecond=0)


@contextmanager
def at_machine(
    config: ProbeMachineConfig,
    store: RunOutStore,
    *,
    in_bore: bool = True,
    feature: str | None = None,
    waiting: Waiting | None = None,
    listener: Listener = silent,
    on_connected: OnConnected = lambda _session: None,
) -> Iterator[ProbePlace]:
    """The machine of a machine file. On the bench it starts before a feature, or in the bore, if there is one and in_bore."""
    if not config.on_bench:
        yield ProbePlace(config, store, None, {}, _date(), waiting, listener, on_connected)
        return
    begun = _date()
    bench = probe_bench(config, in_bore=in_bore and config.bore is not None, feature=feature, waiting=waiting)
    with probe_drives(config, bench) as drives:
        yield ProbePlace(config, store, bench, drives, begun, waiting, listener, on_connected)


# -- the work --------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class MeasuredRunOut:
    """The result of M90. refusal: why it was not put into force, None where it was"""

    measurement: RunOutMeasurement
    refusal: str | None


def measure(place: ProbePlace, mode: str | None = None) -> MeasuredRunOut:
    """M90: into the history, and into force unless it is refused. mode: the machine file's by default. Raises as
    `measure_run_out`.
    """
    with place.session("x", mode=mode) as session:
        return MeasuredRunOut(*measure_and_store(session, place.store, place.now, place.listener))


def drive_correction(place: ProbePlace, known: RunOut, code: CorrectionCode) -> Correction:
    """M91, M92 or M93 from the machine's present position. Raises as `correct`."""
    with place.session(*(("x", "y") if code.in_y else ("x",)), mode="step") as session:
        return correct(session, known, code, place.listener)


def centre(place: ProbePlace, known: RunOut, code: CorrectionCode, mode: str | None = None) -> BoreCentre:
    """Finds the bore's middle and moves to its centre. Raises as `centre_bore`."""
    with place.session("x", "y", mode=mode) as session:
        return centre_bore(session, known, code, place.listener)


def measure_other(
    place: ProbePlace, known: RunOut, name: str, mode: str | None = None, *, spindle_deg: float | None = None
) -> FeatureMeasurement:
    """Measures a face, its angle, a boss or a reference position. Raises as `measure_feature`."""
    with place.session("x", "y", mode=mode) as session:
        return measure_feature(session, known, name, spindle_deg=spindle_deg, listener=place.listener)


def serve(
    place: ProbePlace,
    *,
    times: int | None = None,
    wait_s: float | None = None,
    mode: str | None = None,
    keep: Callable[[HandledCode], None] = lambda _handled: None,
) -> list[HandledCode]:
    """Handles the codes that a control gives. Raises as `serve_codes` and `control_wires`."""
    touching = ("x", "y") if place.config.y is not None else ("x",)
    with place.session(*touching, mode=mode) as session, control_wires(place.config, session.drives) as wires:
        return serve_codes(
            session, wires, place.store, place.now, times=times, wait_s=wait_s, keep=keep, listener=place.listener
        )


# -- plans -----------------------------------------------------------------------------------------------------------------
def measuring_plan(config: ProbeMachineConfig, store: RunOutStore, mode: str) -> Plan:
    """M90: to the start, towards the face and back at each angle of the spindle; into force if it closes."""
    block, probe, spindle = config.block, config.probe, config.orientation
    moves = []
    if block.y_mm is not None:
        moves.append(_to(config, "y", block.y_mm))
    moves += [_to(config, "x", block.start_mm), *_heights(config, block.z_mm)]
    low_mm, high_mm = sorted((block.start_mm, block.start_mm + block.facing * block.search_mm))
    moves.append(Move(f"{_touching(mode)} {config.x.name}", low_mm, high_mm, probe.touch_mm_s))
    angles = [spindle.position_deg(angle) for angle in ANGLES_DEG]
    moves.append(Move(f"spindle {config.spindle.name}", min(angles), max(angles), spindle.velocity_deg_s, "turns"))
    writes = (PlannedWrite("run_out", str(store.path)), PlannedWrite("history", str(store.history_path)))
    return _plan(config, moves, writes, contacts=block.turns * len(ANGLES_DEG), locked=config.store.sealed)


def correction_plan(config: ProbeMachineConfig, known: RunOut, code: CorrectionCode) -> Plan:
    """M91 to M93: by the run-out at most, at any angle of the spindle."""
    return _plan(config, _corrections(config, known, code))


def centring_plan(config: ProbeMachineConfig, known: RunOut, code: CorrectionCode, mode: str) -> Plan:
    """To the bore's middle by the file, to both sides in X and in Y, and by the run-out."""
    bore, y = config.require_bore(), config.require_y("centring a bore")
    moves = []
    for axis, middle_mm in ((config.x, bore.x_mm), (y, bore.y_mm)):
        ends_mm = middle_mm - bore.reach_mm, middle_mm + bore.reach_mm
        moves.append(Move(f"bore_{_touching(mode)} {axis.name}", *ends_mm, config.probe.touch_mm_s))
    places = [_to(config, "x", bore.x_mm), _to(config, "y", bore.y_mm), *_heights(config, bore.z_mm)]
    return _plan(config, [*places, *moves, *_corrections(config, known, code)], contacts=4)


def feature_plan(config: ProbeMachineConfig, name: str, mode: str) -> Plan:
    """To the places before the contacts, and by the search travel towards each."""
    feature, probe = config.require_feature(name), config.probe
    places = [way.ordered(place) for way in ways(feature) for place in way.places]
    moves = _heights(config, feature.z_mm)
    for axis in ("x", "y"):
        reached_mm = [place[axis] for place in places]
        moves.append(Move(f"between {config.axes[axis].name}", min(reached_mm), max(reached_mm), probe.position_mm_s))
    for way in ways(feature):
        start_mm = way.ordered(way.places[-1])[way.axis]
        low_mm, high_mm = sorted((start_mm, start_mm + way.direction * feature.search_mm))
        moves.append(Move(f"other_{_touching(mode)} {config.axes[way.axis].name}", low_mm, high_mm, probe.touch_mm_s))
    return _plan(config, list(dict.fromkeys(moves)), contacts=len(ways(feature)))


def _touching(mode: str) -> str:
    return "touch" if mode == "latch" else "step"


def _to(config: ProbeMachineConfig, name: str, place_mm: float) -> Move:
    return Move(f"place {config.axes[name].name}", place_mm, place_mm, config.probe.position_mm_s, "goes")


def _heights(config: ProbeMachineConfig, z_mm: float | None) -> list[Move]:
    """Z between two places and where something is touched; none where Z is the operator's."""
    return [_to(config, "z", height_mm) for height_mm in config.heights_mm(z_mm) or ()]


def _corrections(config: ProbeMachineConfig, known: RunOut, code: CorrectionCode) -> list[Move]:
    most_mm, speed = known.size_um / UM_PER_MM, config.probe.position_mm_s
    axes = [config.x] if code.in_x else []
    axes += [config.require_y(config.codes.name(code))] if code.in_y else []
    return [Move(f"correct {axis.name}", -most_mm, most_mm, speed, "drives") for axis in axes]


def _plan(
    config: ProbeMachineConfig,
    moves: list[Move],
    writes: tuple[PlannedWrite, ...] = (),
    *,
    contacts: int = 0,
    locked: bool = False,
) -> Plan:
    names = ", ".join(axis.name for axis in config.axes.values())
    overtravel_mm = config.probe.overtravel_mm if contacts else None
    return Plan(
        names,
        config.x.drive.backend,
        tuple(moves),
        writes,
        config.home,
        positions=contacts,
        overtravel_mm=overtravel_mm,
        locked=locked,
        store=RUN_OUT if locked else "",
    )


# -- for the desk ----------------------------------------------------------------------------------------------------------
def measuring_job(config: ProbeMachineConfig, store: RunOutStore, mode: str) -> Job:
    """Job that returns a MeasuredRunOut."""

    def work(place: Workplace) -> MeasuredRunOut:
        with _shown_at(config, store, place, in_bore=False) as there:
            return measure(there, mode)

    plan = measuring_plan(config, store, mode)
    return Job(MEASURE, plan, work, connects=True, reached=lambda measured: measured.refusal is None)


def correction_job(config: ProbeMachineConfig, store: RunOutStore, known: RunOut, code: CorrectionCode) -> Job:
    """Job that returns a Correction. known: the run-out in force"""

    def work(place: Workplace) -> Correction:
        with _shown_at(config, store, place) as there:
            return drive_correction(there, known, code)

    return Job(CORRECT, correction_plan(config, known, code), work, connects=True)


def centring_job(config: ProbeMachineConfig, store: RunOutStore, known: RunOut, code: CorrectionCode, mode: str) -> Job:
    """Job that returns a BoreCentre. known: the run-out in force"""

    def work(place: Workplace) -> BoreCentre:
        with _shown_at(config, store, place) as there:
            return centre(there, known, code, mode)

    return Job(CENTRE, centring_plan(config, known, code, mode), work, connects=True)


def feature_job(config: ProbeMachineConfig, store: RunOutStore, known: RunOut, name: str, mode: str) -> Job:
    """Job that returns a FeatureMeasurement, at the spindle's present angle. known: the run-out in force"""

    def work(place: Workplace) -> FeatureMeasurement:
        with _shown_at(config, store, place, feature=name) as there:
            return measure_other(there, known, name, mode)

    return Job(OTHER, feature_plan(config, name, mode), work, connects=True)


def _shown_at(
    config: ProbeMachineConfig,
    store: RunOutStore,
    place: Workplace,
    *,
    in_bore: bool = True,
    feature: str | None = None,
) -> AbstractContextManager[ProbePlace]:
    """As `at_machine`; the samples of the machine's axes are shown at the desks that otherwise have these axes."""

    def show(session: ProbeSession) -> None:
        for name, axis in config.axes.items():
            place.watch(axis.name, session.drives[name], None)

    return at_machine(
        config,
        store,
        in_bore=in_bore,
        feature=feature,
        waiting=place.waiting,
        listener=place.listener,
        on_connected=show,
    )


def codes(config: ProbeMachineConfig) -> tuple[CorrectionCode, ...]:
    """The corrections that the machine's axes can make."""
    return tuple(code for code in CorrectionCode if config.y is not None or not code.in_y)
