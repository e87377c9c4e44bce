"""Where the facts of a register map come from, how strong they are, and which of them were proven on the drive at hand.

A map of a drive that nobody here has seen is a list of claims. Each has a source and a strength; the weak ones are used
only after `hil doctor` has proven them on the user's own drive. What was proven is kept per map and drive in a `FactLedger`.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from drivers.errors import InputError
from drivers.facts import Strength
from drivers.files import read_bytes, read_text, replace_file
from drivers.toml_types import Text


class Proof(Enum):
    """What proves a fact on the user's drive."""

    READING = "reading"  # the preflight's reading, without motion
    ENABLING = "enabling"  # power on and off at rest, each shown by the drive
    MOVE = "move"  # the small moves against instrument and clock
    STOP = "stop"  # a quick stop out of a slow move
    HOMING = "homing"  # one supervised homing
    PERSON = "person"  # a person looks, as nothing safe shows it


@dataclass(frozen=True)
class Origin:
    """Source of a map or of one of its registers. revision: of the manual or firmware that it describes."""

    source: Text = "stated nowhere"
    revision: Text = "not stated"
    strength: Strength = Strength.NOTES
    verified_on_hardware: bool = False

    def but(self, source: str | None, strength: Strength | None) -> Origin:
        """The same with another source or strength, where one is given. One that is weak has no source unless it states one."""
        usual = "none that was read" if strength is not None and strength.is_weak else self.source
        return replace(self, source=source or usual, strength=strength or self.strength)


UNSTATED = Origin()


@dataclass(frozen=True)
class Fact:
    """One statement about a model that is no register. remedy: what the user can do where it does not hold."""

    about: Text
    says: Text
    source: Text
    strength: Strength
    proof: Proof = Proof.READING
    remedy: Text = ""


class FactLedger:
    """Proofs made so far on one drive with one map, in a JSON file. drive: its address; map_file: whose text is the map.

    A changed map or another drive has no proofs.
    """

    def __init__(self, path: Path, drive: str, map_file: Path) -> None:
        self._path = path
        digest = hashlib.sha256(read_bytes(map_file)).hexdigest()[:16]
        self._key = f"{drive} by map {digest}"

    def proven(self) -> frozenset[Proof]:
        """Proofs made on this drive. Raises InputError for a file that cannot be read."""
        return frozenset(Proof(name) for name in self._all().get(self._key, ()))

    def add(self, proofs: frozenset[Proof]) -> None:
        """Remember these proofs too. Raises InputError."""
        everything = self._all()
        everything[self._key] = sorted({*everything.get(self._key, ()), *(proof.value for proof in proofs)})
        self._path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self._path, (json.dumps(everything, indent=1) + "\n").encode())

    def _all(self) -> dict[str, list[str]]:
        if not self._path.exists():
            return {}
        try:
            found = json.loads(read_text(self._path))
            return {str(key): [Proof(name).value for name in names] for key, names in found.items()}
        except (ValueError, AttributeError, TypeError, RecursionError) as error:
            raise InputError("does not say which facts were proven", path=self._path) from error
