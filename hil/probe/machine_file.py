"""The machine file of a touch probe: which axes, where the reference block and the bore stand, and how to touch them.

TOML, as the axis files it names: an unknown key is an error, and every place a procedure will go to is held against the limits of the
axis files here, before anything is connected. The example in hil/examples/probe_machine.toml shows every section.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
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
from hil.probe import MODES
from hil.probe.runout import ANGLES_DEG, CorrectionCode


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
    z_mm: Number | None = None
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
    z_mm: Number | None = None


@dataclass(frozen=True)
class FaceConfig:
    """A single face: from x_mm and y_mm, clear of it, `axis` is fed in a direction by search_mm at most."""

    axis: Annotated[str, one_of("x", "y")]
    x_mm: Number
    y_mm: Number
    direction: Sign
    search_mm: Positive
    z_mm: Number | None = None

    @property
    def across(self) -> str:
        """The axis along the face."""
        return "y" if self.axis == "x" else "x"

    def start_mm(self, across_by_mm: float = 0.0) -> dict[str, float]:
        """Place where feeding begins, moved along the face."""
        start = {"x": self.x_mm, "y": self.y_mm}
        start[self.across] += across_by_mm
        return start


@dataclass(frozen=True)
class AngleConfig(FaceConfig):
    """A face whose angle is measured: touched at its start and apart_mm further along the other axis."""

    apart_mm: Number = 10.0

    def __post_init__(self) -> None:
        if self.apart_mm == 0.0:
            raise SchemaError("apart_mm", "is 0, expected a distance between both contacts")


@dataclass(frozen=True)
class BossConfig:
    """A boss: its approximate middle. The spindle goes round it on a square of ± clear_mm, on which the ball is clear, and
    feeds inward by search_mm at most."""

    x_mm: Number
    y_mm: Number
    clear_mm: Positive
    search_mm: Positive
    z_mm: Number | None = None

    def __post_init__(self) -> None:
        if not self.search_mm < self.clear_mm:
            raise SchemaError("search_mm", f"is {self.search_mm:g}, expected less than clear_mm, {self.clear_mm:g}")


@dataclass(frozen=True)
class ReferenceConfig:
    """A reference position: where a face across X and one across Y would meet. x_from_mm, y_from_mm: [x, y] where feeding X,
    and Y, begins; nominal_mm: [x, y] where the position should be."""

    x_from_mm: tuple[Number, Number]
    x_direction: Sign
    y_from_mm: tuple[Number, Number]
    y_direction: Sign
    search_mm: Positive
    nominal_mm: tuple[Number, Number] | None = None
    z_mm: Number | None = None

    @property
    def faces(self) -> dict[str, FaceConfig]:
        """Both faces, by the axis that is fed."""
        return {
            "x": FaceConfig("x", *self.x_from_mm, self.x_direction, self.search_mm, self.z_mm),
            "y": FaceConfig("y", *self.y_from_mm, self.y_direction, self.search_mm, self.z_mm),
        }


Feature = FaceConfig | AngleConfig | BossConfig | ReferenceConfig
FEATURES: Mapping[str, type[Feature]] = {
    "face": FaceConfig,
    "angle": AngleConfig,
    "boss": BossConfig,
    "reference": ReferenceConfig,
}
"""What can be measured beside a bore, by the name of its section."""


@dataclass(frozen=True)
class ApproachConfig:
    """Approach in Z. safe_mm: where the ball is above everything, for the ways between two places; lower_mm_s: speed
    towards a place where something is touched."""

    safe_mm: Number
    lower_mm_s: Positive = 2.0


Bit = Annotated[int, Limits(ge=0, le=31, description="a bit, 0 to 31")]


@dataclass(frozen=True)
class CodesConfig:
    """The M codes: their numbers, and the wires by which a control gives them and gets MFIN.

    drive: "x", "y" or "spindle", whose terminals or whose bus; None: no control is wired. station: node or unit of an I/O
    module on that drive's bus instead of the drive itself. Bits are those of the inputs (60FDh; 6000h of a module; discrete
    inputs from inputs_start) and of the outputs (60FEh; 6200h; coils from outputs_start). coding: code_bits show number −
    first, in "binary" or "bcd", or each is the line of one code ("lines": first, first + 1, …; no strobe is needed then).
    alive_bit: an input that is on while the control runs and the cable is whole
    measure, x, y, both: the numbers that measure and correct. JPH08348B2 does not define them beyond doubt: its table is
    lost, correction begins by M91, and "M29" sets the flag of X.
    """

    drive: Annotated[str, one_of("x", "y", "spindle")] | None = None
    station: Annotated[int, Limits(ge=1, le=247)] | None = None
    strobe_bit: Bit | None = None
    code_bits: tuple[Bit, ...] = ()
    coding: Annotated[str, one_of("binary", "bcd", "lines")] = "binary"
    first: Count = 90
    mfin_bit: Bit = 16
    alive_bit: Bit | None = None
    inputs_start: Count = 0
    outputs_start: Count = 0
    settle_s: NotNegative = 0.02
    poll_s: Positive = 0.01
    work_s: Positive = 600.0
    release_s: Positive = 5.0
    measure: Count = 90
    x: Count = 91
    y: Count = 92
    both: Count = 93

    def __post_init__(self) -> None:
        if len(set(self.numbers)) < len(self.numbers):
            raise SchemaError("measure", f"x, y and both are {self.numbers}, expected four different numbers")
        if self.drive is None:
            return
        if not self.code_bits:
            raise SchemaError("code_bits", "is empty, expected the inputs that carry the code")
        if self.strobe_bit is None and self.coding != "lines":
            raise SchemaError("strobe_bit", f"is missing, expected the input of the strobe, as coding is {self.coding}")
        bits = [*self.code_bits, *(bit for bit in (self.strobe_bit, self.alive_bit) if bit is not None)]
        if len(set(bits)) < len(bits):
            raise SchemaError("code_bits", f"strobe_bit and alive_bit are {bits}, expected different inputs")

    @property
    def numbers(self) -> tuple[int, int, int, int]:
        """The numbers of measure, x, y and both."""
        return self.measure, self.x, self.y, self.both

    @property
    def corrections(self) -> dict[int, CorrectionCode]:
        """What each number corrects."""
        return {self.x: CorrectionCode.M91, self.y: CorrectionCode.M92, self.both: CorrectionCode.M93}

    def name(self, code: CorrectionCode) -> str:
        """The code by which this machine's control asks for a correction, as "M91"."""
        return next(f"M{number}" for number, meant in self.corrections.items() if meant is code)

    def correction(self, name: str) -> CorrectionCode:
        """The correction that a code asks for. Raises InputError for another code."""
        for number, code in self.corrections.items():
            if name == f"M{number}":
                return code
        known = ", ".join(f"M{number}" for number in self.corrections)
        raise InputError(f"code is {name}, expected one of {known}")

    @property
    def inputs_read(self) -> int:
        """Number of inputs from the first to the last in use."""
        return 1 + max((*self.code_bits, self.strobe_bit or 0, self.alive_bit or 0))


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
    z: File | None = None
    home: bool = False


