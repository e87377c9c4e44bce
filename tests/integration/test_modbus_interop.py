"""Our Modbus client against servers nobody here wrote, and our server against a foreign client.

Foreign: pyModbusTCP and umodbus (Python), libmodbus (C, compiled here where it can be) as servers on TCP and on serial lines;
mbpoll (C) as client. All servers hold the same: input register n is 0x1000 + n, holding register 0x2000 + n, every third discrete
input and every second coil are set, 300 of each.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import socketserver
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from unittest.mock import patch

import pytest
import serial
from pyModbusTCP.server import DataBank, ModbusServer
from support.modbus_parameters import NEW, OLD, place, write_map
from support.parameter_faults import KilledError
from support.serial_pair import serial_pair
from umodbus.server.serial import get_server as umodbus_serial_server
from umodbus.server.serial.rtu import RTUServer
from umodbus.server.tcp import RequestHandler
from umodbus.server.tcp import get_server as umodbus_tcp_server

from drivers.clock import WallClock
from drivers.correction_table import RawTable
from drivers.drive import DriveState
from drivers.errors import AbortError, NoAnswerError
from drivers.modbus.codec import Layout, Order, RegisterType, decode, encode
from drivers.modbus.correction_table import ModbusCorrectionTable
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.modbus.link import Doubt, ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.plan import AddressSpace, Span
from drivers.modbus.raw_parameters import ModbusLine, ModbusRawParameters
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.register_map import find_map
from drivers.modbus.wear import WearLedger
from hil.parameters.compare import compare
from hil.parameters.download import download
from hil.parameters.journal import Journal
from hil.parameters.recover import recover
from hil.parameters.report import Ending
from hil.parameters.snapshot import back_up
from hil.parameters.transaction import Target
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import rtu_slave, tcp_server
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo

pytestmark = pytest.mark.outside

SIZE = 300
UNIT = 7
INPUTS = [0x1000 + n for n in range(SIZE)]
HOLDING = [0x2000 + n for n in range(SIZE)]
DISCRETE = [int(n % 3 == 0) for n in range(SIZE)]
COILS = [n % 2 for n in range(SIZE)]

Served = Callable[[], AbstractContextManager[Endpoint]]


# -- foreign servers -----------------------------------------------------------------------------------------------------
@contextmanager
def pymodbustcp() -> Iterator[Endpoint]:
    bank = DataBank(coils_size=SIZE, d_inputs_size=SIZE, h_regs_size=SIZE, i_regs_size=SIZE)
    bank.set_coils(0, [bool(bit) for bit in COILS])
    bank.set_discrete_inputs(0, [bool(bit) for bit in DISCRETE])
    bank.set_holding_registers(0, HOLDING)
    bank.set_input_registers(0, INPUTS)
    server = ModbusServer("127.0.0.1", 0, no_block=True, data_bank=bank)
    server.start()
    try:
        yield TcpEndpoint("127.0.0.1", server._service.server_address[1])
    finally:
        server.stop()
        server._serve_th.join()


def _route(server: object) -> None:
    """umodbus calls a function for each address."""
    banks = {1: list(COILS), 2: list(DISCRETE), 3: list(HOLDING), 4: list(INPUTS)}
    space = {1: 1, 2: 2, 3: 3, 4: 4, 5: 1, 6: 3, 15: 1, 16: 3}
    for function, bank in space.items():

        def read(slave_id: int, function_code: int, address: int, bank: int = bank) -> int:
            return banks[bank][address]

        def write(slave_id: int, function_code: int, address: int, value: int, bank: int = bank) -> None:
            banks[bank][address] = value

        act = read if function <= 4 else write
        server.route(slave_ids=[UNIT], function_codes=[function], addresses=list(range(SIZE)))(act)  # type: ignore[attr-defined]


class _QuietTcpServer(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True


@contextmanager
def umodbus_tcp() -> Iterator[Endpoint]:
    with umodbus_tcp_server(_QuietTcpServer, ("127.0.0.1", 0), RequestHandler) as server:
        _route(server)
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield TcpEndpoint("127.0.0.1", server.server_address[1])
        finally:
            server.shutdown()
            thread.join()


def _line(path: str) -> RtuEndpoint:
    return RtuEndpoint(path, 115_200, "N", 1, timeout_s=2.0)


@contextmanager
def umodbus_rtu() -> Iterator[Endpoint]:
    with serial_pair() as (theirs, mine), serial.Serial(theirs, 115_200) as port:
        server = umodbus_serial_server(RTUServer, port)
        _route(server)
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield _line(mine)
        finally:
            server.shutdown()
            thread.join()


SLAVE_IN_C = r"""
#include <arpa/inet.h>
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* slave tcp | slave rtu DEVICE: prints "ready PORT", serves one client until its line ends */
int main(int argc, char **argv) {
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    int tcp = argc == 2 && strcmp(argv[1], "tcp") == 0, listener = -1, size = 300, unit = 7;
    modbus_t *ctx = tcp ? modbus_new_tcp("127.0.0.1", 0) : modbus_new_rtu(argv[2], 115200, 'N', 8, 1);
    modbus_mapping_t *map = modbus_mapping_new(size, size, size, size);
    if (ctx == NULL || map == NULL) return 2;
    modbus_set_slave(ctx, unit);
    for (int n = 0; n < size; n++) {
        map->tab_bits[n] = n % 2;
        map->tab_input_bits[n] = n % 3 == 0;
        map->tab_registers[n] = 0x2000 + n;
        map->tab_input_registers[n] = 0x1000 + n;
    }
    if (tcp) {
        struct sockaddr_in address;
        socklen_t length = sizeof address;
        listener = modbus_tcp_listen(ctx, 1);
        if (listener < 0 || getsockname(listener, (struct sockaddr *)&address, &length) < 0) return 3;
        printf("ready %d\n", ntohs(address.sin_port));
    } else {
        if (modbus_connect(ctx) < 0) return 3;
        printf("ready 0\n");
    }
    fflush(stdout);
    if (tcp && modbus_tcp_accept(ctx, &listener) < 0) return 4;
    for (;;) {
        int length = modbus_receive(ctx, query);
        if (length > 0) modbus_reply(ctx, query, length, map);
        else if (length < 0 && tcp) break;
    }
    modbus_mapping_free(map);
    modbus_close(ctx);
    modbus_free(ctx);
    return 0;
}
"""


@pytest.fixture(scope="module")
def c_slave(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The slave above as a program; skips where it cannot be built."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    header = Path("/usr/include/modbus/modbus.h")
    if compiler is None or not header.exists():
        pytest.skip("no C compiler, or no libmodbus (Debian: gcc libmodbus-dev)")
    folder = tmp_path_factory.mktemp("libmodbus")
    source, program = folder / "slave.c", folder / "slave"
    source.write_text(SLAVE_IN_C, encoding="utf-8")
    built = subprocess.run(
        [compiler, "-O1", "-Wall", "-I", str(header.parent), str(source), "-o", str(program), "-lmodbus"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    return program


@contextmanager
def _running(command: list[str]) -> Iterator[int]:
    """Start the slave; yields the number it prints after "ready"."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            ready = process.stdout.readline().split()
            assert ready[:1] == ["ready"], process.poll()
            yield int(ready[1])
        finally:
            process.terminate()
            process.wait()


