"""The pages for users: their commands are known to the program, their links lead somewhere, each is a topic of `hil help`."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import tomllib
from pathlib import Path

import pytest
from study import axis_reference
from support.docs import PAGES, ROOT, blocks, hil_lines, lay_files

from hil.app.help import pages
from hil.app.main import VERBS, build_parser, main
from hil.axis.axis_file import load_drive_axis

KINDS = {"sh", "text", "toml", "python", ""}
MARKS = {"", "ci", "hardware", "parsed"}


def text_of(page: str) -> str:
    return PAGES[page].read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_every_command_is_one_that_the_program_understands(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay_files(page, tmp_path)  # a procedure's parameters are options
    monkeypatch.chdir(tmp_path)
    for block in blocks(text_of(page)):
        assert (block.info[:1] or ("",))[0] in KINDS, f"{page}:{block.line}"
        if block.info[:1] == ("sh",):
            assert " ".join(block.info[1:]) in MARKS, f"{page}:{block.line}"
    for words, line in hil_lines(text_of(page)):
        where = f"{page}, block at line {line}: hil {shlex.join(words)}"
        assert words[0] in VERBS, where
        parsed(words, where)


def parsed(words: list[str], where: str) -> None:
    try:
        build_parser(words).parse_args(words)
    except SystemExit as end:
        if end.code:
            raise AssertionError(where) from end


@pytest.mark.parametrize("page", PAGES)
def test_a_verb_or_an_option_named_in_a_sentence_exists(page: str) -> None:
    for code in re.findall(r"`hil ([a-z][^`]*)`", text_of(page)):
        words = code.replace("\\|", "|").split()
        assert words[0] in VERBS, f"{page}: hil {code}"
        options = re.findall(r"(?<!\S)--[a-z-]+", code)
        job = words[:2] if re.fullmatch(r"[a-z]+", " ".join(words[1:2])) else words[:1]
        known = _options(build_parser(words[:1]), words) | set(re.findall(r"--[a-z0-9-]+", _help(job)))
        assert set(options) - {"--help"} <= known, f"{page}: hil {code}"


def _help(words: list[str]) -> str:
    """What `hil VERB --help` prints, or `hil VERB JOB --help`."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        build_parser(words).parse_args([*words, "--help"])
    return text.getvalue()


def _options(parser: object, words: list[str]) -> set[str]:
    """Every option of the verb, its jobs' included."""
    found: set[str] = set()
    for action in getattr(parser, "_actions", ()):
        found |= set(action.option_strings)
        for name, under in (getattr(action, "choices", None) or {}).items() if isinstance(action.choices, dict) else ():
            if name == words[0] or name not in VERBS:
                found |= _options(under, words)
    return found


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_to_a_file(page: str) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", re.sub(r"```.*?```|`[^`\n]*`", "", text_of(page), flags=re.DOTALL)):
        if not target.startswith("http"):
            assert (PAGES[page].parent / target).exists(), f"{page}: {target}"


def test_every_page_is_a_topic_and_is_found_from_the_readme(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help"]) == 0
    listed = set(re.findall(r"^  ([a-z0-9-]+) ", capsys.readouterr().out, re.MULTILINE))
    assert listed == {name.replace("_", "-") for name in PAGES if name != "README"}
    seen, left = set(), ["README"]
    while left:
        page = left.pop()
        seen.add(page)
        linked = {Path(target).stem for target in re.findall(r"\]\(([\w/]*\w+\.md)\)", text_of(page))}
        left += [name for name in linked & set(PAGES) if name not in seen]
    assert seen == set(PAGES)


def test_a_page_is_shown_as_it_stands_and_an_unknown_one_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "axis_file"]) == 0
    assert capsys.readouterr().out == text_of("axis_file")
    assert main(["help", "comissioning"]) == 2
    assert capsys.readouterr().err.endswith("the nearest is commissioning\n")
    assert main(["help", "verify"]) == 2
    assert "hil verify --help" in capsys.readouterr().err
    assert main(["help", "verbs", "--json", "/nowhere/x.json"]) == 2


def test_the_pages_are_part_of_the_package() -> None:
    assert {page.name for page in pages().values()} == {path.name for path in (ROOT / "hil/docs").glob("*.md")}


def test_the_reference_of_the_axis_file_is_that_of_the_schema() -> None:
    assert text_of("axis_file") == axis_reference.page(), "python tests/study/axis_reference.py --write"


def test_the_axis_files_that_the_pages_show_are_read(tmp_path: Path) -> None:
    for page in PAGES:
        for block in blocks(text_of(page)):
            if block.info[:1] == ("toml",) and len(block.info) > 1 and block.text.startswith("[axis]"):
                path = tmp_path / block.info[1]
                path.write_text(block.text, encoding="utf-8")
                load_drive_axis(path)


def test_the_commands_that_prove_a_figure_exist() -> None:
    text = text_of("proven") + text_of("diagnosis_lots") + text_of("diagnosis") + text_of("house") + text_of("faults")
    scripts = re.findall(r"`python (tests/study/[\w/]+(?:\.py)?)[^`]*`", text)
    tests = re.findall(r"`pytest [^`]*?(tests/[\w/]+\.py)[^`]*`", text)
    modules = re.findall(r"python -m (study\.\w+)", text)
    assert len(scripts) > 10
    assert len(tests) > 10
    for name in [*scripts, *tests, *(f"tests/{module.replace('.', '/')}.py" for module in modules)]:
        assert (ROOT / name).exists(), name


def test_every_row_of_what_is_proven_has_its_command() -> None:
    rows = [line.split("|")[1:-1] for line in text_of("proven").splitlines() if line.startswith("| ")]
    for what, figure, command in (row for row in rows if row[0].strip() != "What"):
        assert "`" in command or "](" in command or command == " the same ", what
        assert figure.strip(), what


def test_the_procedure_of_the_page_on_scripts_is_the_example() -> None:
    shown = next(block for block in blocks(text_of("scripts")) if block.info == ("python", "creep.py"))
    assert (ROOT / "hil/examples/creep.py").read_text(encoding="utf-8").endswith(shown.text)


def test_the_map_of_the_house_is_the_contract() -> None:
    """Rooms in the order of the layers; those of one layer in any order."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (rooms,) = (one for one in contracts if one["type"] == "layers")
    assert "ignore_imports" not in rooms
    plan = text_of("house").split("```")[1]
    drawn = re.findall(r"^  (\w+)/|  (\w+)/  ", plan, re.MULTILINE)
    found = iter("".join(one) for one in drawn)
    for layer in rooms["layers"]:
        names = layer.split(" | ")
        assert sorted(next(found) for _ in names) == sorted(names)
    assert not list(found)
