"""The machine file of a touch probe: which axes, where the reference block and the bore stand, and how to touch them.

TOML, as the axis files it names: an unknown key is an error, and every place a procedure will go to is held against the limits of the
axis files here, before anything is connected. The example in hil/examples/probe_machine.toml shows every section.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import InputError, LimitError
from hil.axis import reader
from hil.axis.axis_file import DriveAxis, load_drive_axis, read_toml
from hil.axis.reader import Table
from hil.probe.runout import ANGLES_DEG

MODES = ("latch", "step")


@dataclass(frozen=True)
class SpindleConfig:
    """Orientation of the spindle. zero_deg: the drive's position that is called 0; sense: +1 where a rising position turns it
    counter-clockwise seen along the spindle axis."""

    zero_deg: float
    sense: int
    velocity_deg_s: float

    def position_deg(self, angle_deg: float) -> float:
        """The drive's position for an angle of the spindle."""
        return self.zero_deg + self.sense * angle_deg

    def angle_deg(self, position_deg: float) -> float:
        """The angle of the spindle at a position of the drive."""
        return self.sense * (position_deg - self.zero_deg)


@dataclass(frozen=True)
class ProbeConfig:
    """The probe and how to touch with it.

    mode: "latch" by the drive's touch-probe function, or "step" by pulses; input: of the drives, 1 or 2; normally_closed: the input
    is active without contact; tip_radius_mm: None where nobody knows it; settle_s: rest after a pulse; overtravel_mm: how far beyond a
    contact the ball may get; register, bit: where a Modbus drive shows the signal
    """

    mode: str
    input: int
    normally_closed: bool
    tip_radius_mm: float | None
    pretravel_mm: float
    position_mm_s: float
    touch_mm_s: float
    pulse_mm: float
    settle_s: float
    overtravel_mm: float
    register: str
    bit: int


@dataclass(frozen=True)
class BlockConfig:
    """The reference block, places of X (and Y) in machine mm.

    face_mm: where the spindle axis would be in the face; start_mm: where feeding begins; contact is expected after free_mm of feed and
    before search_mm; radius_limit_um None: the radius is not checked
    """

    face_mm: float
    start_mm: float
    y_mm: float | None
    free_mm: float
    search_mm: float
    turns: int
    closure_limit_um: float
    repeat_limit_um: float
    radius_limit_um: float | None

    @property
    def facing(self) -> int:
        """+1 where the face is met by feeding X in + direction."""
        return 1 if self.face_mm > self.start_mm else -1

    @property
    def distance_mm(self) -> float:
        """l: from the spindle axis at the start to the face."""
        return abs(self.face_mm - self.start_mm)


@dataclass(frozen=True)
class BoreConfig:
    """A bore: roughly where its middle is, and how far from there its walls may be for the spindle."""

    x_mm: float
    y_mm: float
    reach_mm: float


@dataclass(frozen=True)
class ProbeStoreConfig:
    """Where values in force and their history are kept. Paths are absolute."""

    directory: Path
    sealed: bool
    builder_key: Path
    builder_public: Path


@dataclass(frozen=True)
class ProbeMachineConfig:
    """One machine with a probe. y is None for one without a second axis; bench_seed: of the simulated probe; bench_chip_um:
    thickness of a chip that lies on the simulated block at the first contact."""

    path: Path
    name: str
    x: DriveAxis
    y: DriveAxis | None
    spindle: DriveAxis
    home: bool
    orientation: SpindleConfig
    probe: ProbeConfig
    block: BlockConfig
    bore: BoreConfig | None
    store: ProbeStoreConfig
    bench_seed: int
    bench_chip_um: float = 0.0

    @property
    def axes(self) -> dict[str, DriveAxis]:
        """Those the machine has, by "x", "y" and "spindle"."""
        return {"x": self.x, **({} if self.y is None else {"y": self.y}), "spindle": self.spindle}

    @property
    def on_bench(self) -> bool:
        return self.x.drive.backend == "bench"

    def require_y(self, what: str) -> DriveAxis:
        """The Y axis. Raises InputError where the machine file names none."""
        if self.y is None:
            raise InputError(f"[machine] names no y axis, expected one for {what}", path=self.path)
        return self.y

    def require_bore(self) -> BoreConfig:
        """The bore. Raises InputError where the machine file has none."""
        if self.bore is None:
            raise InputError("lacks the table [bore], expected where the bore is", path=self.path)
        return self.bore


