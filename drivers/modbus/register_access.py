"""A drive's registers by name, over a link: grouped reads, grouped writes, masked writes.

Stands between the link, which knows units and addresses, and the drive, which knows states and motion. Values here are raw.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from drivers.errors import CapabilityError, InputError, ProtocolError
from drivers.modbus.codec import Raw, decode, encode
from drivers.modbus.link import Doubt, ModbusLink
from drivers.modbus.map_roles import Condition, Write
from drivers.modbus.plan import ReadPlan, Span, group_writes, plan_reads
from drivers.modbus.register_map import Register, RegisterMap
from drivers.modbus.wire import Request


class RegisterAccess:
    """The registers of one unit on a link."""

    def __init__(self, link: ModbusLink, unit: int, registers: RegisterMap) -> None:
        self.link = link
        self.unit = unit
        self.registers = registers
        self._plans: dict[tuple[str, ...], ReadPlan] = {}
        self._seen: dict[str, int] = {}  # last values of registers that commands are written to

    def plan(self, names: Sequence[str]) -> ReadPlan:
        """The requests that read these registers, and the predicted wire time, s."""
        key = tuple(names)
        if key not in self._plans:
            self._plans[key] = plan_reads(
                [self._readable(name).place for name in key],
                self.link.cost,
                gaps_readable=self.registers.gaps_readable,
                apart=self.registers.one_value_per_request,
                avoid=[register.place for register in self.registers.registers.values() if not register.readable],
                max_registers=self.registers.max_read,
            )
        return self._plans[key]

    def read(self, names: Sequence[str], *, urgent: bool = False, repeats: int | None = None) -> dict[str, Raw]:
        """Raw values by name, in as few requests as the wire allows. urgent and repeats, and errors: see `ModbusLink.read`."""
        words = self.words(names, urgent=urgent, repeats=repeats)
        return {name: decode(each, self.registers[name].layout) for name, each in words.items()}

    def words(
        self, names: Sequence[str], *, urgent: bool = False, repeats: int | None = None
    ) -> dict[str, tuple[int, ...]]:
        read = partial(self.link.read, self.unit, urgent=urgent, repeats=repeats)
        answers = [(request, read(request.table, request.span)) for request in self.plan(names).requests]
        words: dict[str, tuple[int, ...]] = {}
        for name in names:
            register = self.registers[name]
            for request, values in answers:
                if request.table is register.table and request.span.covers(register.span):
                    first = register.span.start - request.span.start
                    words[name] = values[first : first + register.span.count]
                    break
        return words

    def integers(self, names: Iterable[str], *, urgent: bool = False) -> dict[str, int]:
        """Raw values of whole-number registers. Raises InputError for another type, and as `read`."""
        raw = self.read(tuple(dict.fromkeys(names)), urgent=urgent)
        return {name: whole(value, name) for name, value in raw.items()}

    def of_conditions(self, conditions: Sequence[Condition]) -> dict[str, int]:
        """Raw values of all registers named in conditions."""
        return self.integers(condition.register for condition in conditions)

    def write(self, values: Mapping[str, Raw]) -> None:
        """Write raw values in the order given, neighbours together in one request; certain when this returns.

        Raises CapabilityError for a read-only register, InputError, and as `ModbusLink.write`."""
        self.write_words({name: encode(value, self.registers[name].layout) for name, value in values.items()})

    def write_words(self, values: Mapping[str, tuple[int, ...]]) -> None:
        """As `write`, for the words themselves."""
        names = list(values)
        places = [self._writable(name).place for name in names]
        apart = self.registers.one_value_per_request
        for group in (
            [[at] for at in range(len(names))]
            if apart
            else group_writes(places, max_registers=self.registers.max_write)
        ):
            words = tuple(word for index in group for word in values[names[index]])
            table, first = places[group[0]]
            provable = all(self.registers[names[index]].shows_writes for index in group)
            self.link.write(
                self.unit,
                table,
                first.start,
                words,
                doubt=Doubt.READ_BACK if provable else Doubt.RAISE,
                single=self.registers.single_writes,
            )
            if provable and self.registers.prove_writes:
                self._prove({names[index]: values[names[index]] for index in group})

    def _prove(self, values: Mapping[str, tuple[int, ...]]) -> None:
        """Read back what was acknowledged. Raises ProtocolError for a write that the drive dropped."""
        for name, seen in self.words(tuple(values)).items():
            if seen != values[name]:
                register = self.registers[name]
                raise ProtocolError(
                    f"register {name} ({register.table.value} {register.span.start:#06x}) was written as"
                    f" {decode(values[name], register.layout)!r}, acknowledged, and reads {decode(seen, register.layout)!r}:"
                    " nothing is mapped to that address, or it cannot be written now"
                )

    def command(self, write: Write, *, stops: bool = False) -> None:
        """One write of a command. stops: it stops the axis or takes its power, see `Doubt.STOP`; back-off is ignored."""
        register = self._writable(write.register)
        value = write.value
        if write.mask is not None:
            before = self.integers([register.name], urgent=stops)[register.name]
            value = (before & ~write.mask) | write.value
        self._seen[register.name] = value
        doubt = Doubt.READ_BACK if register.shows_writes else Doubt.RAISE
        self.link.write(
            self.unit,
            register.table,
            register.span.start,
            encode(value, register.layout),
            doubt=Doubt.STOP if stops else doubt,
            single=self.registers.single_writes,
            urgent=stops,
        )
        if self.registers.prove_writes and register.shows_writes and not stops:
            self._prove({register.name: encode(value, register.layout)})

    def post(self, writes: Sequence[Write]) -> None:
        """Send the writes of a stop without waiting, see `ModbusLink.post`.

        In a register of which only some bits are written, the others are those of `note` or of the last command.
        """
        self.link.post(self.unit, [self._request(write) for write in writes])

    def _request(self, write: Write) -> Request:
        register = self._writable(write.register)
        value = write.value
        if write.mask is not None:
            value |= self._seen.get(register.name, 0) & ~write.mask
        words = encode(value, register.layout)
        return Request.write(register.table, register.span.start, words, single=self.registers.single_writes)

    def note(self, writes: Sequence[Write]) -> None:
        """Read the registers whose other bits `post` needs for these writes."""
        names = [write.register for write in writes if write.mask is not None]
        if names:
            self._seen.update(self.integers(names))

    def neighbourhood(self, name: str, around: int) -> tuple[int, tuple[int, ...]]:
        """The words from `around` registers before to `around` after; returns how many precede the register's own, and the words."""
        register = self._readable(name)
        first = max(0, register.span.start - around)
        last = min(0x10000, register.span.end + around)
        return register.span.start - first, self.link.read(self.unit, register.table, Span(first, last - first))

    def _readable(self, name: str) -> Register:
        register = self.registers[name]
        if not register.readable:
            raise CapabilityError(f"register {name} is write only")
        return register

    def _writable(self, name: str) -> Register:
        register = self.registers[name]
        if not register.writable:
            raise CapabilityError(f"register {name} is read only")
        return register


def whole(value: Raw, name: str) -> int:
    """The raw value as a whole number. Raises InputError for another type."""
    if not isinstance(value, int):
        raise InputError(f"register {name} holds {value!r}, expected a whole number")
    return value