@contextmanager
def libmodbus_tcp(program: Path) -> Iterator[Endpoint]:
    with _running([str(program), "tcp"]) as port:
        yield TcpEndpoint("127.0.0.1", port)


@contextmanager
def libmodbus_rtu(program: Path) -> Iterator[Endpoint]:
    with serial_pair() as (theirs, mine), _running([str(program), "rtu", theirs]):
        yield _line(mine)


@pytest.fixture(params=["pyModbusTCP", "umodbus-tcp", "umodbus-rtu", "libmodbus-tcp", "libmodbus-rtu"])
def endpoint(request: pytest.FixtureRequest) -> Iterator[Endpoint]:
    servers: dict[str, Served] = {
        "pyModbusTCP": pymodbustcp,
        "umodbus-tcp": umodbus_tcp,
        "umodbus-rtu": umodbus_rtu,
        "libmodbus-tcp": lambda: libmodbus_tcp(request.getfixturevalue("c_slave")),
        "libmodbus-rtu": lambda: libmodbus_rtu(request.getfixturevalue("c_slave")),
    }
    with servers[request.param]() as endpoint:
        yield endpoint


@pytest.fixture
def link(endpoint: Endpoint) -> Iterator[ModbusLink]:
    link = ModbusLink(endpoint, WallClock())
    link.open()
    yield link
    link.close()


