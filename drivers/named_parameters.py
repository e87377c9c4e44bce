"""A drive's parameters by name, one at a time, on every wire: over its `RawParameters`."""

from __future__ import annotations

from dataclasses import replace

from drivers.cia402.wire import OBJECT_MISSING
from drivers.errors import AbortError, BridgeError, CapabilityError, InputError
from drivers.parameters import DriveParameters, ParameterInfo, ParameterValue
from drivers.raw_parameters import RawParameter, RawParameters, Steps, T


class NamedParameters(DriveParameters):
    """Parameters of one open drive. A value that it was found with may be put back, also where its limits exclude it."""

    def __init__(self, raw: RawParameters) -> None:
        self._raw = raw
        self._present: tuple[str, ...] | None = None if raw.assumed else tuple(raw.names)
        self._found: dict[str, bytes] = {}  # by address, as first read

    @property
    def names(self) -> tuple[str, ...]:
        if self._present is None:
            shown = self._run(self._raw.read(list(self._raw.names.values())))
            for each in shown:
                missing = isinstance(each.error, AbortError) and each.error.code in OBJECT_MISSING
                if each.error is not None and not missing:
                    raise each.error
            self._present = tuple(
                name for name, each in zip(self._raw.names, shown, strict=True) if each.data is not None
            )
        return self._present

    def describe(self, name: str) -> ParameterInfo:
        entry = self._find(name)
        return replace(entry.info, name=name, unit=self._raw.unit_of(entry))

    def read(self, name: str) -> ParameterValue:
        entry = self._find(name)
        return self._raw.decode(entry, self._shown(entry))

    def write(self, name: str, value: ParameterValue) -> bool:
        """As `DriveParameters.write`; raises StateError too where no write to its memory is left."""
        raw, entry = self._raw, self._find(name)
        if entry.refusal is not None:
            raise CapabilityError(f"drive {raw.name}: {entry.title} {entry.refusal}")
        present = self._shown(entry)
        found = self._found[entry.address]
        data = found if raw.decode(entry, found) == value else self._encoded(name, entry, value)
        if raw.same(entry, present, data):
            return False
        refused = self._run(raw.write([(entry.address, data)]))[0].error
        if isinstance(refused, AbortError):
            why = str(refused).removeprefix(f"drive {raw.name}: ")
            raise AbortError(f"drive {raw.name} refuses {name} = {value!r}: {why}", refused.code) from refused
        if refused is not None:
            raise refused
        self._run(raw.prove({entry.address: data}))
        return True

    def _encoded(self, name: str, entry: RawParameter, value: ParameterValue) -> bytes:
        outside = self._raw.outside(entry, value)
        if outside is not None:
            raise InputError(f"{name}: {outside}", path=self._raw.path)
        try:
            return self._raw.encode(entry, value)
        except InputError as error:
            raise InputError(f"{name}: {error.what}") from error

    def _shown(self, entry: RawParameter) -> bytes:
        data = self._run(self._raw.show([entry.address]))[entry.address]
        self._found.setdefault(entry.address, data)
        return data

    def _run(self, steps: Steps[T]) -> T:
        (result,) = self._raw.line.run([steps])
        if isinstance(result, BridgeError):
            raise result
        return result

    def _find(self, name: str) -> RawParameter:
        address = self._raw.names.get(name)
        entry = None if address is None else self._raw.find(address)
        if entry is None:
            raise InputError(f"drive {self._raw.name} has no parameter {name!r}")
        return entry
