"""`hil help`: the pages of hil/docs on the terminal."""

from __future__ import annotations

import argparse
import difflib
import sys
from importlib.resources import files
from importlib.resources.abc import Traversable

from drivers.errors import InputError
from hil.ui.terminal.options import Subparsers, verb_parser

EXAMPLE = """\
example:
  hil help                    every topic
  hil help commissioning      one page
  hil help axis-file | less   the page as text, for a pager or a file
"""


def add_parser(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers, "help", "Show a page of the documentation. Without a topic: list the topics.", EXAMPLE
    )
    parser.add_argument("topic", metavar="TOPIC", nargs="?", help="a topic of the list")
    parser.add_argument("--json", metavar="FILE", help="also write the topics, or the page, as JSON to FILE")
    parser.set_defaults(run=run)


def pages() -> dict[str, Traversable]:
    """The pages by topic, in alphabetical order. A topic is the name of the file, with hyphens."""
    found = {
        page.name.removesuffix(".md").replace("_", "-"): page
        for page in files("hil").joinpath("docs").iterdir()
        if page.name.endswith(".md")
    }
    return dict(sorted(found.items()))


def title(page: Traversable) -> str:
    with page.open(encoding="utf-8") as lines:
        return next(lines).removeprefix("# ").strip()


def run(args: argparse.Namespace) -> int:
    """Exit status 0. Raises InputError for a topic that there is not."""
    topics = pages()
    if args.topic is None:
        titles = {topic: title(page) for topic, page in topics.items()}
        width = max(map(len, titles))
        print("hil help TOPIC shows one of these pages; hil VERB --help shows the options of a verb.\n")
        for topic, text in titles.items():
            print(f"  {topic:{width}}  {text}")
        _save(args, titles)
        return 0
    name = args.topic.lower().removesuffix(".md").replace("_", "-")
    if name not in topics:
        raise InputError(_unknown(args.topic, name, list(topics)))
    text = topics[name].read_text(encoding="utf-8")
    if sys.stdout.isatty():
        from rich.console import Console  # noqa: PLC0415  (not needed where the page is text)
        from rich.markdown import Markdown  # noqa: PLC0415

        Console().print(Markdown(text, hyperlinks=False))  # a link as its words and (page.md)
    else:
        print(text, end="")
    _save(args, {"topic": name, "markdown": text})
    return 0


def _unknown(given: str, name: str, topics: list[str]) -> str:
    from hil.app.main import VERBS  # noqa: PLC0415  (main imports this module by name)

    if given in VERBS:
        return f"there is no page {given!r}: for the options of the verb see hil {given} --help"
    near = difflib.get_close_matches(name, topics, 1)
    return f"there is no page {given!r}, " + (f"the nearest is {near[0]}" if near else "hil help lists the topics")


def _save(args: argparse.Namespace, result: dict[str, str]) -> None:
    if args.json:
        from hil.ui.terminal.output import write_json  # noqa: PLC0415  (loads rich)

        write_json(args.json, result)