# -- our client ------------------------------------------------------------------------------------------------------------
def test_every_table_is_read_up_to_the_largest_request(link: ModbusLink) -> None:
    for start, count in ((0, 1), (17, 3), (100, 125), (SIZE - 1, 1)):
        assert link.read(UNIT, AddressSpace.HOLDING, Span(start, count)) == tuple(HOLDING[start : start + count])
        assert link.read(UNIT, AddressSpace.INPUT, Span(start, count)) == tuple(INPUTS[start : start + count])
    for start, count in ((0, 1), (3, 8), (5, 19), (0, SIZE)):
        assert link.read(UNIT, AddressSpace.COIL, Span(start, count)) == tuple(COILS[start : start + count])
        assert link.read(UNIT, AddressSpace.DISCRETE, Span(start, count)) == tuple(DISCRETE[start : start + count])


def test_everything_that_can_be_written_is(link: ModbusLink) -> None:
    link.write(UNIT, AddressSpace.HOLDING, 4, (0xBEEF,))
    link.write(UNIT, AddressSpace.HOLDING, 5, (0xCAFE,), single=False)
    link.write(UNIT, AddressSpace.HOLDING, 10, tuple(range(100, 200)))
    assert link.read(UNIT, AddressSpace.HOLDING, Span(3, 4)) == (HOLDING[3], 0xBEEF, 0xCAFE, HOLDING[6])
    assert link.read(UNIT, AddressSpace.HOLDING, Span(9, 102)) == (HOLDING[9], *range(100, 200), HOLDING[110])
    link.write(UNIT, AddressSpace.COIL, 0, (1,))
    link.write(UNIT, AddressSpace.COIL, 1, (0,))
    link.write(UNIT, AddressSpace.COIL, 8, (1, 1, 0, 0, 1, 1, 0, 0, 1, 1))
    assert link.read(UNIT, AddressSpace.COIL, Span(0, 3)) == (1, 0, 0)
    assert link.read(UNIT, AddressSpace.COIL, Span(7, 12)) == (1, 1, 1, 0, 0, 1, 1, 0, 0, 1, 1, 0)


def test_wide_values_come_back_in_every_order(link: ModbusLink) -> None:
    start = 40
    for kind, value in ((RegisterType.I32, -123_456_789), (RegisterType.F32, 12.5), (RegisterType.U64, 2**63 + 5)):
        for word_order in Order:
            for byte_order in Order:
                layout = Layout(kind, word_order, byte_order)
                link.write(UNIT, AddressSpace.HOLDING, start, encode(value, layout))
                assert decode(link.read(UNIT, AddressSpace.HOLDING, Span(start, layout.words)), layout) == value


def test_refusals_carry_their_code(link: ModbusLink) -> None:
    with pytest.raises(AbortError) as caught:
        link.read(UNIT, AddressSpace.HOLDING, Span(SIZE, 1))
    assert caught.value.code == 2
    with pytest.raises(AbortError) as caught:
        link.write(UNIT, AddressSpace.HOLDING, SIZE + 100, (1,))
    assert caught.value.code == 2
    assert link.read(UNIT, AddressSpace.HOLDING, Span(0, 1)) == (HOLDING[0],)


def test_a_register_map_reads_a_foreign_server_in_one_request_per_table(link: ModbusLink) -> None:
    drive = load_drive_map("vendor_style")
    access = RegisterAccess(link, UNIT, drive.registers)
    with patch.object(link, "read", wraps=link.read) as reading:
        raw = access.read(drive.sampled())
    assert reading.call_count == 2
    assert raw["position"] == 0x1002 << 16 | 0x1001  # input registers 30002 and 30003, low word first
    assert raw["in_position"] == DISCRETE[3]
    access.write({"target": -5, "target_speed": 70_000, "ramp": 9})
    assert link.read(UNIT, AddressSpace.HOLDING, Span(0, 6)) == (0xFFFB, 0xFFFF, 70_000 - 65_536, 1, 9, 0)


