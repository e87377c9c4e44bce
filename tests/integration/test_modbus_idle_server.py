"""A Modbus TCP server that closes connections which were idle: the next write goes over a new one, once."""

from __future__ import annotations

import socket
import threading
import time

from drivers.modbus.endpoint import TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.plan import AddressSpace
from drivers.modbus.wire import PymodbusWire
from sim_backends.clock import SimClock


def test_a_write_after_the_server_hung_up_goes_over_a_new_connection() -> None:
    requests: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        hung_up = threading.Event()

        def serve() -> None:
            listener.accept()[0].close()
            hung_up.set()
            connection, _ = listener.accept()
            with connection:
                requests.append(connection.recv(256))
                connection.sendall(requests[-1])  # a write of one register is echoed

        thread = threading.Thread(target=serve)
        thread.start()
        link = ModbusLink(TcpEndpoint("127.0.0.1", listener.getsockname()[1], 1.0), SimClock())
        link.open()
        assert hung_up.wait(1.0)
        time.sleep(0.05)
        link.write(1, AddressSpace.HOLDING, 10, (7,))
        link.close()
        thread.join()
    assert len(requests) == 1


def test_asking_whether_the_server_has_hung_up_waits_for_nothing() -> None:
    """It is asked before each request: a wait of the socket's time-out there made each request 5 ms, the first one a second."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        wire = PymodbusWire(TcpEndpoint("127.0.0.1", listener.getsockname()[1], 5.0))
        wire.connect()
        connection, _ = listener.accept()
        with connection:
            began_s = time.monotonic()
            for _ in range(100):
                assert wire.connected
            assert time.monotonic() - began_s < 4.0
        wire.disconnect()
