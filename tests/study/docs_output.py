"""The pages' commands, run; their output put into the pages: `python tests/study/docs_output.py [PAGE …] [--write]`.

Without --write the differences are listed, and the exit status is 1 where there is one. Blocks are marked as `support.docs` says.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path

if __name__ == "__main__":  # the folder of a script is first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from support.docs import COMMISSIONING, PAGES, holds, outputs, page_output, rewritten, run_page


def main(names: list[str], *, write: bool) -> int:
    """Run the pages that show output, or the named ones; the exit status."""
    status = 0
    commissioned = Path(tempfile.mkdtemp())

    @cache
    def prepared() -> tuple[Path, dict[str, str]]:
        return commissioned, run_page(COMMISSIONING, commissioned)

    for name in names or [name for name, path in PAGES.items() if list(outputs(path.read_text(encoding="utf-8")))]:
        path = PAGES[name]
        text = path.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            said = page_output(name, Path(folder), prepared)
        for command, block in outputs(text):
            if not holds(block.text, said[command]):
                status = 1
                print(f"{path}:{block.line}: {command} prints something else")
        if write:
            path.write_text(rewritten(text, said), encoding="utf-8")
    shutil.rmtree(commissioned)
    return 0 if write else status


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0].split(":")[0])
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="names (default: all that show output)")
    parser.add_argument("--write", action="store_true", help="put the output into the pages")
    given = parser.parse_args()
    if unknown := set(given.pages) - PAGES.keys():
        parser.error(f"no page {unknown.pop()!r}, expected one of {', '.join(PAGES)}")
    sys.exit(main(given.pages, write=given.write))
