"""Python code of a user's own, from a file that the user names; and where in it an error came from."""

from __future__ import annotations

import sys
import traceback
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from drivers.errors import InputError
from drivers.files import encoding_of, read_bytes


def load_code(path: str | Path, expected: str) -> ModuleType:
    """Run a Python file; its module. expected: what the file is to hold, for messages.

    Raises InputError naming the file, and the line where its code fails.
    """
    place = Path(path)
    if not place.is_file():
        raise InputError(f"is no file; expected Python code with {expected}", path=path)
    if (codec := encoding_of(read_bytes(path))) not in ("utf-8", "utf-8-sig"):
        raise InputError(f"is {codec.upper()} text, expected Python code in UTF-8: save it as UTF-8", path=path)
    name = f"hil_user_code_{abs(hash(place.resolve())):x}"
    spec = spec_from_file_location(name, place.resolve())
    if spec is None or spec.loader is None:
        raise InputError(f"is no Python; expected a .py file with {expected}", path=path)
    module = module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up while it loads
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        what, line = in_short(error), line_in(error, spec.origin)
        raise InputError(f"fails when loaded: {what}", path=path, line=line) from error
    return module


def line_in(error: BaseException, file: str | None) -> int | None:
    """The last line of a file in an exception's traceback; None where it has none."""
    if isinstance(error, SyntaxError) and error.filename == file:
        return error.lineno
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return lines[-1] if lines else None


def in_short(error: BaseException) -> str:
    """Type and message of an exception."""
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
