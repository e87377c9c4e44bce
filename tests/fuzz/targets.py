"""What is fuzzed: every parser of a file and every face of a protocol, each as a function of bytes that may raise only what it states.

A file's reader may raise InputError and nothing else; an instrument's decoder and a simulated drive nothing; a master BridgeError.
"""

from __future__ import annotations

import contextlib
import itertools
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

from hostile import files
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.eds import load_eds
from drivers.errors import BridgeError, InputError, LinkLostError
from drivers.instruments.ascii_values import AsciiDecoder, AsciiSettings
from drivers.instruments.gauge import Gauge
from drivers.instruments.nd2xx import Nd2xxDecoder
from drivers.instruments.replay import Recording
from drivers.instruments.umd_laser import UmdLaser
from drivers.instruments.values import ValueProtocol
from drivers.limits import DriveLimits
from drivers.modbus.endpoint import parse_endpoint
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_map import shipped_maps
from drivers.modbus.wire import Function, PymodbusWire, Request
from drivers.scaling import AxisScaling
from hil.axis.axis_file import load_axis
from hil.correction.formats import fanuc, keysight, linuxcnc, measured_csv, sinumerik, twincat, wide_iso
from hil.correction.manual import read_manual_tables
from hil.correction.rise import rise_from_json
from hil.correction.sealed import (
    check,
    check_detached,
    container,
    keys,
    load_private_key,
    load_public_key,
    seal,
    sign_detached,
)
from hil.correction.sealed.container import Cost, unpack
from hil.correction.tables import TableSet
from hil.diagnosis.next.plans import read_plan
from hil.diagnosis.stored import read_stored
from hil.effects.model import Model
from hil.figures.history import read_pass
from hil.files import iso230 as circles
from hil.parameters.formats import read_any
from hil.parameters.journal import Journal
from hil.parameters.set_file import read_set
from hil.probe.machine_file import load_probe_machine
from hil.records.files import parse_json
from hil.records.journal import check_resumable, read_purpose
from hil.records.made_with import MadeWith
from hil.records.rows import parse_csv
from hil.records.zero import Zero
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_framing import Frame, RtuDecoder, TcpDecoder, pack_rtu, pack_tcp
from sim_backends.modbus_registers import answer
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo

HOUSE = Path(__file__).parents[2]


@dataclass(frozen=True)
class Target:
    """run: raises nothing, or something that is a finding; seeds: good inputs; words: of a dictionary for the mutations."""

    run: Callable[[bytes], object]
    seeds: Sequence[bytes]
    words: Sequence[str] = ()
    longest: int = 4096
    raises: tuple[type[Exception], ...] = field(default=(InputError,))

    def __call__(self, data: bytes) -> None:
        """Once; what the target is allowed to raise is swallowed."""
        with contextlib.suppress(*self.raises):
            self.run(data)


@cache
def _folder() -> Path:
    root = "/dev/shm" if Path("/dev/shm").is_dir() else None
    return Path(tempfile.mkdtemp(prefix="fuzz-", dir=root))


def _file(read: Callable[[Path], object], name: str = "file") -> Callable[[bytes], object]:
    def run(data: bytes) -> object:
        path = _folder() / name
        path.write_bytes(data)
        return read(path)

    return run


def _text(read: Callable[[str], object]) -> Callable[[bytes], object]:
    def run(data: bytes) -> object:
        return read(data.decode("utf-8", "replace"))

    return run


def _both(*runs: Callable[[bytes], object], raises: type[Exception] = InputError) -> Callable[[bytes], None]:
    def run(data: bytes) -> None:
        for each in runs:
            with contextlib.suppress(raises):
                each(data)

    return run


