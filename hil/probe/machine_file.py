"""The machine file of a touch probe: which axes, where the reference block and the bore stand, and how to touch them.

TOML, as the axis files it names: an unknown key is an error, and every place a procedure will go to is held against the limits of the
axis files here, before anything is connected. The example in hil/examples/probe_machine.toml shows every section.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from drivers.errors import InputError, LimitError
from drivers.toml_schema import Document
from drivers.toml_types import (
    Count,
    File,
    Folder,
    Limits,
    Name,
    NotNegative,
    Number,
    Positive,
    SchemaError,
    Sign,
    Text,
    one_of,
)
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.probe.runout import ANGLES_DEG

MODES = ("latch", "step")


@dataclass(frozen=True)
class SpindleConfig:
    """Orientation of the spindle. zero_deg: the drive's position at spindle angle 0; sense: +1 where a rising position
    turns it counter-clockwise seen along the spindle axis.
    """

    zero_deg: Number = 0.0
    sense: Sign = 1
    velocity_deg_s: Positive = 90.0

    def position_deg(self, angle_deg: float) -> float:
        """The drive's position for a spindle angle."""
        return self.zero_deg + self.sense * angle_deg

    def angle_deg(self, position_deg: float) -> float:
        """The spindle angle at a position of the drive."""
        return self.sense * (position_deg - self.zero_deg)


@dataclass(frozen=True)
class ProbeConfig:
    """The probe and its settings for touching.

    mode: "latch" by the drive's touch-probe function, or "step" by pulses; input: of the drives, 1 or 2;
    normally_closed: the input is active without contact; tip_radius_mm: None where it is not known; settle_s: rest
    after a pulse; overtravel_mm: largest travel of the ball beyond a contact; register, bit: where a Modbus drive shows
    the signal
    """

    mode: Annotated[str, one_of(*MODES)] = "latch"
    input: Annotated[int, one_of(1, 2)] = 1
    normally_closed: bool = False
    tip_radius_mm: Positive | None = None
    pretravel_mm: NotNegative = 0.0
    position_mm_s: Positive = 10.0
    touch_mm_s: Positive = 2.0
    pulse_mm: Positive = 0.001
    settle_s: NotNegative = 0.02
    overtravel_mm: Positive = 1.0
    register: Text = "digital_inputs"
    bit: Annotated[int, Limits(ge=0, le=31)] = 16


@dataclass(frozen=True)
class BlockConfig:
    """The reference block, positions of X (and Y) in machine mm.

    face_mm: X at which the spindle axis would be in the face; start_mm: start of feeding; contact is expected after
    free_mm of feed and before search_mm; radius_limit_um None: the radius is not checked
    """

    face_mm: Number
    start_mm: Number
    search_mm: Positive
    y_mm: Number | None = None
    free_mm: NotNegative = 0.0
    turns: Annotated[int, Limits(ge=1, le=100)] = 2
    closure_limit_um: Positive = 3.0
    repeat_limit_um: Positive = 3.0
    radius_limit_um: Positive | None = None

    def __post_init__(self) -> None:
        if self.distance_mm == 0:
            raise SchemaError("start_mm", f"is face_mm, {self.face_mm:g}, expected a distance between them")
        if not self.free_mm < self.search_mm:
            raise SchemaError("free_mm", f"is {self.free_mm:g}, expected less than search_mm, {self.search_mm:g}")

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
    """A bore: its approximate middle, and how far the spindle may move from there to touch the walls, mm."""

    x_mm: Number
    y_mm: Number
    reach_mm: Positive


@dataclass(frozen=True)
class ProbeStoreConfig:
    """Where the values in force and their history are kept. Paths are absolute."""

    directory: Folder
    builder_key: File
    builder_public: File
    sealed: bool = False


@dataclass(frozen=True)
class _MachineSection:
    name: Name
    x: File
    spindle: File
    y: File | None = None
    home: bool = False


