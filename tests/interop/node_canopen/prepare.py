"""Install the foreign CANopen stack into the user's cache and print where: `python tests/interop/node_canopen/prepare.py`.

What is installed is fixed by package-lock.json; the place carries its digest and node's version and is renamed into being when it is
whole. Fails with one line on stderr where node or the network is missing. In the guest only what is there already counts.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
MANIFEST = ("package.json", "package-lock.json")
LIMIT_S = 300.0


class PrepareError(Exception):
    """It cannot be had; the message is one line."""


def prepare() -> Path:
    """The directory that holds node_modules. Raises PrepareError."""
    for tool in ("node", "npm"):
        if shutil.which(tool) is None:
            raise PrepareError(f"{tool} is not installed (Debian: nodejs npm make g++)")
    node = subprocess.run(["node", "--version"], capture_output=True, text=True, check=True).stdout.strip()
    digest = hashlib.sha256(b"".join((HERE / name).read_bytes() for name in MANIFEST)).hexdigest()[:12]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hil-foreign-canopen"
    place = cache / f"node-{node}-{digest}"
    if place.is_dir():
        return place
    if os.environ.get("HIL_VCAN") == "guest":
        raise PrepareError("the foreign CANopen stack was not installed before the guest was started")
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="installing-", dir=cache, ignore_cleanup_errors=True) as scratch:
        whole = Path(scratch) / "whole"
        whole.mkdir()
        for name in MANIFEST:
            shutil.copy(HERE / name, whole)
        _install(whole)
        try:
            whole.rename(place)
        except OSError:
            if not place.is_dir():  # otherwise somebody else was faster
                raise
    return place


def _install(where: Path) -> None:
    environment = dict(os.environ)
    if Path("/usr/include/node/node.h").exists():  # Debian's headers instead of a download
        environment["npm_config_nodedir"] = "/usr"
    command = ["npm", "ci", "--no-fund", "--no-audit", "--loglevel=error"]
    try:
        subprocess.run(command, cwd=where, env=environment, capture_output=True, text=True, check=True, timeout=LIMIT_S)
    except subprocess.TimeoutExpired as error:
        raise PrepareError(f"npm ci: not done within {LIMIT_S:g} s") from error
    except subprocess.CalledProcessError as error:
        said = [line for line in error.stderr.splitlines() if "gyp ERR! stack" in line or "npm ERR! code" in line]
        raise PrepareError(f"npm ci: {(said or error.stderr.strip().splitlines() or ['failed'])[0]}") from error


if __name__ == "__main__":
    try:
        print(prepare())
    except PrepareError as error:
        sys.exit(f"foreign CANopen stack: {error}")
