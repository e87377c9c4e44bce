"""Kernel and initramfs of the vcan guest, made from Debian's packages without installing any of them.

Two kernels can be the guest's: user-mode Linux, a process of this host that computes as fast as the host does (Debian has it), and the
distribution's own kernel in an emulator, ten times slower. `image()` returns one of them from the cache and builds it on first use. A
build takes place in a directory of its own and is renamed into place when it is whole: the cache holds complete images or none.
The name of an image carries the kernel's release and a digest of this recipe: a changed recipe is never served from an old build.
"""

from __future__ import annotations

import hashlib
import lzma
import os
import re
import shutil
import stat
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
MODULES = ("overlay", "can_raw", "can_bcm", "vcan")
STALE_S = 24 * 3600.0
DOWNLOAD_LIMIT_S = 600.0


class ImageError(Exception):
    """The guest cannot be made here; the message is one line that says what to do."""


@dataclass(frozen=True)
class Kind:
    """A kernel that can be the guest's.

    packages: that hold it, the first that there is; kernel, modules: where they are unpacked to, modules for each release; transport:
    further modules; mounts: how the guest sees the host's files and the job's directory.
    """

    name: str
    packages: tuple[str, ...]
    kernel: str
    modules: tuple[str, ...]
    transport: tuple[str, ...]
    mounts: tuple[str, str]


PLAN9 = "-t 9p -o trans=virtio,version=9p2000.L,msize=512000"
USER_MODE = Kind(
    "uml",
    ("user-mode-linux",),
    "usr/bin/linux.uml",
    ("usr/lib/uml/modules",),
    (),
    ("-t hostfs -o ro,/", '-t hostfs -o "$hil_job"'),
)
EMULATED = Kind(
    "linux",
    ("linux-image-amd64", "linux-image-generic"),  # Debian's and Ubuntu's name for "the newest"
    "boot/vmlinuz-*",
    ("lib/modules", "usr/lib/modules"),
    ("virtio_pci", "9pnet_virtio", "9p"),
    (f"{PLAN9},ro,cache=loose", f"{PLAN9},cache=none"),
)


@dataclass(frozen=True)
class Image:
    """What a guest is started with."""

    kernel: Path
    initramfs: Path


def recipe() -> str:
    """Digest of all that decides what an image holds, besides the packages."""
    return hashlib.sha256((HERE / "guest_image.py").read_bytes() + (HERE / "init.sh").read_bytes()).hexdigest()[:12]


def image(cache: Path, kind: Kind) -> Image:
    """The image in `cache`, built if it is not there. Raises ImageError."""
    try:
        cache.mkdir(parents=True, exist_ok=True)
        built = sorted(cache.glob(f"{kind.name}-*-{recipe()}"), key=lambda path: path.stat().st_mtime)
        place = built[-1] if built else _build(cache, kind)
    except OSError as error:
        raise ImageError(f"cannot use the cache {cache}: {error}") from error
    return Image(place / "kernel", place / "initramfs")


def _build(cache: Path, kind: Kind) -> Path:
    _sweep(cache)
    with tempfile.TemporaryDirectory(prefix="building-", dir=cache, ignore_cleanup_errors=True) as scratch:
        unpacked = _packages(Path(scratch), kind)
        kernels = sorted(unpacked.glob(kind.kernel))
        modules = sorted(path for directory in kind.modules for path in unpacked.glob(f"{directory}/*"))
        if not kernels or not modules:
            raise ImageError(f"the kernel's packages hold no {kind.kernel} or no modules")
        whole = Path(scratch) / "whole"
        whole.mkdir()
        shutil.copy(kernels[-1], whole / "kernel")
        (whole / "initramfs").write_bytes(_initramfs(unpacked, modules[-1], kind))
        place = cache / f"{kind.name}-{modules[-1].name}-{recipe()}"
        try:
            whole.rename(place)
        except OSError:
            if not place.is_dir():  # otherwise somebody else was faster, with the same
                raise
    return place


def _sweep(cache: Path) -> None:
    """Remove other recipes' images and what killed builds left, once they are a day old."""
    for path in [path for name in ("building", USER_MODE.name, EMULATED.name) for path in cache.glob(f"{name}-*")]:
        if not path.name.endswith(recipe()) and time.time() - path.stat().st_mtime > STALE_S:
            shutil.rmtree(path, ignore_errors=True)


# -- packages ---------------------------------------------------------------------------------------------------------


def _packages(scratch: Path, kind: Kind) -> Path:
    """Download kernel, modules and busybox and unpack them; the directory they were unpacked to."""
    for tool in ("apt-get", "apt-cache", "dpkg-deb"):
        if shutil.which(tool) is None:
            raise ImageError(f"{tool} is not here: the guest is made from Debian's packages")
    options: list[str] = ["-o", "APT::Sandbox::User=root"] if os.geteuid() == 0 else []
    try:
        debs = _download(scratch, kind, options)
    except ImageError:  # no package lists, or outdated ones: fetch them, for us alone
        lists = scratch / "lists"
        (lists / "partial").mkdir(parents=True)
        options += ["-o", f"Dir::State::lists={lists}", "-o", "Dir::Cache::pkgcache=", "-o", "Dir::Cache::srcpkgcache="]
        _run("apt-get", *options, "-o", "Debug::NoLocking=1", "update", cwd=scratch)
        debs = _download(scratch, kind, options)
    unpacked = scratch / "unpacked"
    for deb in debs:
        _run("dpkg-deb", "-x", str(deb), str(unpacked), cwd=scratch)
    return unpacked


