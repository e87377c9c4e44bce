"""Line numbers of each table, key and list member of a TOML document, which `tomllib` does not give. No I/O."""

from __future__ import annotations

import re
import tomllib

Place = tuple[str | int, ...]
"""Keys and indices from the root of the document: ("drive", "state", 0, "bit")."""

_TOKEN = re.compile(
    r'#[^\n]*|"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|\n|[\[\]{},=.]|[^\s\[\]{},=."\'#]+',
    re.S,
)


def lines_of(text: str) -> dict[Place, int]:
    """The line, from 1, on which each part of a valid document begins."""
    return _Scanner(text).found


class _Scanner:
    """Every table, key and member of a list of a valid document, with its line, in `found`."""

    def __init__(self, text: str) -> None:
        self.found: dict[Place, int] = {}
        self._tokens: list[tuple[str, int]] = []
        line = 1
        for match in _TOKEN.finditer(text):
            if match[0][0] != "#":
                self._tokens.append((match[0], line))
            line += match[0].count("\n")
        self._at = 0
        counts: dict[Place, int] = {}
        table: Place = ()
        while self._at < len(self._tokens):
            match self._token:
                case "\n":
                    self._at += 1
                case "[":
                    line = self._tokens[self._at][1]
                    double = self._tokens[self._at + 1][0] == "["
                    self._at += 1 + double
                    table = ()
                    parts = self._key("]")
                    for left, part in zip(reversed(range(len(parts))), parts, strict=True):
                        table = (*table, part)
                        self.found.setdefault(table, line)
                        if double and not left:
                            counts[table] = counts.get(table, -1) + 1
                        table = (*table, counts[table]) if table in counts else table
                        self.found.setdefault(table, line)
                    self._at += double
                case _:
                    self._member(table)

    @property
    def _token(self) -> str:
        return self._tokens[self._at][0] if self._at < len(self._tokens) else "\n"

    def _key(self, end: str) -> list[str]:
        """The parts of a dotted key, up to and with what ends it."""
        parts = []
        while (token := self._token) != end:
            self._at += 1
            if token != ".":
                parts.append(next(iter(tomllib.loads(f"{token} = 0"))) if token[0] in "\"'" else token)
        self._at += 1
        return parts

    def _member(self, table: Place) -> None:
        """`key = value` of a table."""
        line = self._tokens[self._at][1]
        for part in self._key("="):
            table = (*table, part)
            self.found.setdefault(table, line)
        self._value(table)

    def _value(self, place: Place) -> None:
        opened, index = self._token, 0
        self._at += 1
        if opened not in ("[", "{"):
            while self._token not in (",", "]", "}", "\n"):
                self._at += 1
            return
        while self._token not in ("]", "}"):
            if self._token in (",", "\n"):
                self._at += 1
            elif opened == "{":
                self._member(place)
            else:
                self.found[*place, index] = self._tokens[self._at][1]
                self._value((*place, index))
                index += 1
        self._at += 1
