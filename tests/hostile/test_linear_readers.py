"""Every reader takes time in proportion to what it reads: the exponent of time over size, fitted over three doublings."""

from __future__ import annotations

import gc
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hostile import files
from support.register_maps import load_register_map

from drivers.canopen.dcf import pack_concise, unpack_concise
from drivers.canopen.eds import load_eds
from drivers.errors import InputError
from drivers.instruments.ascii_values import AsciiDecoder, AsciiSettings
from drivers.instruments.nd2xx import Nd2xxDecoder
from drivers.instruments.replay import Recording
from drivers.instruments.umd import UmdDecoder
from drivers.toml_schema import Document
from hil.correction.formats import fanuc, keysight, linuxcnc, measured_csv, sinumerik, twincat, wide_iso
from hil.correction.manual import read_manual_tables
from hil.effects.model import Model
from hil.parameters.set_file import read_set
from hil.records.files import parse_json
from hil.records.rows import parse_csv

STEEPEST = 1.35
"""Largest exponent that passes. A linear reader measures 0.9 to 1.15 on a busy machine, a quadratic one 1.6 (small sizes) to 2."""
ROUNDS = 3
ATTEMPTS = 3
"""A busy neighbour of this processor slows one size and not another; a reader that is not linear is steep each time."""
LEAST_S = 0.02
"""CPU time that the largest size must take, so that the fit measures the reader; smaller sizes are doubled until then."""

HEAD = "run,direction,target_mm,measured_mm"
MAP = '[map]\nname = "m"\naddress_base = "pdu0"\nword_order = "big"\ntable = "holding"\n'


def _iso(runs: int) -> str:
    return "t;" + ";".join(f"{run}+" for run in range(runs)) + "\n1;" + ";".join("1" for _ in range(runs)) + "\n"


def _path(read: Callable[[Path], object], suffix: str = "") -> Callable[[str, Path], object]:
    def reading(text: str, folder: Path) -> object:
        path = folder / f"file{suffix}"
        path.write_text(text)
        return read(path)

    return reading


def _text(read: Callable[[str], object]) -> Callable[[str, Path], object]:
    return lambda text, _: read(text)


def _bytes(read: Callable[[bytes], object]) -> Callable[[str, Path], object]:
    return lambda text, _: read(text.encode("latin-1"))