def test_a_correction_table_goes_into_a_foreign_server_and_out_again(link: ModbusLink, tmp_path: Path) -> None:
    """The table of a shipped map, brought to where a server of 300 registers has some."""
    text = find_map("vendor_style").read_text(encoding="utf-8").replace("points = 256", "points = 80")
    text = re.sub(r"4030(\d)", r"4012\1", text).replace("address = 40311", "address = 40210")
    path = tmp_path / "map.toml"
    path.write_text(text, encoding="utf-8")
    drive_map = load_drive_map(path)
    assert drive_map.table is not None
    link.write(UNIT, AddressSpace.HOLDING, 120, (0,) * 10)
    table = ModbusCorrectionTable("X", RegisterAccess(link, UNIT, drive_map.registers), drive_map.table, WearLedger())
    assert (table.read(), table.enabled()) == (RawTable(), False)
    wanted = RawTable(tuple(range(-40, 40)), (), (), -70_000, 123_456, 321)
    table.write(wanted, RawTable())
    assert table.read() == wanted
    table.switch(True)
    assert table.enabled()
    assert link.read(UNIT, AddressSpace.HOLDING, Span(120, 7)) == (1, 80, 61_072, 65_534, 57_920, 1, 321)
    assert link.read(UNIT, AddressSpace.HOLDING, Span(208, 3)) == (HOLDING[208], 65_496, 65_497)
    assert link.read(UNIT, AddressSpace.HOLDING, Span(288, 2)) == (39, HOLDING[289])


def test_a_parameter_set_goes_into_a_foreign_server_and_out_again(link: ModbusLink, tmp_path: Path) -> None:
    """Written, read back and stored; cut off in the middle and finished both ways; put back as it was."""
    drive = ModbusRawParameters("Z", ModbusLine(link), UNIT, load_drive_map(write_map(tmp_path)))
    journal = Journal(tmp_path / "journal")
    backup = back_up([drive])[0].contents
    assert backup is not None
    found = {entry.address: entry.raw for entry in backup.entries}
    assert found["p0"] == HOLDING[place(0)]
    report = download([Target(drive, NEW, journal)], store=True)[0]
    assert (report.ending, report.stored, report.good) == (Ending.WRITTEN, True, True)
    assert link.read(UNIT, AddressSpace.HOLDING, Span(place(0), 1)) == (NEW.entries[0].raw,)
    assert compare([(drive, NEW)])[0].same

    def cut_off(stage: str, _drive: str, done: int, _total: int) -> None:
        if stage == "write" and done > 12:
            raise KilledError

    for forward, held in ((False, NEW), (True, OLD)):
        with pytest.raises(KilledError):
            download([Target(drive, OLD, journal)], progress=cut_off)
        assert not compare([(drive, OLD)])[0].same
        assert recover([(drive, journal)], forward=forward)[0].good
        assert compare([(drive, held)])[0].same
    assert download([Target(drive, backup, journal)])[0].ending is Ending.WRITTEN
    again = back_up([drive])[0].contents
    assert again is not None
    assert {entry.address: entry.raw for entry in again.entries} == found


def test_another_unit_on_a_serial_line_stays_silent(c_slave: Path) -> None:
    with libmodbus_rtu(c_slave) as endpoint:
        link = ModbusLink(endpoint, WallClock())
        link.open()
        try:
            with pytest.raises(NoAnswerError):
                link.write(UNIT + 1, AddressSpace.HOLDING, 0, (1,), doubt=Doubt.RAISE)
            assert link.read(UNIT, AddressSpace.HOLDING, Span(0, 2)) == (HOLDING[0], HOLDING[1])
        finally:
            link.close()