# -- files -------------------------------------------------------------------------------------------------------------
HEAD = b"run,direction,target_mm,measured_mm\n"
ROWS = HEAD + b"1,1,0.0,0.001\n1,-1,10,10.002\n# withdrawn 1: why\n2,+1,0,-1e-3\n"
CAMPAIGN = b'{"axis": "X", "mode": "bidirectional"}'
DOWNLOAD = (
    b'{"phase":"begin","axis":"X","set":"s","hash":"h","began":"2026-01-01","store":true,"identity":{"protocol":"canopen","model":{}},'
    b'"parameters":[["2000h:01","a","00","01",[]]]}\n{"phase":"proven"}\n{"phase":"end","ending":"new"}\n'
)
PLAN = b"run,direction,target_mm,overrun_mm,feed_mm_s,dwell_s,strokes_s,rest_s,load_kg\n1,+1,10,1,5,0,0,0,3\n2,-1,20,,,,,,\n"
CIRCLE = b'{"radius_mm": 10, "sense": 1, "circles": {"a": {"angle_deg": [0, 90], "deviation_um": [0, 1]}}}'
STORED = b'{"findings": [{"effect": "cyclic", "confidence": 0.9}], "drawn": {}, "noise_floor_um": null}'
ZERO = (
    b'{"id": "0123", "axis": "X", "made": "2026-01-01T00:00:00+00:00", "drive": {}, "homes": true, "method": 1, "home_position_mm": 0.0,'  # noqa: E501
    b' "reference": {"motor_mm": 0.0, "instrument_mm": 0.0, "instrument": "umd", "sequence": 1, "time": "2026-01-01T00:00:00+00:00"}}'
)
TABLES = (
    b'{"format": "hil-tables/1", "mode": "bidirectional", "pitch": {"position_mm": [0, 1], "plus_um": [0, 1], "minus_um": [0, 1]},'
    b' "backlash": null, "specified": null, "straightness": null, "straightness_axis": ""}'
)
TERMS = files.model(
    terms=[
        {
            **files.TERM,
            "inputs": ["target_mm"],
            "form": "fundamental",
            "nonlinear": {"period_mm": 5.0},
            "coefficients": [1, 2],
            "covariance": [[0] * 3] * 3,
        },
        {
            **files.TERM,
            "inputs": ["direction"],
            "effect": "backlash",
            "form": "constant",
            "coefficients": [1],
            "covariance": [[1]],
        },
    ]
).encode()
LIMITS = DriveLimits(0.0, 100.0, 50.0, 100.0)


@cache
def _key() -> Any:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # noqa: PLC0415

    return Ed25519PrivateKey.from_private_bytes(bytes(range(32)))


def _sealed_seed() -> bytes:
    return seal({"X.tables": TABLES}, "fuzz", _key(), cost=Cost(2, 1, 1), bound_to={"axes": {"X": {"zero": None}}})


def _resealed(data: bytes) -> object:
    """A file with a good signature over whatever stands before it: what an attacker with the builder's key could make."""
    return check(data + _key().sign(b"hil sealed file\0" + data), _key().public_key())


def _records_folder(data: bytes) -> None:
    """The data as the campaign's purpose, its chain and one of its passes."""
    folder = _folder() / "campaign"
    folder.mkdir(exist_ok=True)
    purpose, chain, rows = (*data.split(b"\0", 2), b"", b"")[:3]
    (folder / "campaign.json").write_bytes(purpose)
    (folder / "before-1.csv").write_bytes(rows)
    (folder / "rows.chain").write_bytes(chain)
    for read in (read_purpose, check_resumable):
        with contextlib.suppress(InputError):
            read(folder)
    read_pass(folder / "before-1.csv", None)


def _private_key(data: bytes) -> object:
    """Under limits that leave time for the parser: within its own a derivation may take a second."""
    with patch.object(keys, "MAX_ROUNDS", 16), patch.object(container, "MAX_KDF_WORK", 64):
        return _file(lambda path: load_private_key(path, "p"), "k.key")(data)


def _download(data: bytes) -> None:
    folder = _folder() / "downloads"
    folder.mkdir(exist_ok=True)
    (folder / "download-0001.jsonl").write_bytes(data)
    journal = Journal(folder)
    journal.last_change()
    journal.unfinished()


def _sealed_json(data: bytes) -> None:
    """The contents of entries and of a header, after decryption and signature."""
    try:
        form = parse_json(data)
    except ValueError:
        return
    for read in (TableSet.from_dict, lambda each: rise_from_json(each, "rise")):
        with contextlib.suppress(InputError):
            read(form)
    for read in (Zero.from_json, MadeWith.from_json):
        with contextlib.suppress(ValueError):
            read(form)