CASES: dict[str, tuple[Callable[[int], str], Callable[[str, Path], object]]] = {
    "EDS, objects": (files.eds, _path(load_eds)),
    "EDS, records": (lambda n: files.eds(n // 8, 8), _path(load_eds)),
    "EDS, orphans": (lambda n: "".join(f"[{0x2000 + i:04X}sub1]\n" for i in range(n)), _path(load_eds)),
    "EDS, compact arrays": (
        lambda n: "".join(f"[{0x2000 + i:04X}]\nCompactSubObj=9\n" for i in range(n)),
        _path(load_eds),
    ),
    "EDS, one section": (lambda n: "[1000]\nDataType=7\n" + "a=1\n" * n, _path(load_eds)),
    "DCF": (files.dcf, _path(load_eds)),
    "concise DCF": (
        lambda n: pack_concise([((0x2000, 1), b"x")] * n).decode("latin-1"),
        _bytes(unpack_concise),
    ),
    "records, columns": (files.wide_header, _text(parse_csv)),
    "records, rows": (lambda n: HEAD + "\n" + "1,1,2.5,3.5\n" * n, _text(parse_csv)),
    "records, withdrawn": (lambda n: HEAD + "\n" + "1,1,2.5,3.5\n1,1,1,1\n# withdrawn 1: x\n" * n, _text(parse_csv)),
    "wide ISO, blanks": (lambda n: "t;1" + " " * n + "x\n1;2\n", _text(wide_iso.load)),
    "wide ISO, tabs and words": (lambda n: "t;run" + " \t" * n + "=\n1;2\n", _text(wide_iso.load)),
    "wide ISO, rows": (lambda n: "t;1+\n" + "".join(f"{i};1\n" for i in range(n)), _text(wide_iso.load)),
    "wide ISO, runs": (_iso, _text(wide_iso.load)),
    "measured CSV, rows": (lambda n: HEAD + "\n" + "1,1,2.5,3.5\n" * n, _text(measured_csv.load)),
    "measured CSV, columns": (files.wide_header, _text(measured_csv.load)),
    "Keysight": (
        lambda n: (
            f"Identify=Positions,TextUnit={' '.join(map(str, range(n)))} mm\nIdentify=LinearErr,TextUnit={'1 ' * 2 * n}um\n"
        ),
        _text(keysight.load),
    ),
    "Keysight, blanks": (lambda n: "Identify=" + " " * n + "x\n", _text(keysight.load)),
    "FANUC": (lambda n: "G10 L50\n" + "".join(f"N{10000 + i} R1\n" for i in range(n)) + "G11\n", _text(fanuc.load)),
    "FANUC, blanks": (lambda n: "G10 L50\nN1" + " " * n + "x\nG11\n", _text(fanuc.load)),
    "FANUC, remarks": (lambda n: "(" * n, _text(fanuc.load)),
    "SINUMERIK": (
        lambda n: "CHANDATA(1)\n" + "".join(f"$AA_ENC_COMP[0,{i},AX1]=0.001\n" for i in range(n)) + "M17\n",
        _text(sinumerik.load),
    ),
    "SINUMERIK, blanks": (lambda n: "$AA_ENC_COMP[0,1,AX1]" + " " * n + "x\n", _text(sinumerik.load)),
    "LinuxCNC": (lambda n: "".join(f"{i} 0.001 0.001\n" for i in range(n)), _text(linuxcnc.load)),
    "TwinCAT": (
        lambda n: "kw.ssfk.kw_nr_max 1\n" + "".join(f"kw.ssfk.table[{i}].pos {i}\n" for i in range(n)),
        _text(twincat.load),
    ),
    "TwinCAT, remarks": (lambda n: "(*" * n, _text(twincat.load)),
    "manual tables": (
        lambda n: "position_mm,plus_um,minus_um\n" + "".join(f"{i},1,1\n" for i in range(n)),
        _path(read_manual_tables),
    ),
    "recording, columns": (
        lambda n: "time_s," + ",".join(f"c{i}" for i in range(n)) + "\n0" + ",1" * n,
        _path(Recording.read),
    ),
    "recording, rows": (lambda n: "time_s,laser_mm\n" + "1,2.5\n" * n, _path(Recording.read)),
    "model, terms": (lambda n: files.model(terms=[files.TERM] * n), _text(Model.from_json)),
    "model, table": (
        lambda n: files.model(
            table={
                **files.MODEL["table"],
                "positions_mm": list(range(n)),
                "forward_um": [0] * n,
                "backward_um": [0] * n,
            }
        ),
        _text(Model.from_json),
    ),
    "JSON, brackets": (lambda n: "[" * n, _text(parse_json)),
    "JSON, lists": (lambda n: json.dumps([[1]] * n), _text(parse_json)),
    "TOML, keys": (lambda n: "".join(f"k{i} = 1\n" for i in range(n)), _text(lambda text: Document("f", text).lines)),
    "TOML, tables": (lambda n: "".join(f"[t{i}]\n" for i in range(n)), _text(lambda text: Document("f", text).lines)),
    "TOML, lists of tables": (lambda n: "[[t]]\n" * n, _text(lambda text: Document("f", text).lines)),
    "TOML, dotted key": (lambda n: ".".join("a" * n) + " = 1", _text(lambda text: Document("f", text).lines)),
    "TOML, digits": (lambda n: "x = 0b" + "1" * n, _text(lambda text: Document("f", text).values)),
    "TOML, letters": (lambda n: "x" * n + " = 1", _text(lambda text: Document("f", text).lines)),
    "TOML, parts and blanks": (
        lambda n: "x = [" + "a . " * 31 + " " * n + ". " * 40,
        _text(lambda text: Document("f", text).lines),
    ),
    "TOML, quotes": (lambda n: "x = [" + '"\\\\", ' * n + "]", _text(lambda text: Document("f", text).lines)),
    "register map": (
        lambda n: MAP + "".join(f'[registers.r{i}]\naddress = {i}\ntype = "u16"\n' for i in range(n)),
        _path(load_register_map, ".toml"),
    ),
    "parameter set": (
        lambda n: (
            'format = "hil parameter set 1"\nname = "a"\n'
            + "".join(f"[[parameters]]\nindex = {0x2000 + i}\nvalue = 1\n" for i in range(n))
        ),
        _path(read_set, ".toml"),
    ),
    "laser, lines": (lambda n: "\n" + "1 1 5 0 0 7 0 0\r\n" * n, _bytes(lambda data: UmdDecoder().feed(data))),
    "laser, no line end": (lambda n: "1 " * n, _bytes(lambda data: UmdDecoder().feed(data))),
    "gauge, lines": (
        lambda n: "\n" + "01A+0000.123\r" * n,
        _bytes(lambda data: AsciiDecoder(AsciiSettings("mitutoyo")).feed(data)),
    ),
    "gauge, blanks": (
        lambda n: "\n" + (" " * 199 + "\r") * n,
        _bytes(lambda data: AsciiDecoder(AsciiSettings("number")).feed(data)),
    ),
    "display": (lambda n: "+       1.5       \r\n" * n, _bytes(lambda data: Nd2xxDecoder().feed(data))),
}


def _seconds(
    make: Callable[[int], str], read: Callable[[str, Path], object], size: int, folder: Path, rounds: int = ROUNDS
) -> float:
    """CPU seconds for a file of this size, the least of some rounds; a refusal counts like a reading."""
    text = make(size)
    least = np.inf
    for _ in range(rounds):
        gc.collect()
        gc.disable()
        began = time.thread_time()
        try:
            read(text, folder)
        except (InputError, ValueError):  # what a reader may raise is asked elsewhere
            pass
        finally:
            least = min(least, time.thread_time() - began)
            gc.enable()
    return float(least)


@pytest.fixture
def _only_new_objects() -> None:
    """Collections before a round look at what the readers left, not at the hundreds of megabytes of the other tests."""
    gc.collect()
    gc.freeze()


@pytest.mark.outside
@pytest.mark.usefixtures("_only_new_objects")
@pytest.mark.parametrize("case", CASES)
def test_time_grows_with_the_size_and_no_faster(
    case: str, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    make, read = CASES[case]
    size = 500
    while _seconds(make, read, 8 * size, tmp_path, rounds=1) < LEAST_S and size < 1 << 17:
        size *= 2
    sizes = [size, 2 * size, 4 * size, 8 * size]
    exponent = np.inf
    for _ in range(ATTEMPTS):
        times = [_seconds(make, read, each, tmp_path) for each in sizes]
        # the middle one of three doublings: where a text outgrows the processor's cache there is one step, and no growth
        exponent = min(exponent, float(np.median(np.diff(np.log2(times)))))
        if exponent < STEEPEST:
            break
    record_property("exponent", round(exponent, 2))
    record_property("seconds", f"{times[-1]:.3f} s for {sizes[-1]}")
    print(f"{case}: exponent {exponent:.2f}, {times[-1]:.3f} s for {sizes[-1]}")
    assert exponent < STEEPEST, times