@dataclass(frozen=True)
class _BenchSection:
    seed: Count = 0
    chip_um: NotNegative = 0.0


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
        """The machine's axes by "x", "y" and "spindle"."""
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
    document = Document.read(path)
    machine = document.load(_MachineSection, "machine")
    x, spindle = load_drive_axis(machine.x), load_drive_axis(machine.spindle)
    y = None if machine.y is None else load_drive_axis(machine.y)
    axes = [axis for axis in (x, y, spindle) if axis is not None]
    if len({axis.path.resolve() for axis in axes}) < len(axes):
        raise document.fail("machine.x", "names the same axis file as another axis, expected one for each")
    if len({axis.drive.backend == "bench" for axis in axes}) > 1:
        raise document.fail("machine.x", "is on the bench and another axis is not, expected all or none")
    base = document.path.resolve().parent
    store = {
        "directory": base / f"{machine.name}-probe",
        "builder_key": base / "builder.key",
        "builder_public": base / "builder.pub",
    }
    bench = document.load(_BenchSection, "bench", required=False)
    second = document.table("probe").get("input") == 2
    config = ProbeMachineConfig(
        document.path,
        machine.name,
        x,
        y,
        spindle,
        machine.home,
        document.load(SpindleConfig, "spindle", required=False),
        document.load(ProbeConfig, "probe", usual={"bit": 17 if second else 16}),
        document.load(BlockConfig, "block"),
        document.load(BoreConfig, "bore") if "bore" in document else None,
        document.load(ProbeStoreConfig, "store", usual=store, required=False),
        bench.seed,
        bench.chip_um,
    )
    document.finish()
    _check(document, config)
    return config


def _check(document: Document, config: ProbeMachineConfig) -> None:
    """Hold speeds and places against the axis files."""
    x, y, probe, block = config.x, config.y, config.probe, config.block
    feeding = [axis for axis in (x, y) if axis is not None]
    orientation = config.orientation
    for key, speed, axes in (
        ("spindle.velocity_deg_s", orientation.velocity_deg_s, [config.spindle]),
        ("probe.position_mm_s", probe.position_mm_s, feeding),
        ("probe.touch_mm_s", probe.touch_mm_s, feeding),
    ):
        for axis in axes:
            if speed > axis.limits.max_velocity_mm_s:
                what = (
                    f"is {speed:g}, expected at most {axis.limits.max_velocity_mm_s:g}, the limit of axis {axis.name}"
                )
                raise document.fail(key, what)
    for axis in feeding:
        if probe.pulse_mm < axis.scaling.resolution_load_mm:
            raise document.fail(
                "probe.pulse_mm",
                f"is {probe.pulse_mm:g} mm, expected at least one count of axis {axis.name},"
                f" {axis.scaling.resolution_load_mm:g} mm",
            )
    places: list[tuple[str, DriveAxis | None, tuple[float, ...]]] = [
        ("spindle.zero_deg", config.spindle, tuple(orientation.position_deg(angle) for angle in ANGLES_DEG)),
        ("block.start_mm", x, (block.start_mm,)),
        ("block.search_mm", x, (block.start_mm + block.facing * block.search_mm,)),
    ]
    if block.y_mm is not None:
        places.append(("block.y_mm", y, (block.y_mm,)))
    if (bore := config.bore) is not None:
        places.append(("bore.x_mm", x, (bore.x_mm - bore.reach_mm, bore.x_mm + bore.reach_mm)))
        places.append(("bore.y_mm", y, (bore.y_mm - bore.reach_mm, bore.y_mm + bore.reach_mm)))
    for key, moved, targets in places:
        if moved is None:
            raise document.fail(key, "is given, but [machine] names no y axis")
        try:
            for target in targets:
                moved.limits.check_target(target)
        except LimitError as error:
            raise document.fail(key, f"leads axis {moved.name} out of its limits: {error}") from error
    if block.radius_limit_um is not None and probe.tip_radius_mm is None:
        raise document.fail("block.radius_limit_um", "needs [probe] tip_radius_mm, which is not there")