# -- instruments -------------------------------------------------------------------------------------------------------
class _Fed:
    """A link on which pieces of the data arrive, and which breaks at an empty one."""

    def __init__(self, data: bytes) -> None:
        self.pieces = data.split(b"\xff")

    def open(self) -> None: ...
    def close(self) -> None: ...
    def write(self, data: bytes) -> None: ...
    def read_waiting(self) -> bytes:
        piece = self.pieces.pop(0)
        if not piece:
            raise LinkLostError("gone")
        return piece


def _instrument(make: Callable[[_Fed, SimClock], Any]) -> Callable[[bytes], object]:
    def run(data: bytes) -> None:
        link, clock = _Fed(data), SimClock()
        instrument = make(link, clock)
        instrument.open()
        while link.pieces:
            with contextlib.suppress(LinkLostError):
                for reading in instrument.poll():
                    assert (reading.position_mm is None) is (reading.status.value != "good"), reading
            instrument.environment()

    return run


def _gauges(*protocols: Callable[[], ValueProtocol]) -> Callable[[bytes], object]:
    return _both(*(_instrument(lambda link, clock, p=p: Gauge(link, clock, p())) for p in protocols))


# -- CANopen -----------------------------------------------------------------------------------------------------------
def _frames(data: bytes) -> Iterator[tuple[int, bytes]]:
    """(COB-ID, data) of at most 16 frames: two bytes, the first of which holds the length, and as many bytes."""
    for _ in range(16):
        if len(data) < 2:
            return
        size = min(data[0] >> 4, 8)
        yield (data[0] & 7) << 8 | data[1], data[2 : 2 + size]
        data = data[2 + size :]


def _packed(*frames: tuple[int, str]) -> bytes:
    return b"".join(
        bytes((len(bytes.fromhex(data)) << 4 | cob_id >> 8, cob_id & 0xFF)) + bytes.fromhex(data)
        for cob_id, data in frames
    )


class _Slave:
    """A simulated drive, booted once: what one input leaves in it, the next one finds."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.servo = SimulatedServo(BareShaft(), SMALL_SERVO)
        self.slave = CanOpenSlave(self.servo, 5, self._sent)
        self.slave.boot(0)

    def _sent(self, cob_id: int, frame: bytes) -> None:
        assert len(frame) <= 8, (cob_id, frame)

    def run(self, data: bytes) -> None:
        for cob_id, frame in _frames(data):
            self.now_ns += 1_000_000
            self.slave.on_frame(cob_id, frame, self.now_ns)
            self.servo.advance(self.now_ns, 0.001)
            self.slave.tick(self.now_ns)


_slaves: list[_Slave] = []
_inputs = itertools.count()


def _slave(data: bytes) -> None:
    if next(_inputs) % 32 == 0:
        _slaves[:] = [_Slave()]
    _slaves[0].run(data)


class _Master:
    """A drive's driver on a simulated wire, opened once; frames of anybody come in between."""

    def __init__(self) -> None:
        self.bench = CanBench((5,))
        self.link = CanLink(self.bench.port(), self.bench.clock)
        self.noise = self.bench.wire.add_node()
        self.noise.connect(lambda *_: None, lambda _: None, lambda: None)
        scaling = AxisScaling(100_000, 10.0)
        self.drive = CanOpenDrive("X", scaling, LIMITS, self.bench.clock, link=self.link, node_id=5)
        self.drive.open()

    def run(self, data: bytes) -> None:
        for cob_id, frame in _frames(data):
            self.noise.send(cob_id, frame)
        self.bench.clock.sleep_s(0.002)
        self.link.poll()
        self.drive.sample()


_masters: list[_Master] = []
_rounds = itertools.count(1)
_refused: list[bytes] = []
"""What the present master ended by an error, one after the other. It is opened anew after some: opening takes 20 times an input."""


def _master(data: bytes) -> None:
    if not _masters or len(_refused) >= 8 or next(_rounds) % 200 == 0:
        _refused.clear()
        _masters[:] = [_Master()]
    try:
        _masters[0].run(data)
    except BridgeError:
        _refused.append(data)
        raise
    _refused.clear()


# -- Modbus ------------------------------------------------------------------------------------------------------------
class _Shaft:
    friction_permille = 0.0

    def step(self, motor_rev: float, dt_s: float) -> None: ...


