"""The pages for users as data: their fenced blocks, the commands in them, and a run of a page in a folder of its own.

A block is told by its info string:

    sh              commands; a test runs them, page by page, in one shell and one folder
    sh ci           commands that `.ci/run` runs
    sh hardware     commands for a real machine; a test parses them
    sh parsed       commands that run until they are stopped, or ask on the terminal; a test parses them
    toml NAME       the file NAME of that folder; python NAME alike
    text COMMAND    what COMMAND of this page prints; a line "…" stands for any lines. `python tests/study/docs_output.py` rewrites it

A command that ends with another exit status than 0, or may, says so: "# exit status 1", "# exit status 0 or 1".
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "hil/docs"
PAGES = {path.stem: path for path in sorted(DOCS.glob("*.md"))} | {"README": ROOT / "README.md"}
COMMISSIONING = "commissioning"
CONTINUES = "in the folder of [commissioning](commissioning.md)"
"""A page that says so takes the files of that page for granted."""
ELISION = "…"
PASSWORDS = {"HIL_PASSWORD": "a password for reading", "HIL_KEY_PASSWORD": "a password for the key"}


@dataclass(frozen=True)
class Block:
    """A fenced block: the words after the fence, the lines within, the number of its first line."""

    info: tuple[str, ...]
    text: str
    line: int

    @property
    def commands(self) -> list[str]:
        """The commands of a block of shell lines; a line that ends in a backslash goes on in the next."""
        joined = re.sub(r"\\\n\s*", " ", self.text)
        return [line for line in joined.splitlines() if line.strip() and not line.startswith("#")]


def blocks(text: str) -> Iterator[Block]:
    """The fenced blocks of a page, in order."""
    for match in re.finditer(r"^( *)```([^\n]*)\n(.*?)^\1```$", text, re.MULTILINE | re.DOTALL):
        body = re.sub(rf"^{match[1]}", "", match[3], flags=re.MULTILINE)
        yield Block(tuple(match[2].split()), body, text[: match.start()].count("\n") + 1)


def hil_lines(text: str) -> Iterator[tuple[list[str], int]]:
    """The words of every call of `hil` in the shell blocks of a page, with the number of the block's line."""
    for block in blocks(text):
        if block.info[:1] == ("sh",):
            for command in block.commands:
                yield from ((words[1:], block.line) for words in _calls(command) if words[:1] == ["hil"])


def _calls(command: str) -> Iterator[list[str]]:
    """The single calls of a shell line, without assignments, redirections and what starts another program."""
    lexer = shlex.shlex(command, posix=True, punctuation_chars=True)
    lexer.commenters, lexer.whitespace_split = "#", True
    words: list[str] = []
    for token in [*lexer, ";"]:
        if token in (";", "&&", "||", "|", "&"):
            while words and re.fullmatch(r"\w+=.*|export|sh|hil/bootstrap\.sh", words[0], re.DOTALL):
                del words[0]
            yield words[: words.index(">")] if ">" in words else words
            words = []
        else:
            words.append(token)


def statuses_of(command: str) -> set[int]:
    """The exit statuses that a command may end with."""
    match = re.search(r"# exit status ([\d or]+)", command)
    return {int(one) for one in re.findall(r"\d+", match[1])} if match else {0}


def run_page(page: str, folder: Path) -> dict[str, str]:
    """Run the commands of a page in a folder; what each printed, by command. Raises AssertionError at the first that fails."""
    lay_files(page, folder)
    found = blocks(PAGES[page].read_text(encoding="utf-8"))
    return run_commands([line for block in found if block.info == ("sh",) for line in block.commands], folder, page)


def lay_files(page: str, folder: Path) -> None:
    """Write the files that a page shows into a folder."""
    for block in blocks(PAGES[page].read_text(encoding="utf-8")):
        if block.info[:1] in (("toml",), ("python",)) and len(block.info) > 1:
            (folder / block.info[1]).write_text(block.text, encoding="utf-8")