# -- our server ------------------------------------------------------------------------------------------------------------
class Mbpoll:
    """The command-line master, told where the server is."""

    def __init__(self, *place: str) -> None:
        self._place = place

    def _run(self, *arguments: str, values: tuple[str, ...] = ()) -> str:
        *options, where = self._place
        command = ["mbpoll", *options, "-a", str(UNIT), "-0", "-1", "-q", "-o", "2", *arguments, where]
        run = subprocess.run(
            [*command, *(("--", *values) if values else ())], capture_output=True, text=True, check=False, timeout=20
        )
        return run.stdout + run.stderr

    def read(self, kind: str, address: int, count: int = 1) -> list[str]:
        output = self._run("-t", kind, "-r", str(address), "-c", str(count))
        found = re.findall(r"^\[\d+\]:\s+(\S+)", output, re.MULTILINE)
        assert len(found) == count, output
        return found

    def write(self, kind: str, address: int, *values: float) -> str:
        return self._run("-t", kind, "-r", str(address), values=tuple(str(value) for value in values))


@pytest.fixture(params=["tcp", "rtu"])
def mbpoll(request: pytest.FixtureRequest) -> Iterator[tuple[Mbpoll, Callable[[object], SimClock], SimulatedServo]]:
    """A foreign master, a function that serves a face to it, and the servo to build the face on."""
    if shutil.which("mbpoll") is None:
        pytest.skip("no mbpoll (Debian: mbpoll)")
    servo = SimulatedServo(BareShaft(), ServoParameters(counts_per_rev=60_000))
    clock = SimClock()
    clock.attach(servo.advance, bearable=servo.bearable)
    with contextlib.ExitStack() as stack:
        master = Mbpoll()

        def serve(face: object) -> SimClock:
            faces: dict[int, object] = {UNIT: face}
            if request.param == "tcp":
                _, port = stack.enter_context(tcp_server(faces, clock))  # type: ignore[arg-type]
                master._place = ("-m", "tcp", "-p", str(port), "127.0.0.1")
            else:
                _, path = stack.enter_context(rtu_slave(faces, clock))  # type: ignore[arg-type]
                master._place = ("-m", "rtu", "-b", "115200", "-P", "none", path)
            return clock

        yield master, serve, servo


def test_mbpoll_walks_our_cia402_drive_up_and_moves_it(
    mbpoll: tuple[Mbpoll, Callable[[object], SimClock], SimulatedServo],
) -> None:
    master, serve, servo = mbpoll
    clock = serve(Cia402Registers(servo))
    rules = load_drive_map("cia402_over_modbus").states

    def state() -> DriveState:
        word = int(master.read("4", 0x2000)[0])
        return next(rule.state for rule in rules if rule.condition.holds(word))

    assert state() is DriveState.SWITCH_ON_DISABLED
    for word, reached in ((6, DriveState.READY), (7, DriveState.SWITCHED_ON), (15, DriveState.ENABLED)):
        assert "Written 1 references" in master.write("4", 0x2100, word)
        clock.sleep_s(0.01)
        assert state() is reached
    master.write("4", 0x2101, 1)
    master.write("4", 0x2102, 0xFFFF, 0x10000 - 12_345)  # -12345, high word first
    master.write("4", 0x2104, 0, 60_000, 9, 0, 9, 0)
    master.write("4", 0x2100, 0x3F)
    clock.sleep_s(3.0)
    assert servo.position_actual_counts == -12_345
    assert master.read("4:int", 0x2002, 1) != ["-12345"]  # its default is low word first
    assert Mbpoll(*master._place[:-1], "-B", master._place[-1]).read("4:int", 0x2002) == ["-12345"]


def test_mbpoll_uses_all_four_tables_of_our_vendor_style_drive(
    mbpoll: tuple[Mbpoll, Callable[[object], SimClock], SimulatedServo],
) -> None:
    master, serve, servo = mbpoll
    face = VendorRegisters(servo, counts_per_rev=60_000)
    clock = serve(face)
    assert master.read("1", 0, 3) == ["1", "0", "0"]
    master.write("0", 0, 1)
    assert servo.powered
    assert master.read("1", 0, 3) == ["1", "1", "0"]
    assert master.read("0", 0, 4) == ["1", "0", "0", "0"]
    master.write("4:int", 0, -7000)  # low word first, as this drive has it
    assert face.settings["target"] == -7000
    master.write("4", 6, 1)
    clock.sleep_s(3.0)
    assert master.read("3:int", 1, 1) == ["-7000"]
    assert "Illegal data address" in master.write("4", 50, 1)
    assert "Illegal data value" in master.write("4", 6, 3)