@cache
def _faces() -> list[Any]:
    servo = SimulatedServo(_Shaft(), ServoParameters(counts_per_rev=60_000))
    return [Cia402Registers(servo), VendorRegisters(servo, counts_per_rev=60_000)]


def _requests(data: bytes) -> None:
    for face in _faces():
        reply = answer(face, data)
        assert 2 <= len(reply) <= 253, reply
        face.tick(0)
    for decoder in (TcpDecoder(), RtuDecoder()):
        for at in range(0, len(data), 7):
            decoder.feed(data[at : at + 7])


class _Port:
    """A port on which the data arrives in two pieces as the reply to any request."""

    is_open = True
    rest_of_frame_s = 0.0

    def __init__(self, data: bytes) -> None:
        self.pieces = [data[: len(data) // 2], data[len(data) // 2 :]]

    @contextlib.contextmanager
    def exchange(self) -> Iterator[None]:
        yield

    def send(self, data: bytes) -> None: ...
    def close(self) -> None: ...
    def receive(self, _within: object) -> bytes:
        return self.pieces.pop(0) if self.pieces else b""


_ASKED = (
    Request(Function.READ_HOLDING, 0, 2),
    Request(Function.READ_COILS, 0, 9),
    Request(Function.WRITE_REGISTER, 1, 1, (5,)),
    Request(Function.WRITE_REGISTERS, 1, 2, (5, 6)),
)


def _replies(url: str) -> Callable[[bytes], object]:
    def run(data: bytes) -> None:
        for request in _ASKED:
            wire = PymodbusWire(parse_endpoint(url))
            wire._port = _Port(data)  # type: ignore[assignment]
            with contextlib.suppress(BridgeError):
                values = wire.exchange(1, request)
                assert len(values) == (0 if request.function.is_write else request.count)

    return run


def _seeds_of(*names: str) -> list[bytes]:
    return [(HOUSE / name).read_bytes() for name in names]


TOML = ("true", "false", "inf", "nan", "[[", "]]", '"""', "'''", "0x", "1e400", "1_0", "\\u0000", "[axis]", "[drive]")
NUMBERS = ("inf", "nan", "1e400", "-0", "1_0", "٣", "\ufeff", "\r\n", '""', "# withdrawn 1: x")
JSON = ("null", "true", "NaN", "1e400", "[[", "{}", '"format"', "\\u0000", "-0.0")

TARGETS: Mapping[str, Target] = {
    "axis file": Target(_file(load_axis, "X.toml"), _seeds_of("hil/examples/axis.toml"), TOML, 8192),
    "records": Target(_text(parse_csv), [ROWS], NUMBERS),
    "journal": Target(_records_folder, [CAMPAIGN + b"\0\0" + ROWS, CAMPAIGN + b"\0x\0" + ROWS], (*JSON, *NUMBERS)),
    "download journal": Target(_download, [DOWNLOAD], (*JSON, '"phase"', '"begin"')),
    "sealed": Target(
        _both(unpack, lambda data: check(data, _key().public_key()), _resealed),
        [_sealed_seed(), _sealed_seed()[:-64]],
        JSON,
    ),
    "sealed contents": Target(_sealed_json, [TABLES, ZERO, b'{"units": {"6092h:01": 10.0}, "backlash": {}}'], JSON),
    "keys": Target(
        _both(
            _private_key,
            _file(load_public_key, "k.pub"),
            lambda data: check_detached(b"", data, _key().public_key()),
        ),
        [
            files.scrypt_key(2, 1),
            files.pbkdf2_key(2),
            files.key_with_false_marker(),
            files.public_key_of_unknown_kind(),
            sign_detached(b"", _key()),
        ],
        ("-----BEGIN ENCRYPTED PRIVATE KEY-----", "-----END ENCRYPTED PRIVATE KEY-----", "-----BEGIN PUBLIC KEY-----"),
    ),
    "EDS": Target(
        _file(load_eds),
        [files.eds(1).encode(), files.eds(1, 2).encode(), b"[2000]\nCompactSubObj=3\n[2000Name]\n1=a\n"],
        ("[1018]", "$NODEID+", "0x", "h", "LowLimit=", "HighLimit=", "CompactSubObj=", "ObjectType=9", "DataType=0x8"),
        longest=600,
    ),
    "DCF": Target(
        _file(read_any, "f.dcf"),
        [files.dcf(2).encode()],
        ("ParameterValue=", "$NODEID+", "[1A00sub1]", "[1400sub1]", "[1018sub1]"),
    ),
    "concise DCF": Target(
        _file(read_any, "f.cdcf"),
        [b"\1\0\0\0\0\x20\1\4\0\0\0abcd", b"\2\0\0\0\0\x14\1\4\0\0\0\1\2\0\x80\0\x16\0\1\0\0\0\0"],
    ),
    "register map": Target(
        _file(load_drive_map, "m.toml"),
        [shipped_maps()["vendor_style"].read_bytes()],
        (*TOML, "[drive.move]", "[registers.x]"),
        16384,
    ),
    "parameter set": Target(
        _file(read_set, "s.toml"),
        [
            b'format = "hil parameter set 1"\nname = "a"\n[[parameters]]\nindex = 0x2000\nsubindex = 1\nvalue = 1\n',
            b'format = "hil parameter set 1"\nname = "a"\n[identity]\nprotocol = "canopen"\n[[parameters]]\nindex = 0x2000\nraw = "0100"\n',  # noqa: E501
        ],
        (*TOML, "[[parameters]]", "raw = ", "after = "),
    ),
    "laser": Target(
        _instrument(UmdLaser),
        [b"\r\n1000 1000 5 0 3 7 3 2000\r\n1000 1000 6 0 511 8 5 101325\r\n1 1 1 1 1 9 6 500 1 1 1 1 1 1 1 1\r\n"],
        raises=(),
    ),
    "displays and gauges": Target(
        _gauges(
            lambda: AsciiDecoder(AsciiSettings("mitutoyo")),
            lambda: AsciiDecoder(AsciiSettings("number", request=b"?")),
            lambda: AsciiDecoder(AsciiSettings(r"(?P<value>\S+) (?P<unit>\w+)", fault="E.*")),
        ),
        [b"\r01A+0000.123\r", b"\n +1.5 mm\n\xff-3 inch\n", b"\n1.5 um\nE1\n\xff\xff2 mm\n"],
        ("01A", "inch", "µm", "\r\n"),
        raises=(),
    ),
    "ND 2xx": Target(
        _gauges(Nd2xxDecoder, lambda: Nd2xxDecoder(0.0005), lambda: Nd2xxDecoder(pulsed=True)),
        [b"+       1.5       \r\n", b"\x02+000012345\r\n", b"\x15\xff\x06\r\n"],
        raises=(),
    ),
    "LinuxCNC": Target(_text(linuxcnc.load), [b"0 0.001 0.002\n10 0.003 -0.001\n"], NUMBERS),
    "SINUMERIK": Target(
        _text(sinumerik.load),
        [
            b"CHANDATA(1)\n$AA_ENC_COMP[0,0,AX1]=0.001\n$AA_ENC_COMP[0,1,AX1]=0.002\n$AA_ENC_COMP_STEP[0,AX1]=10\n$AA_ENC_COMP_MIN[0,AX1]=0\n$AA_ENC_COMP_MAX[0,AX1]=10\nM17\n"
        ],
        ("$AN_CEC[0,0]=", "$AN_CEC_INPUT_AXIS[0]=", "$AN_CEC_DIRECTION[0]=", "M17", "; minus"),
    ),
    "FANUC": Target(
        _text(fanuc.load),
        [
            b"%\nG10 L50\nN1851 P1 R10\nN3620 P1 R1\nN3621 P1 R1\nN3622 P1 R3\nN3623 P1 R1\nN3624 P1 R1000\nN10001 R1\nN10002 R-1\nN10003 R0\nG11\n%\n"  # noqa: E501
        ],
        ("G10 L50", "G11", "N3605 P1 R1", "(", ")"),
    ),
    "TwinCAT": Target(
        _text(twincat.load),
        [
            b"kw.ssfk.interval 0\nkw.ssfk.kw_startpos 0\nkw.ssfk.kw_nr_max 2\nkw.ssfk.unit 1\nkw.ssfk.bilateral 1\nkw.ssfk.modulo 0\n"
            b"kw.ssfk.table[0].setpoint 0\nkw.ssfk.table[1].setpoint 100000\nkw.ssfk.table[0].pos 0\nkw.ssfk.table[1].pos -10\n"
            b"kw.ssfk.table[0].neg 0\nkw.ssfk.table[1].neg -20\n"
        ],
        ("ssfk.", "(*", "*)", "[0]"),
    ),
    "Keysight": Target(
        _text(keysight.load),
        [b'Identify=Positions,TextUnit="0 10 20 mm"\nIdentify=LinearErr,TextUnit="1 2 3 3 2 1 um"\n'],
        ("Identify=", "TextUnit=", "mm", "um", *NUMBERS),
    ),
    "measured CSV": Target(
        _both(
            _text(measured_csv.load),
            _text(lambda text: measured_csv.load(text, measured_csv.MeasuredCsvSettings(infer=True))),
        ),
        [ROWS, b"target_mm;measured_mm\n1;2\n2;3\n"],
        NUMBERS,
    ),
    "wide ISO": Target(
        _text(wide_iso.load),
        ["t;1+;1-;run 2 ↑\n0;1;2;3\n10;1;2;3\n".encode()],
        ("run", "cycle", "↑", "↓", "forward", "up", *NUMBERS),
    ),
    "circle path": Target(
        _both(_text(lambda text: circles._driven(text, None)), _text(lambda text: circles._table(text, 1.0))),
        [CIRCLE, b"x_mm,y_mm\n1,0\n0,1\n", b"angle_deg,deviation_um\n0,1\n90,-1\n"],
        (*JSON, *NUMBERS),
    ),
    "probe machine": Target(
        _file(load_probe_machine, "probe.toml"), _seeds_of("hil/examples/probe_machine.toml"), TOML, 8192
    ),
    "manual tables": Target(_file(read_manual_tables), [b"position_mm,plus_um,minus_um\n0,1,1\n10,2,3\n"], NUMBERS),
    "model": Target(
        _text(Model.from_json),
        [files.model().encode(), files.model(terms=[files.TERM]).encode(), TERMS],
        (*JSON, '"cyclic"', '"abbe"'),
    ),
    "diagnosis JSON": Target(_file(read_stored), [STORED], JSON),
    "plan": Target(_file(lambda path: read_plan(path, LIMITS)), [PLAN], NUMBERS),
    "recording": Target(
        _file(Recording.read),
        [b"time_s,laser_mm,air_temp_c\n0,1,20\n0.1,,21\n", files.packed(b"time_s,laser_mm\n0,1\n", 1)[:200]],
        NUMBERS,
    ),
    "CAN frames into the slave": Target(
        _slave,
        [
            _packed((0x000, "0105"), (0x605, "4000100000000000"), (0x080, ""), (0x605, "2B40600006000000")),
            _packed((0x605, "2100200008000000"), (0x605, "0D61626364656667"), (0x205, "0600"), (0x7E5, "0401")),
            _packed((0x605, "A000100010000000"), (0x605, "A300000000000000"), (0x605, "C200200020000000")),
        ],
        longest=160,
        raises=(),
    ),
    "CAN frames into the master": Target(
        _master,
        [
            _packed((0x705, "05"), (0x085, "1000010000000000"), (0x185, "3706"), (0x585, "4341600007000000")),
            _packed((0x585, "8000100000000205"), (0x285, "000000000000"), (0x080, ""), (0x000, "8105")),
        ],
        longest=160,
        raises=(BridgeError,),
    ),
    "Modbus requests": Target(
        _requests,
        [
            b"\3\0\0\0\2",
            b"\x10\0\1\0\2\4\0\1\0\2",
            b"\6\0\1\0\5",
            b"\1\0\0\0\x10",
            pack_tcp(Frame(1, b"\3\0\0\0\2", 1)),
            pack_rtu(Frame(1, b"\3\0\0\0\2")),
        ],
        longest=300,
        raises=(),
    ),
    "Modbus replies": Target(
        _both(_replies("tcp://127.0.0.1:502"), _replies("/dev/null"), raises=BridgeError),
        [
            pack_tcp(Frame(1, b"\3\4\0\1\0\2", 1)),
            pack_rtu(Frame(1, b"\3\4\0\1\0\2")),
            pack_tcp(Frame(1, b"\x83\2", 1)),
            pack_rtu(Frame(1, b"\1\2\1\0")),
        ],
        longest=600,
        raises=(BridgeError,),
    ),
}
