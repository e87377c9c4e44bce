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

Written by `python tests/study/api_page.py`. How they are used: [scripts](scripts.md).
"""


def text() -> str:
    """The page."""
    objects = {name: getattr(names, name) for name in names.__all__}
    functions = {name: one for name, one in objects.items() if inspect.isfunction(one)}
    errors = {name: one for name, one in objects.items() if isinstance(one, type) and issubclass(one, Exception)}
    classes = {name: one for name, one in objects.items() if name not in functions and name not in errors}
    parts = [HEAD]
    for name, function in functions.items():
        parts.append(f"## hil.{name}\n\n```text\n{signature(name, function)}\n```\n\n{described(function)}\n")
    for name, one in classes.items():
        parts.append(f"## hil.{name}\n\n{described(one)}\n")
        parts += [f"- {line}" for line in members(one)]
        parts.append("")
    parts.append("## Values of a call\n")
    for given in (values.Measuring, values.Reversing, values.Winding):
        keys = ", ".join(f"`{key}`" for key in inspect.get_annotations(given))
        parts.append(f"- `{given.__name__}`: {described(given)} {keys}")
    parts.append("\n## Errors\n")
    parts += [f"- `hil.{name}` ({one.__bases__[0].__name__}): {described(one)}" for name, one in errors.items()]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(parts)) + "\n"


def members(one: type) -> Iterator[str]:
    """The public fields, properties and methods that a class defines itself, in their order."""
    for name, kind in inspect.get_annotations(one).items():
        if not name.startswith("_"):
            yield f"`{name}: {kind}`"
    for name, member in vars(one).items():
        if name.startswith("_") or name in inspect.get_annotations(one):
            continue
        function = member.__func__ if isinstance(member, classmethod) else member
        if inspect.isfunction(function):
            yield f"`{signature(name, function)}` {described(function)}"
        elif isinstance(member, property) or hasattr(member, "func"):
            got = member.fget if isinstance(member, property) else member.func
            yield f"`{name}: {inspect.signature(got).return_annotation}` {described(got)}"


def signature(name: str, function: object) -> str:
    """Name, arguments and result as they are written."""
    found = inspect.signature(function)  # type: ignore[arg-type]
    own = [one for one in found.parameters.values() if one.name not in ("self", "cls")]
    written = f"{name}{found.replace(parameters=own)}".replace("'", "")
    return re.sub(r"<function (\w+) at \w+>", r"\1", written)


def described(one: object) -> str:
    """The docstring as one paragraph."""
    return " ".join((inspect.getdoc(one) or "").split())


if __name__ == "__main__":
    PAGE.write_text(text(), encoding="utf-8")
