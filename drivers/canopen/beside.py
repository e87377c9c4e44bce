"""The canopen package beside a drive that hil moves: its network and node read and listen, and what would move the axis is refused.

`Beside` gives a `canopen.Network` and the drive's node in it. Frames come in by the drive's link, accesses go through its one SDO
client. `SharedBus` is the other way: a user's connected Network, with its Notifier, is the bus of a `CanLink`.
"""

from __future__ import annotations

import io
import queue
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import can
import canopen
from canopen.network import PeriodicMessageTask
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.eds import import_eds

from drivers.canopen import cia301
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.eds import EdsEntry, decode_eds
from drivers.canopen.eds_text import parse
from drivers.canopen.node import HEARTBEAT, NMT
from drivers.canopen.not_parameters import why_not_written
from drivers.canopen.sdo import SDO_REQUEST, SDO_RESPONSE
from drivers.canopen.sync import SYNC
from drivers.cia402.objects import DataType, Entry
from drivers.clock import NS_PER_S
from drivers.errors import AbortError, InputError, StateError, TransportError

LSS = 0x7E5
SUPERVISION = (0x1005, 0x1006, 0x1007, 0x100C, 0x100D, 0x1016, 0x1017)
"""SYNC, life guarding and heartbeat: set up when the drive is opened, and put back."""
_SENT = {NMT: "NMT commands", SYNC: "SYNC", LSS: "LSS", SDO_REQUEST: "requests of a second SDO client"}