@dataclass(frozen=True)
class _BenchSection:
    seed: Count = 0
    chip_um: NotNegative = 0.0
    program: tuple[Count, ...] = ()


@dataclass(frozen=True)
class ProbeMachineConfig:
    """One machine with a probe. y is None for one without a second axis; bench_seed: of the simulated probe; bench_chip_um:
    thickness of a chip that lies on the simulated block at the first contact; bench_program: codes that a simulated control
    gives."""

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
    codes: CodesConfig = field(default_factory=CodesConfig)
    bench_program: tuple[int, ...] = ()
    z: DriveAxis | None = None
    approach: ApproachConfig | None = None
    features: Mapping[str, Feature] = field(default_factory=dict)

    @property
    def axes(self) -> dict[str, DriveAxis]:
        """The machine's axes by "x", "y", "z" and "spindle"."""
        axes = {"x": self.x, "y": self.y, "z": self.z, "spindle": self.spindle}
        return {name: axis for name, axis in axes.items() if axis is not None}

    def heights_mm(self, z_mm: float | None) -> tuple[float, float] | None:
        """Z between two places, and where something is touched; None where Z is the operator's."""
        return None if self.approach is None or z_mm is None else (self.approach.safe_mm, z_mm)

    def position_step_mm(self, mode: str) -> float:
        """Resolution of a contact's position, mm: the pulse of "step", else the drive's count."""
        return self.probe.pulse_mm if mode == "step" else self.x.scaling.resolution_load_mm

    def require_feature(self, name: str) -> Feature:
        """What is to be measured. Raises InputError where the machine file lacks it, or the Y axis for it."""
        if name not in self.features:
            raise InputError(f"lacks the table [{name}], expected where it is", path=self.path)
        self.require_y(f"[{name}]")
        return self.features[name]

    @property
    def on_bench(self) -> bool:
        return self.x.drive.backend == "bench"

    def require_y(self, what: str) -> DriveAxis:
        """The Y axis. Raises InputError where the machine file names none."""
        if self.y is None:
            raise InputError(f"[machine] names no y axis, expected one for {what}", path=self.path)
        return self.y

    def require_codes(self) -> str:
        """Name of the axis whose drive, or bus, has the control's wires. Raises InputError where no control is wired."""
        if self.codes.drive is None:
            raise InputError(
                "lacks [codes] drive, expected the drive whose inputs carry the control's codes", path=self.path
            )
        return self.codes.drive

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
    z = None if machine.z is None else load_drive_axis(machine.z)
    axes = [axis for axis in (x, y, z, spindle) if axis is not None]
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
        document.load(CodesConfig, "codes", required=False),
        bench.program,
        z,
        document.load(ApproachConfig, "approach") if "approach" in document else None,
        {name: document.load(kind, name) for name, kind in FEATURES.items() if name in document},
    )
    document.finish()
    if config.codes.drive is not None and config.codes.drive not in config.axes:
        raise document.fail("codes.drive", f"is {config.codes.drive}, an axis that [machine] does not name")
    _check(document, config)
    return config


