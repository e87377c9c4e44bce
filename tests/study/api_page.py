"""Writes hil/docs/api.md, the names of `import hil` with their signatures: python tests/study/api_page.py."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path

from hil.script import given as values
from hil.script import names

PAGE = Path(__file__).parents[2] / "hil/docs/api.md"
HEAD = """# The names of `import hil`

How to use them: [scripts](scripts.md). An argument is shown with its default, or else with its type.
"""
ALIKE = ("form", "sentence", "records", "raw", "axis", "certificate")
"""Members that say the same of every result; they are described once, at the base class."""
OWN = (
    "Axis.confine",
    "Axis.hold",
    "OpenAxis.forget",
    *(f"BacklashResult.{name}" for name in ("how", "settings", "kept", "table", "parameters", "identity")),
    *(f"ReversalResult.{name}" for name in ("how", "present", "verdict", "published", "facts", "identity")),
)
"""Members that only this program calls."""
SECTIONS = {"measurement": values.Measuring, "lost_motion": values.Reversing, "backlash": values.Winding}
"""Values of a call, by section of the axis file."""


def text() -> str:
    """The page."""
    objects = {name: getattr(names, name) for name in names.__all__}
    functions = {name: one for name, one in objects.items() if inspect.isfunction(one)}
    errors = {name: one for name, one in objects.items() if isinstance(one, type) and issubclass(one, Exception)}
    classes = {name: one for name, one in objects.items() if name not in functions and name not in errors}
    parts = [HEAD]
    for name, function in functions.items():
        what, named = described(function)
        parts.append(f"## hil.{name}\n\n`{signature(name, function)}`\n\n{what}\n")
        parts += [*(f"- {part}" for part in named), ""]
    for name, one in classes.items():
        based = f" A `hil.{one.__bases__[0].__name__}`." if one.__bases__[0].__name__ in classes else ""
        if not isinstance(one, type):
            parts.append(f"## hil.{name}\n\n`{one}`\n".replace("collections.abc.", ""))
            continue
        parts.append(f"## hil.{name}\n\n{described(one)[0]}{based}\n")
        parts += [line if line.startswith(" ") else f"- {line}" for line in members(one)]
        parts.append("")
    parts.append("## Values of a call\n\nA call may give these keys in place of the [axis file](axis_file.md):\n")
    for section, given in SECTIONS.items():
        keys = ", ".join(f"`{key}`" for key in inspect.get_annotations(given))
        parts.append(f"- of `[{section}]` as `**{given.__name__}`: {keys}")
    parts.append("\n## Errors\n\nEach is a `hil.BridgeError`, and also the error in brackets.\n")
    for name, one in errors.items():
        base = one.__bases__[0].__name__
        kind = f" ({base})" if base in errors and base != "BridgeError" else ""
        parts.append(f"- `hil.{name}`{kind}: {in_short(one)}")
    return re.sub(r"\n{3,}", "\n\n", "\n".join(parts)) + "\n"


def members(one: type) -> Iterator[str]:
    """Fields, then the public properties and methods that a class defines itself, in their order."""
    alike = {name for name in ALIKE if any(issubclass(base, names.Result) for base in one.__bases__)}
    own = {name.partition(".")[2] for name in OWN if name.startswith(f"{one.__name__}.")}
    fields = [name for name in inspect.get_annotations(one) if name not in alike | own and not name.startswith("_")]
    parts = [part for part in described(one)[1] if part.split("`")[1] not in own]
    hints = inspect.get_annotations(one)
    typed = {name: f"`{name}: {hints[name]}`".replace("ClassVar[str]", "str") for name in fields}
    for part in parts:
        named, colon, said = part.partition(": ")
        yield re.sub(r"`(\w+)`", lambda found: typed.get(found[1], found[0]), named) + colon + said
    if left := [name for name in fields if not any(f"`{name}`" in part.split(": ")[0] for part in parts)]:
        yield ", ".join(typed[name] for name in left)
    for name, member in vars(one).items():
        if name.startswith("_") or name in fields or name in alike | own:
            continue
        function = member.__func__ if isinstance(member, classmethod) else member
        if inspect.isfunction(function):
            what, named = described(function)
            yield f"`{signature(name, function)}` {what}"
            yield from (f"  - {part}" for part in named)
        elif isinstance(member, property) or hasattr(member, "func"):
            got = member.fget if isinstance(member, property) else member.func
            yield f"`{name}` {described(got)[0]}"


def signature(name: str, function: object) -> str:
    """The call: each argument with its default, else with its type, and the type of the result."""
    found = inspect.signature(function)  # type: ignore[arg-type]
    written = []
    for one in found.parameters.values():
        if one.name in ("self", "cls"):
            continue
        if one.kind is one.VAR_KEYWORD:
            given = re.fullmatch(r"Unpack\[(\w+)\]", str(one.annotation))
            written.append(f"**{given[1]}" if given else f"**{one.name}: {one.annotation}")
        elif one.default is one.empty:
            stars = "*" if one.kind is one.VAR_POSITIONAL else ""
            written.append(f"{stars}{one.name}: {one.annotation}")
        else:
            written.append(f"{one.name}={getattr(one.default, '__name__', repr(one.default))}")
    result = "" if found.return_annotation in ("None", "Any") else f" -> {found.return_annotation}"
    return f"{name}({', '.join(written)}){result}".replace("'", '"')


def in_short(one: object) -> str:
    """The first paragraph of the docstring."""
    return " ".join((inspect.getdoc(one) or "").split("\n\n")[0].split())


def described(one: object) -> tuple[str, list[str]]:
    """What a docstring says, as one paragraph; and of each argument or field that it names: "`name`: …"."""
    names = inspect.get_annotations(one) if isinstance(one, type) else inspect.signature(one).parameters  # type: ignore[arg-type]
    text = " ".join((inspect.getdoc(one) or "").split())
    if not names:
        return text, []
    each = "|".join(names)
    main, *parts = re.split(rf"(?<!,) (?=(?:{each})(?:, (?:{each}))*: )", text)
    if parts and (ends := re.search(r" ((?:Raises|Returns) .*)$", parts[-1])):
        parts[-1], main = parts[-1][: ends.start()], f"{main} {ends[1]}"
    named = (re.sub(r"^([\w, ]+): ", lambda found: f"`{found[1].replace(', ', '`, `')}`: ", part) for part in parts)
    return re.sub(";$", ".", main), [part.rstrip(".;") for part in named]


if __name__ == "__main__":
    PAGE.write_text(text(), encoding="utf-8")