def load_probe_machine(path: str | Path) -> ProbeMachineConfig:
    """Read a machine file and its axis files. Raises InputError, one line, naming file, line, value and what was expected."""
    root = read_toml(path)
    machine = root.child("machine")
    name = machine.take("name", reader.name, "a name of letters, digits, _ . -")
    x, y, spindle = (_axis(machine, key, required=key != "y") for key in ("x", "y", "spindle"))
    home = machine.take("home", reader.flag, "true or false", False)
    machine.finish(("name", "x", "y", "spindle", "home"))
    if x is None or spindle is None:
        raise machine.fail("x", "is needed")
    used = [axis.path.resolve() for axis in (x, y, spindle) if axis is not None]
    if len(set(used)) < len(used):
        raise machine.fail("x", "names the same axis file as another axis, expected one for each")
    backends = {axis.drive.backend == "bench" for axis in (x, y, spindle) if axis is not None}
    if len(backends) > 1:
        raise machine.fail("x", "is on the bench and another axis is not, expected all or none")
    config = ProbeMachineConfig(
        root.path,
        name,
        x,
        y,
        spindle,
        home,
        _orientation(root.child("spindle", required=False), spindle),
        _probe(root.child("probe"), x, y),
        _block(root.child("block"), x, y),
        _bore(root, x, y),
        _store(root.child("store", required=False), root.path, name),
        *_bench(root.child("bench", required=False)),
    )
    root.finish(("machine", "spindle", "probe", "block", "bore", "store", "bench"))
    if config.block.radius_limit_um is not None and config.probe.tip_radius_mm is None:
        raise InputError("[block] radius_limit_um needs [probe] tip_radius_mm, which is not there", path=root.path)
    return config


def _axis(table: Table, key: str, *, required: bool) -> DriveAxis | None:
    base = table.path.resolve().parent
    default = reader.REQUIRED if required else None
    file = table.take(key, reader.text, "an axis file", default)
    return None if file is None else load_drive_axis(base / file)


def _within(table: Table, key: str, axis: DriveAxis, *places: float) -> None:
    """Every place lies within an axis file's limits."""
    for place in places:
        try:
            axis.limits.check_target(place)
        except LimitError as error:
            raise table.fail(key, f"leads axis {axis.name} out of its limits: {error}") from error


def _slow_enough(table: Table, key: str, speed: float, *axes: DriveAxis | None) -> None:
    for axis in axes:
        if axis is not None and speed > axis.limits.max_velocity_mm_s:
            raise table.fail(
                key, f"is {speed:g}, expected at most {axis.limits.max_velocity_mm_s:g}, the limit of axis {axis.name}"
            )


def _orientation(table: Table, spindle: DriveAxis) -> SpindleConfig:
    config = SpindleConfig(
        table.take("zero_deg", reader.finite, "an angle in degrees", 0.0),
        table.take("sense", reader.choice(1, -1), "1 (counter-clockwise) or -1", 1),
        table.take("velocity_deg_s", reader.positive, "a number > 0 in degrees/s", 90.0),
    )
    table.finish()
    _within(table, "zero_deg", spindle, *(config.position_deg(angle) for angle in ANGLES_DEG))
    _slow_enough(table, "velocity_deg_s", config.velocity_deg_s, spindle)
    return config