def run_commands(commands: Sequence[str], folder: Path, page: str) -> dict[str, str]:
    """Run commands one after the other in one shell; raises as `run_page`."""
    script = ["set -u"]
    for number, command in enumerate(commands):
        script.append(f"{{ {command}\n}} >.out.{number} 2>&1 </dev/null; s=$?; echo $s >.status.{number}")
        allowed = " -o ".join(f"$s -eq {status}" for status in sorted(statuses_of(command)))
        script.append(f"[ {allowed} ] || exit 99")
    environment = {name: value for name, value in os.environ.items() if name not in PASSWORDS}
    environment |= {
        "PYTEST_PLUGINS": "hil.testing.plugin"
    }  # as installed, where the environment is of an earlier state
    environment |= {"COLUMNS": "120", "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    if page != COMMISSIONING:  # which sets them itself
        environment |= PASSWORDS
    subprocess.run(["bash", "-c", "\n".join(script)], cwd=folder, env=environment, check=False, timeout=900)
    said: dict[str, str] = {}
    for number, command in enumerate(commands):
        out, ended = folder / f".out.{number}", folder / f".status.{number}"
        assert ended.exists(), f"{page}: {command}: was not reached"
        text = out.read_text(encoding="utf-8").replace(f"{folder.resolve()}/", "").replace(f"{folder}/", "")
        said[command.split(" #")[0].strip()] = text
        status = int(ended.read_text())
        assert status in statuses_of(command), f"{page}: {command}: exit status {status}\n{out.read_text()}"
    for path in folder.glob(".*.[0-9]*"):
        path.unlink()
    return said


def masked(text: str) -> list[str]:
    """Lines without what differs from run to run: trailing blanks, dates, seconds of the computer, hashes, the folder."""
    text = re.sub(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d\+00:00)?", "DATE", text)
    text = re.sub(r"in [\d.]+ s, \d+ times faster", "in SECONDS", text)
    text = re.sub(r"\b[0-9a-f]{64}\b|\b([0-9a-f]{4} ){7}[0-9a-f]{4}\b", "HASH", text)
    text = re.sub(r"(?<![\w/])/[\w/.-]*/(?=[\w.-])", "", text)
    text = re.sub(r" {2,}", "  ", text)
    return [line.rstrip() for line in text.splitlines() if line.strip()]


def holds(shown: str, said: str) -> bool:
    """Whether the output said is what a page shows, "…" standing for any lines."""
    wanted = ["(.*\n)*" if line.strip() == ELISION else re.escape(line) + "\n" for line in masked(shown)]
    return re.fullmatch("".join(wanted), "".join(line + "\n" for line in masked(said))) is not None


def outputs(text: str) -> Iterator[tuple[str, Block]]:
    """The blocks of a page that show output, each with its command."""
    for block in blocks(text):
        if block.info[:1] == ("text",) and len(block.info) > 1:
            yield " ".join(block.info[1:]), block


def page_output(page: str, folder: Path, prepared: Callable[[], tuple[Path, dict[str, str]]]) -> dict[str, str]:
    """What the commands of a page print, and those whose output it shows, run in a folder.

    prepared: gives a folder in which the commands of the page "commissioning" were run, and what they printed; it is copied for that
    page and for one that continues there.
    """
    text = PAGES[page].read_text(encoding="utf-8")
    printed: dict[str, str] = {}
    if page == COMMISSIONING or CONTINUES in " ".join(text.split()):
        before, printed = prepared()
        shutil.copytree(before, folder, dirs_exist_ok=True)
    said = dict(printed) if page == COMMISSIONING else run_page(page, folder)
    for command, _ in outputs(text):
        if command not in said:
            said[command] = run_commands([command], folder, page)[command]
    return said


def rewritten(text: str, said: Mapping[str, str]) -> str:
    """A page with the outputs as they are; where a block leaves lines out ("…"), as many stay before and after them as there are."""
    for command, block in outputs(text):
        lines = [line.rstrip() for line in said[command].splitlines()]
        while lines and not lines[0]:
            del lines[0]
        while lines and not lines[-1]:
            del lines[-1]
        shown = block.text.splitlines()
        if ELISION in shown:
            before, after = shown.index(ELISION), len(shown) - shown.index(ELISION) - 1
            lines = [*lines[:before], ELISION, *lines[len(lines) - after :]]
        fence = f"```text {command}\n"
        text = text.replace(f"{fence}{block.text}```", "\n".join([fence.strip(), *lines, "```"]))
    return text