Place = tuple[str, DriveAxis | None, tuple[float, ...]]
"""A key of the file, the axis that it moves, and where to."""


def _heights(document: Document, config: ProbeMachineConfig) -> list[Place]:
    """Places of Z. Raises InputError for a machine with a z axis of which one is missing."""
    sections: dict[str, float | None] = {"block": config.block.z_mm}
    if config.bore is not None:
        sections["bore"] = config.bore.z_mm
    sections |= {name: feature.z_mm for name, feature in config.features.items()}
    if config.z is not None:
        if config.approach is None:
            raise document.fail("machine.z", "is given, expected [approach] safe_mm beside it")
        for name, z_mm in sections.items():
            if z_mm is None:
                raise document.fail(name, "has no z_mm, which a machine with a z axis needs")
    places: list[Place] = [(f"{name}.z_mm", config.z, (z_mm,)) for name, z_mm in sections.items() if z_mm is not None]
    if config.approach is not None:
        places.append(("approach.safe_mm", config.z, (config.approach.safe_mm,)))
    return places


def _speeds_of_z(config: ProbeMachineConfig) -> list[tuple[str, float, list[DriveAxis]]]:
    if config.z is None or config.approach is None:
        return []
    return [
        ("approach.lower_mm_s", config.approach.lower_mm_s, [config.z]),
        ("probe.position_mm_s", config.probe.position_mm_s, [config.z]),
    ]


def _extent(name: str, feature: Feature, x: DriveAxis, y: DriveAxis | None) -> list[Place]:
    """How far X and Y go for a feature."""
    axes = {"x": x, "y": y}
    if isinstance(feature, BossConfig):
        clear_mm = feature.clear_mm
        return [
            (f"{name}.{one}_mm", axes[one], (middle - clear_mm, middle + clear_mm))
            for one, middle in (("x", feature.x_mm), ("y", feature.y_mm))
        ]
    places: list[Place] = []
    faces = feature.faces if isinstance(feature, ReferenceConfig) else {"": feature}
    for which, face in faces.items():
        start, end = face.start_mm(), face.start_mm(face.apart_mm if isinstance(face, AngleConfig) else 0.0)
        end[face.axis] += face.direction * face.search_mm
        key = f"{name}.{which}_from_mm" if which else f"{name}.search_mm"
        places += [(key, axes[one], (start[one], end[one])) for one in ("x", "y")]
    return places


def _places(document: Document, config: ProbeMachineConfig) -> list[Place]:
    """Every place that a procedure goes to."""
    x, y, block, orientation = config.x, config.y, config.block, config.orientation
    places: list[Place] = [
        ("spindle.zero_deg", config.spindle, tuple(orientation.position_deg(angle) for angle in ANGLES_DEG)),
        ("block.start_mm", x, (block.start_mm,)),
        ("block.search_mm", x, (block.start_mm + block.facing * block.search_mm,)),
    ]
    if block.y_mm is not None:
        places.append(("block.y_mm", y, (block.y_mm,)))
    places += _heights(document, config)
    for name, feature in config.features.items():
        places += _extent(name, feature, x, y)
    if (bore := config.bore) is not None:
        places.append(("bore.x_mm", x, (bore.x_mm - bore.reach_mm, bore.x_mm + bore.reach_mm)))
        places.append(("bore.y_mm", y, (bore.y_mm - bore.reach_mm, bore.y_mm + bore.reach_mm)))
    return places


def _check(document: Document, config: ProbeMachineConfig) -> None:
    """Hold speeds and places against the axis files."""
    x, y, probe, block = config.x, config.y, config.probe, config.block
    feeding = [axis for axis in (x, y) if axis is not None]
    for key, speed, axes in (
        ("spindle.velocity_deg_s", config.orientation.velocity_deg_s, [config.spindle]),
        ("probe.position_mm_s", probe.position_mm_s, feeding),
        ("probe.touch_mm_s", probe.touch_mm_s, feeding),
        *_speeds_of_z(config),
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
    places = _places(document, config)
    of_z = [key for key, _, _ in _heights(document, config)]
    for key, moved, targets in places:
        if moved is None:
            raise document.fail(key, f"is given, but [machine] names no {'z' if key in of_z else 'y'} axis")
        try:
            for target in targets:
                moved.limits.check_target(target)
        except LimitError as error:
            raise document.fail(key, f"leads axis {moved.name} out of its limits: {error}") from error
    if block.radius_limit_um is not None and probe.tip_radius_mm is None:
        raise document.fail("block.radius_limit_um", "needs [probe] tip_radius_mm, which is not there")
