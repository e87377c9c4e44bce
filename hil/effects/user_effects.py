"""Effects of a user's own beside the catalogue: from a file named on the command line, or from an installed package.

Code from outside is named on the command line, or by the entry points (group `hil.effects`) of installed packages; no records, model,
axis or sealed file can name any. The result is a tuple that the caller passes on; there is no registry.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import BridgeError, InputError
from hil.effects import ALL, NEVER_SEARCHED, Action, Effect, Rival, survey_of
from hil.effects.history import complete
from hil.effects.user_code import in_short, line_in, load_code

GROUP = "hil.effects"
"""Group of the entry points; each names an effect, or a tuple of effects."""
ID = re.compile(r"[a-z][a-z0-9_]*")


def catalogue_with(paths: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """The catalogue, the effects of installed packages, and those of the files, in this order.

    Raises InputError naming the file or package, and the line where there is one: for code that does not load, that
    holds no effect, or one whose id is taken.
    """
    effects: dict[str, Effect] = {effect.id: effect for effect in ALL}
    origin = dict.fromkeys((effect.id for effect in (*ALL, *NEVER_SEARCHED)), "the catalogue")
    found = [(_package(entry), _effects_of(_loaded(entry), _package(entry))) for entry in entry_points(group=GROUP)]
    found.extend((str(path), effects_of_file(path)) for path in paths)
    for place, own in found:
        for effect in own:
            if effect.id in origin:
                raise InputError(f"defines the effect {effect.id!r}, which {origin[effect.id]} has already", path=place)
            effects[effect.id], origin[effect.id] = effect, place
    return tuple(effects.values())


def effects_of_file(path: str | Path) -> tuple[Effect, ...]:
    """The `EFFECTS` of one Python file, which is run. Raises InputError naming the file, and the line where its code
    fails.
    """
    module = load_code(path, "EFFECTS = (…)")
    if not hasattr(module, "EFFECTS"):
        raise InputError("holds no EFFECTS; expected EFFECTS = (MyEffect(), …)", path=path)
    return _effects_of(module.EFFECTS, path)


def check_on(effects: Sequence[Effect], columns: Mapping[str, NDArray[np.float64]]) -> None:
    """Evaluates every effect outside the catalogue on the columns of some records, each (n,): one basis per form.

    Raises InputError naming the file for a basis that is not (n, k) or not finite, before the search uses it.
    """
    own = [effect for effect in effects if effect not in ALL]
    if not own:
        return
    whole = complete(columns)
    survey = survey_of(whole)
    with attributing_errors(own):
        for effect in own:
            for form in effect.forms(survey):
                if not form.starts:
                    raise InputError(f"effect {effect.id}, form {form.name!r}, has no starts", path=_file_of(effect))
                for theta in dict.fromkeys((form.starts[0], form.starts[-1])):
                    basis = np.asarray(effect.basis(form, theta, whole))
                    wrong = ""
                    if basis.ndim != 2 or len(basis) != survey.rows:
                        wrong = f"has a basis of shape {basis.shape}, expected ({survey.rows}, k)"
                    elif not np.all(np.isfinite(basis)):
                        wrong = f"has a basis that is not finite, at the parameters {theta}"
                    if wrong:
                        raise InputError(f"effect {effect.id}, form {form.name!r}, {wrong}", path=_file_of(effect))


@contextmanager
def attributing_errors(effects: Sequence[Effect]) -> Iterator[None]:
    """Turns an exception raised by the code of a user's own effect into an InputError with its file and line; others
    pass unchanged.
    """
    files = {file for effect in effects if effect not in ALL and (file := _file_of(effect))}
    try:
        yield
    except BridgeError:
        raise
    except Exception as error:
        for file in files:
            line = line_in(error, file)
            if line is not None:
                raise InputError(f"fails: {in_short(error)}", path=file, line=line) from error
        raise


def _package(entry: EntryPoint) -> str:
    return f"package {entry.dist.name if entry.dist else '?'} (entry point {entry.name})"


def _loaded(entry: EntryPoint) -> object:
    try:
        return entry.load()
    except (Exception, SystemExit) as error:
        raise InputError(f"fails when loaded: {in_short(error)}", path=_package(entry)) from error


def _effects_of(value: object, place: str | Path) -> tuple[Effect, ...]:
    """Checks the effects of a file or package. Raises InputError."""
    own: list[Effect] = []
    offered = list(value) if isinstance(value, (tuple, list)) else [value]
    if not offered:
        raise InputError("holds no effect; expected EFFECTS = (MyEffect(), …)", path=place)
    for effect in offered:
        if isinstance(effect, type) and issubclass(effect, Effect):
            raise InputError(f"offers the class {effect.__name__}; expected an object: {effect.__name__}()", path=place)
        if not isinstance(effect, Effect):
            raise InputError(f"offers {_short(effect)} as an effect; expected a hil.effects.Effect", path=place)
        _check(effect, place)
        own.append(effect)
    return tuple(own)


def _check(effect: Effect, place: str | Path) -> None:
    name = type(effect).__name__
    for attribute, kind in (("id", str), ("title", str), ("action", Action), ("rivals", tuple)):
        value = getattr(effect, attribute, None)
        if not isinstance(value, kind):
            what = f"{name}.{attribute} is {_short(value)}, expected {kind.__name__}"
            raise InputError(what, path=place)
    if not ID.fullmatch(effect.id):
        raise InputError(f"{name}.id is {_short(effect.id)}, expected small letters, digits and _", path=place)
    if not all(isinstance(rival, Rival) for rival in effect.rivals):
        raise InputError(f"{name}.rivals holds something else than Rival", path=place)


def _file_of(effect: Effect) -> str | None:
    return getattr(sys.modules.get(type(effect).__module__), "__file__", None)


def _short(value: object) -> str:
    return repr(value)[:60]
