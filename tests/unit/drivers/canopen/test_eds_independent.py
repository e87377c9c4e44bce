"""All published EDS and DCF files against an independent reading by regular expressions: nothing differs without a note."""

from __future__ import annotations

import math
import os
from collections import Counter
from pathlib import Path

import pytest
from support.eds_by_expressions import FIELDS, WRONG, read

from drivers.canopen.eds import EdsFile, load_eds
from drivers.canopen.eds_text import summary
from drivers.errors import InputError

DATA = Path(os.environ.get("HIL_SHARED_DATA", Path(__file__).parents[5] / "shared" / "data")) / "eds"
FILES = sorted(path for path in DATA.glob("*") if path.suffix in (".eds", ".dcf"))
NODE = 5
EMPTY = {
    "christiansandberg__canopen__test.eds",
    "golems__socanmatic__pdo-template.eds",
    "ipa320__cob_robots__2_Schunk_0_63.dcf",
}
"""Files without any object: refused."""
OURS = {"default": "DefaultValue", "value": "ParameterValue", "low": "LowLimit", "high": "HighLimit"}
pytestmark = pytest.mark.skipif(
    not FILES, reason="no EDS files: set HIL_SHARED_DATA or put ../shared/data beside the project"
)


def _same(ours: object, theirs: object) -> bool:
    if isinstance(ours, float) or isinstance(theirs, float):
        return (
            isinstance(ours, int | float)
            and isinstance(theirs, int | float)
            and math.isclose(ours, theirs, rel_tol=1e-12)
        )
    return type(ours) is type(theirs) and ours == theirs


def _differences(eds: EdsFile, path: Path) -> tuple[int, list[str], Counter[str]]:
    """Number of values compared, those that differ without a note of ours, and the noted ones by kind."""
    noted: dict[tuple[str, str], str] = {}
    for note in eds.notes:
        for key in note.key.split(" and "):
            noted[note.place.strip("[]").upper(), key] = note.kind
    theirs = read(path, NODE).entries
    compared, silent, kinds = 0, [], Counter[str]()
    for key in sorted(theirs.keys() | eds.entries.keys()):
        found, meant = eds.entries.get(key), theirs.get(key)
        if found is None or meant is None:
            # a compact array's count, or an object without members, is made up by one of the two
            held = (found.default, found.value) if found is not None else tuple((meant or {}).values())
            if key[1] == 0 and (found is None or found.entry.name == "NrOfObjects"):
                assert all(value in (None, WRONG) or isinstance(value, int) for value in held)
            elif (f"{key[0]:04X}", "CompactSubObj") in noted:
                kinds[noted[f"{key[0]:04X}", "CompactSubObj"]] += 1
            else:
                silent.append(f"{key[0]:04X}h:{key[1]:02X} is read by one only")
            continue
        for name in FIELDS:
            if name not in meant:
                continue
            ours = getattr(found, name)
            compared += ours is not None or meant[name] is not None
            if _same(ours, meant[name]) or (ours is None and meant[name] is None):
                continue
            places = (f"{key[0]:04X}SUB{key[1]:X}", f"{key[0]:04X}")
            whys = [
                noted[place, what]
                for place in places
                for what in (OURS[name], "DataType", "")
                if (place, what) in noted
            ]
            if whys:
                kinds[whys[0]] += 1
            else:
                silent.append(f"{key[0]:04X}h:{key[1]:02X} {name}: {ours!r}, meant is {meant[name]!r}")
    return compared, silent, kinds


@pytest.mark.outside
def test_no_value_differs_without_a_note() -> None:
    compared, refused, silent, kinds, longest = 0, set(), {}, Counter[str](), 0
    for path in FILES:
        try:
            eds = load_eds(path, NODE)
        except InputError:
            refused.add(path.name)
            continue
        count, differing, noted = _differences(eds, path)
        compared, kinds = compared + count, kinds + noted
        longest = max(longest, len(summary(eds.notes)))
        if differing:
            silent[path.name] = differing
    assert not silent
    assert refused == EMPTY
    assert len(FILES) == 151
    assert compared > 50_000
    assert kinds == {
        "is no DOMAIN in hexadecimal digits, left out": 39,
        "limits hold nothing, left out": 14,
        "limits of 0 are none, left out": 164,
        "is one too many, 254 were assumed": 3,
    }
    assert longest <= 8  # lines of the summary
