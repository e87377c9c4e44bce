"""Every function of the product is reached by a verb, a page, a script of `hil/examples` or a public name of `hil`.

By names: a function is reached where code that is reached says its name, a method where its class is reached as well. What only tests
call is found so; a function that shares its name with another may be missed. `python tests/unit/test_reached.py` prints the list.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PRODUCT = ("drivers", "sim_backends", "hil")
ENTRY = {"run", "add_parser"}
"""What the installed command and the list of verbs call."""
OURS = {
    "object",
    "ABC",
    "Protocol",
    "Generic",
    "NamedTuple",
    "Enum",
    "IntEnum",
    "StrEnum",
    "IntFlag",
    "Exception",
    "KeyboardInterrupt",
}
"""Bases that call no other method of a subclass than those with two underscores."""
EXCEPTIONS = {
    "drivers.toml_schema.keys_of": "tests/study/axis_reference.py writes a page with it",
    "hil.__getattr__": "Python calls it",
    "hil.diagnosis.__getattr__": "Python calls it",
    "hil.effects.non_parametric.fine_form": "models of earlier versions hold such terms, which tests make with it",
    "hil.testing.plugin.pytest_addoption": "pytest calls it",
}
"""Function -> why it stays although nothing reaches it."""

NAMED = re.compile(r"(?:[\w.]+:)?([^\W\d]\w*)")
"""A name as text: of getattr, in tables of names, and with its module, as what a process of its own calls."""


@dataclass(eq=False)
class Part:
    """A function, or a class with what stands in it beside its methods; without a name, what stands in a module."""

    where: str
    name: str = ""
    owner: Part | None = None
    says: set[str] = field(default_factory=set)
    bases: set[str] = field(default_factory=set)
    reached: bool = False


def said(nodes: Iterable[ast.AST | None]) -> set[str]:
    """Names in code. An import and a list of public names call nothing."""
    names: set[str] = set()
    for node in nodes:
        match node:
            case None | ast.Import() | ast.ImportFrom() | ast.Assign(targets=[ast.Name(id="__all__")]):
                continue
            case ast.Name(id=name) | ast.Attribute(attr=name):
                names.add(name)
            case ast.Constant(value=str(text)) if named := NAMED.fullmatch(text):
                names.add(named[1])
        names |= said(ast.iter_child_nodes(node))
    return names


def parts_of(body: list[ast.stmt], owner: Part) -> Iterator[Part]:
    """The functions and classes of a module or class, with their own; adds to `owner` what stands beside them."""
    for node in body:
        where = f"{owner.where}.{getattr(node, 'name', '')}"
        match node:
            case ast.ClassDef():
                part = Part(where, node.name, owner, said([*node.keywords, *node.decorator_list]), said(node.bases))
                yield part
                yield from parts_of(node.body, part)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                yield Part(where, node.name, owner, said([node]))
            case ast.If() if not owner.name:
                yield from parts_of([*node.body, *node.orelse], owner)
            case _:
                owner.says |= said([node])


def product(root: Path) -> Iterator[Part]:
    """The modules of the product and their parts."""
    for path in sorted(path for package in PRODUCT for path in (root / package).rglob("*.py")):
        module = Part(".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"), reached=True)
        yield module
        yield from parts_of(ast.parse(path.read_text()).body, module)


def public_names(root: Path) -> set[str]:
    """What scripts call: the names of `hil`."""
    imports = [
        node for node in ast.parse((root / "hil/script/names.py").read_text()).body if isinstance(node, ast.ImportFrom)
    ]
    return {alias.name for node in imports for alias in node.names}


def unreached(root: Path) -> list[str]:
    """Functions that nothing reaches, by their full names."""
    parts, public = list(product(root)), public_names(root)
    ours = OURS | {part.name for part in parts}
    while foreign := {part.name for part in parts if part.bases - ours} & ours:
        ours -= foreign
    names = ENTRY | public
    for page in (root / "hil/docs").glob("*.md"):
        for block in re.findall(r"^```py.*?\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
            names |= set(re.findall(r"\w+", block))
    for part in parts:
        if part.reached:
            names |= part.says

    def called(part: Part) -> bool:
        owner = part.owner
        if owner is None or not owner.reached:
            return False
        by_itself = part.name.startswith("__") or bool(owner.bases - ours) or owner.name in public
        return part.name in names or (bool(owner.name) and by_itself)

    while found := [part for part in parts if not part.reached and called(part)]:
        for part in found:
            part.reached = True
            names |= part.says | part.bases
    return [part.where for part in parts if not part.reached]


def test_every_package_is_shipped() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    there = {path.parent.relative_to(ROOT) for package in PRODUCT for path in (ROOT / package).rglob("*.py")}
    assert sorted(listed) == sorted(".".join(folder.parts) for folder in there)


@pytest.mark.outside  # reads every module
def test_nothing_is_there_for_tests_alone() -> None:
    assert sorted(unreached(ROOT)) == sorted(EXCEPTIONS)


if __name__ == "__main__":
    print(*unreached(ROOT), sep="\n")