def _download(scratch: Path, kind: Kind, options: list[str]) -> list[Path]:
    found = [name for name in kind.packages if _apt_cache("show", name, options, scratch)]
    if not found:
        raise ImageError(f"apt-get knows none of {', '.join(kind.packages)}; is there a Debian archive in its sources?")
    names, todo = ["busybox-static", found[0]], [found[0]]
    while todo:  # meta package -> image -> modules, where a distribution ships them apart
        said = _apt_cache("depends", todo.pop(), options, scratch)
        needed = re.findall(r"^\s*Depends: (linux-(?:image|modules|modules-extra)-\S+)$", said, re.MULTILINE)
        new = [name for name in needed if name not in names]
        names += new
        todo += new
    _run("apt-get", *options, "download", *names, cwd=scratch)
    return list(scratch.glob("*.deb"))


def _apt_cache(verb: str, package: str, options: list[str], cwd: Path) -> str:
    """What apt-cache says of a package, "" for one that it does not know."""
    return subprocess.run(
        ["apt-cache", *options, verb, package], cwd=cwd, capture_output=True, text=True, check=False
    ).stdout


def _run(*command: str, cwd: Path) -> None:
    try:
        subprocess.run(command, cwd=cwd, check=True, capture_output=True, text=True, timeout=DOWNLOAD_LIMIT_S)
    except subprocess.TimeoutExpired as error:
        raise ImageError(f"{' '.join(command)}: not done within {DOWNLOAD_LIMIT_S:g} s") from error
    except subprocess.CalledProcessError as error:
        said = error.stderr.strip().splitlines()[-1:] or [f"status {error.returncode}"]
        raise ImageError(f"{' '.join(command)}: {said[0]}") from error


# -- initramfs --------------------------------------------------------------------------------------------------------


def _initramfs(unpacked: Path, directory: Path, kind: Kind) -> bytes:
    candidates = [path for path in (unpacked / "bin/busybox", unpacked / "usr/bin/busybox") if path.exists()]
    if not candidates:
        raise ImageError("busybox-static holds no busybox")
    modules = _modules(directory, kind.transport + MODULES)
    init = (HERE / "init.sh").read_text()
    for word, text in zip(("@LOAD@", "@HOST@", "@JOB@"), (" ".join(modules), *kind.mounts), strict=True):
        init = init.replace(word, text)
    executable, plain = 0o755, 0o644
    files = {
        "bin/busybox": (executable, candidates[0].read_bytes()),
        "init": (executable, init.encode()),
        **{f"modules/{name}.ko": (plain, data) for name, data in modules.items()},
    }
    directories = ("bin", "dev", "host", "layer", "modules", "proc", "root", "sys")
    entries = [_cpio(name, stat.S_IFDIR | 0o755) for name in directories]
    entries.append(_cpio("dev/console", stat.S_IFCHR | 0o600, device=(5, 1)))
    entries += [_cpio(name, stat.S_IFREG | mode, data) for name, (mode, data) in files.items()]
    entries.append(_cpio("TRAILER!!!", 0))
    return b"".join(entries)


def _modules(directory: Path, names: tuple[str, ...]) -> dict[str, bytes]:
    """Name and contents of modules and of what they depend on, each after its dependencies."""
    there = {re.sub(r"\.ko.*", "", path.name).replace("-", "_"): path for path in directory.rglob("*.ko*")}
    builtin_list = directory / "modules.builtin"
    builtin = {Path(line).stem.replace("-", "_") for line in builtin_list.read_text().splitlines()}
    loaded: dict[str, bytes] = {}

    def load(name: str) -> None:
        if name in loaded or name in builtin:
            return
        if name not in there:
            raise ImageError(f"the kernel has no module {name} ({directory.name})")
        data = _decompressed(there[name])
        for needed in _dependencies(data):
            load(needed)
        loaded[name] = data

    for name in names:
        load(name)
    return loaded


def _decompressed(path: Path) -> bytes:
    if path.suffix == ".xz":
        return lzma.decompress(path.read_bytes())
    if path.suffix == ".zst":
        if shutil.which("zstd") is None:
            raise ImageError(f"{path.name} needs the command zstd; please run: apt-get install zstd")
        return subprocess.run(["zstd", "-dc", str(path)], check=True, capture_output=True).stdout
    return path.read_bytes()


def _dependencies(module: bytes) -> Iterator[str]:
    """The `depends=` entry of the .modinfo section, whose strings end in NUL."""
    match = re.search(rb"\0depends=([^\0]*)\0", module)
    for name in match.group(1).decode().split(",") if match else ():
        if name:
            yield name.replace("-", "_")


def _cpio(name: str, mode: int, data: bytes = b"", device: tuple[int, int] = (0, 0)) -> bytes:
    """One entry of a cpio archive in the "newc" format (kernel, Documentation: initramfs buffer format)."""
    fields = (0, mode, 0, 0, 1, 0, len(data), 0, 0, *device, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields) + name.encode() + b"\0"
    return head + bytes(-len(head) % 4) + data + bytes(-len(data) % 4)