def _probe(table: Table, x: DriveAxis, y: DriveAxis | None) -> ProbeConfig:
    number = table.take("input", reader.choice(1, 2), "1 or 2", 1)
    config = ProbeConfig(
        mode=table.take("mode", reader.choice(*MODES), " or ".join(MODES), "latch"),
        input=number,
        normally_closed=table.take("normally_closed", reader.flag, "true or false", False),
        tip_radius_mm=table.take("tip_radius_mm", reader.positive, "a number > 0 in mm", None),
        pretravel_mm=table.take("pretravel_mm", reader.not_negative, "a number >= 0 in mm", 0.0),
        position_mm_s=table.take("position_mm_s", reader.positive, "a number > 0 in mm/s", 10.0),
        touch_mm_s=table.take("touch_mm_s", reader.positive, "a number > 0 in mm/s", 2.0),
        pulse_mm=table.take("pulse_mm", reader.positive, "a number > 0 in mm", 0.001),
        settle_s=table.take("settle_s", reader.not_negative, "a number >= 0 in s", 0.02),
        overtravel_mm=table.take("overtravel_mm", reader.positive, "a number > 0 in mm", 1.0),
        register=table.take("register", reader.text, "a register of the drive's map", "digital_inputs"),
        bit=table.take("bit", reader.whole(0, 31), "a bit, 0 to 31", 15 + number),
    )
    table.finish()
    _slow_enough(table, "position_mm_s", config.position_mm_s, x, y)
    _slow_enough(table, "touch_mm_s", config.touch_mm_s, x, y)
    for axis in (x, y):
        if axis is not None and config.pulse_mm < axis.scaling.resolution_load_mm:
            raise table.fail(
                "pulse_mm",
                f"is {config.pulse_mm:g} mm, expected at least one count of axis {axis.name},"
                f" {axis.scaling.resolution_load_mm:g} mm",
            )
    return config


def _block(table: Table, x: DriveAxis, y: DriveAxis | None) -> BlockConfig:
    config = BlockConfig(
        face_mm=table.take("face_mm", reader.finite, "a position of X in mm"),
        start_mm=table.take("start_mm", reader.finite, "a position of X in mm"),
        y_mm=table.take("y_mm", reader.finite, "a position of Y in mm", None),
        free_mm=table.take("free_mm", reader.not_negative, "a number >= 0 in mm", 0.0),
        search_mm=table.take("search_mm", reader.positive, "a number > 0 in mm"),
        turns=table.take("turns", reader.whole(1, 100), "a whole number > 0", 2),
        closure_limit_um=table.take("closure_limit_um", reader.positive, "a number > 0 in µm", 3.0),
        repeat_limit_um=table.take("repeat_limit_um", reader.positive, "a number > 0 in µm", 3.0),
        radius_limit_um=table.take("radius_limit_um", reader.positive, "a number > 0 in µm", None),
    )
    table.finish()
    if config.distance_mm == 0:
        raise table.fail("start_mm", f"is face_mm, {config.face_mm:g}, expected a distance between them")
    if not config.free_mm < config.search_mm:
        raise table.fail("free_mm", f"is {config.free_mm:g}, expected less than search_mm, {config.search_mm:g}")
    _within(table, "start_mm", x, config.start_mm)
    _within(table, "search_mm", x, config.start_mm + config.facing * config.search_mm)
    if config.y_mm is not None:
        if y is None:
            raise table.fail("y_mm", "is given, but [machine] names no y axis")
        _within(table, "y_mm", y, config.y_mm)
    return config


def _bore(root: Table, x: DriveAxis, y: DriveAxis | None) -> BoreConfig | None:
    if "bore" not in root.keys_left():
        return None
    table = root.child("bore")
    config = BoreConfig(
        table.take("x_mm", reader.finite, "a position of X in mm"),
        table.take("y_mm", reader.finite, "a position of Y in mm"),
        table.take("reach_mm", reader.positive, "a number > 0 in mm"),
    )
    table.finish()
    if y is None:
        raise table.fail("y_mm", "is given, but [machine] names no y axis")
    for key, axis, place in (("x_mm", x, config.x_mm), ("y_mm", y, config.y_mm)):
        _within(table, key, axis, place - config.reach_mm, place + config.reach_mm)
    return config


def _store(table: Table, path: Path, name: str) -> ProbeStoreConfig:
    base = path.resolve().parent

    def place(value: Any) -> Path:
        return base / reader.text(value)

    config = ProbeStoreConfig(
        table.take("directory", place, "a folder", base / f"{name}-probe"),
        table.take("sealed", reader.flag, "true or false", False),
        table.take("builder_key", place, "a file", base / "builder.key"),
        table.take("builder_public", place, "a file", base / "builder.pub"),
    )
    table.finish()
    return config


def _bench(table: Table) -> tuple[int, float]:
    seed = table.take("seed", reader.whole(0, 2**31), "a whole number >= 0", 0)
    chip_um = table.take("chip_um", reader.not_negative, "a number >= 0 in µm", 0.0)
    table.finish()
    return seed, chip_um