class Beside:
    """The canopen package beside one drive, until `close`.

    network: a user's, whose bus the drive is on (`SharedBus`); None for one of its own, which follows the drive's link
    Reading is for any thread, but not from a callback of the network. The first error of a callback is raised by the next access.
    """

    def __init__(self, drive: CanOpenDrive, network: canopen.Network | None = None) -> None:
        self.drive = drive
        self._undo = ExitStack()
        self._error: Exception | None = None
        self._notifying: int | None = None  # the thread in a callback
        if network is None:
            self.network = canopen.Network()
            drive.link.watch(self._notify)
            self._undo.callback(drive.link.unwatch, self._notify)
        else:
            self.network = network
        if drive.node_id in self.network:
            self.node = self.network[drive.node_id]
        else:
            self.node = self.network.add_node(drive.node_id, dictionary(drive))
            self._undo.callback(self.network.pop, drive.node_id)
        self._guard(self.network, send_message=self._send_message, send_periodic=self._send_periodic)
        sdo: Any = self.node.sdo
        self.network.unsubscribe(SDO_RESPONSE + drive.node_id, sdo.on_response)
        self._undo.callback(self.network.subscribe, SDO_RESPONSE + drive.node_id, sdo.on_response)
        self._guard(sdo, upload=self._upload, download=self._download, open=self._open)

    def _guard(self, target: Any, **methods: Any) -> None:
        """Methods of one object, its own again when this is closed."""
        for name, method in methods.items():
            setattr(target, name, method)
            self._undo.callback(delattr, target, name)

    def close(self) -> None:
        """Give the network its own methods back. Raises the error of a callback that nobody was told."""
        self._undo.close()
        self._raise_missed()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._undo.close()

    # -- frames ----------------------------------------------------------------------------------------------------
    def _notify(self, time_ns: int, cob_id: int, data: bytes) -> None:
        self._notifying = threading.get_ident()
        try:
            self.network.notify(cob_id, bytearray(data), time_ns / NS_PER_S)
        except Exception as error:  # noqa: BLE001  a user's callback must not end a move or its stop
            self._error = self._error or error
        finally:
            self._notifying = None

    def _raise_missed(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _check_sent(self, can_id: int) -> None:
        """Raise StateError for a frame that commands the drive, or passes for one of it."""
        node_id, rpdos = self.drive.node_id, self._rpdos()
        what = _SENT.get(SDO_REQUEST if can_id == SDO_REQUEST + node_id else can_id)
        if what is None and (can_id in rpdos or (can_id & 0x7F == node_id and can_id < HEARTBEAT + 0x80)):
            what = f"frames with the drive's identifier {can_id:03X}h"
        if what is not None:
            raise StateError(
                f"drive {self.drive.name} is hil's, refused beside it: {what}; read by node.sdo, move it by hil"
            )

    def _rpdos(self) -> set[int]:
        connection = getattr(self.drive, "connection", None)
        found = () if connection is None else (connection.rpdo, connection.stop_rpdo)
        return {spec.cob_id for spec in found if spec is not None}

    def _send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._check_sent(can_id)
        self.drive.link.send_message(
            can.Message(arbitration_id=can_id, data=data, is_extended_id=can_id > 0x7FF, is_remote_frame=remote)
        )

    def _send_periodic(self, can_id: int, data: bytes, period: float, remote: bool = False) -> Any:
        self._check_sent(can_id)
        return PeriodicMessageTask(can_id, data, period, self.drive.link.bus, remote)

    # -- objects ---------------------------------------------------------------------------------------------------
    def _check_access(self) -> None:
        self._raise_missed()
        bus = self.drive.link.bus
        if threading.get_ident() in (self._notifying, bus.fed_by if isinstance(bus, SharedBus) else None):
            raise StateError("an object cannot be read in a callback of the network, which its answer would come by")
        if not self.drive.is_open:
            raise StateError(f"drive {self.drive.name} is not open")

    def _upload(self, index: int, subindex: int) -> bytes:
        self._check_access()
        with _errors_of_canopen():
            data = self.drive.sdo.read_bytes(index, subindex)
        variable: ODVariable | None = self.node.object_dictionary.get_variable(index, subindex)
        if variable is None or not variable.fixed_size:
            return data
        return data[: len(variable) // 8]  # a device may answer more than the type has

    def _download(self, index: int, subindex: int, data: bytes, force_segment: bool = False) -> None:
        del force_segment  # the client's to choose
        self._check_access()
        if what := self._why_not(index, subindex):
            raise StateError(f"drive {self.drive.name} is hil's, not written beside it: {what}")
        with _errors_of_canopen():
            self.drive.sdo.write_bytes(index, subindex, bytes(data))

    def _why_not(self, index: int, subindex: int) -> str | None:
        entry = Entry(index, subindex, DataType.U32, "")
        if index in SUPERVISION:
            return f"{entry} belongs to SYNC or supervision, which is set up as a whole"
        eds = self.drive.node.eds
        found = None if eds is None else eds.about(entry)
        unknown = EdsEntry(entry, "rw", None, None, None, None, False)
        return why_not_written(found or unknown, self.drive.node.table)

    def _open(self, index: int, subindex: int = 0, mode: str = "rb", *_: Any, **settings: Any) -> Any:
        if "r" not in mode:
            raise StateError("a stream writes nothing beside a drive; assign the object's value")
        stream = io.BytesIO(self._upload(index, subindex))
        return stream if "b" in mode else io.TextIOWrapper(stream, settings.get("encoding", "ascii"))


@contextmanager
def _errors_of_canopen() -> Iterator[None]:
    """Errors of our client, as those that users of the package know."""
    try:
        yield
    except AbortError as error:
        raise canopen.SdoAbortedError(error.code) from error
    except TransportError as error:
        raise canopen.SdoCommunicationError(str(error)) from error


def dictionary(drive: CanOpenDrive) -> canopen.ObjectDictionary:
    """Of the drive's EDS file, its text put right; without one, of the standard's objects. Raises InputError for a lost file."""
    eds = drive.node.eds
    if eds is not None:
        sections = parse(decode_eds(Path(eds.path))).sections
        text = "".join(
            f"[{name}]\n" + "".join(f"{key}={value}\n" for key, value in keys.items())
            for name, keys in sections.items()
        )
        named: canopen.ObjectDictionary = import_eds(io.StringIO(text), drive.node_id)  # type: ignore[no-untyped-call]
        return named
    found = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
    for entry in cia301.NAMED.values():
        if not entry.subindex:
            variable = ODVariable(entry.name, entry.index, 0)
            variable.data_type = entry.type.code
            found.add_object(variable)
    return found


class SharedBus(can.BusABC):
    """The bus of a user's connected canopen.Network, whose Notifier hands us the frames. Closing it leaves the network connected.

    fed_by: the Notifier's thread. Raises InputError for a network that is not connected.
    """

    def __init__(self, network: canopen.Network) -> None:
        if network.bus is None or network.notifier is None:
            raise InputError("the canopen.Network is not connected: call its connect() first")
        super().__init__(channel="")
        self.channel_info = network.bus.channel_info
        self.fed_by: int | None = None
        self._network = network
        self._frames: queue.SimpleQueue[can.Message] = queue.SimpleQueue()
        self._tasks: list[Any] = []
        network.notifier.add_listener(self._feed)

    def _feed(self, message: can.Message) -> None:
        self.fed_by = threading.get_ident()
        self._frames.put(message)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            return self._frames.get(block=timeout != 0.0, timeout=timeout or None), False
        except queue.Empty:
            notifier = self._network.notifier
            if self._network.bus is None or notifier is None or notifier.exception is not None:
                raise can.CanOperationError("the canopen.Network was disconnected, or its Notifier ended") from None
            return None, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Past the network's lock: a stop does not wait for another thread's frame."""
        if self._network.bus is None:
            raise can.CanOperationError("the canopen.Network was disconnected")
        self._network.bus.send(msg, timeout)

    def send_periodic(self, msgs: Any, period: float, *arguments: Any, **settings: Any) -> Any:
        """By the user's bus: on SocketCAN the kernel sends, and ends with this process."""
        if self._network.bus is None:
            raise can.CanOperationError("the canopen.Network was disconnected")
        task: Any = self._network.bus.send_periodic(msgs, period, *arguments, **settings)
        self._tasks.append(task)
        return task

    def shutdown(self) -> None:
        """Stop listening and what was sent periodically."""
        for task in self._tasks:
            task.stop()
        if self._network.notifier is not None and self._feed in self._network.notifier.listeners:
            self._network.notifier.remove_listener(self._feed)
        super().shutdown()
