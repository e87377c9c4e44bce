#!/bin/sh
# From a fresh clone to a running command, in one line and again in no time:
#
#     sh hil/bootstrap.sh hil demo
#     sh hil/bootstrap.sh pytest
#
# Makes .venv beside this directory with a Python >= 3.11 and installs the project into it (editable; for `pytest` and the
# other tools with the [test] extra, and with the Debian packages that the vcan guest and the foreign parts of the tests
# need), then becomes the command. Installs only when pyproject.toml has changed, so the second run needs no network.
# HIL_NO_APT=1 leaves the system's packages alone. Only what runs before there is a Python belongs in here.
set -eu

root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
venv=$root/.venv
unfinished=$venv/.hil-unfinished

say() { printf 'bootstrap: %s\n' "$*" >&2; }
die() { say "$@"; exit 2; }

if [ $# -eq 0 ]; then
    echo "usage: sh hil/bootstrap.sh COMMAND [ARGUMENT...]      e.g. hil demo | pytest | ruff check" >&2
    exit 2
fi
case $1 in
    hil) level=run extra= compile=--compile ;;
    *) level=test extra='[test]' compile=--no-compile ;; # of what the tools bring most is never imported
esac
# a moved clone counts as changed: a venv holds absolute paths
key="$(cksum <"$root/pyproject.toml") $root"

# -- system packages -----------------------------------------------------------------------------------------------------
as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        env DEBIAN_FRONTEND=noninteractive "$@"
    elif [ -t 0 ] && [ -t 2 ]; then
        sudo env DEBIAN_FRONTEND=noninteractive "$@"
    else
        sudo -n env DEBIAN_FRONTEND=noninteractive "$@"
    fi
}

apt_install() { # apt_install WHY PACKAGE...: false, having said what to install, when it cannot be done
    why=$1
    shift
    if [ -n "${HIL_NO_APT:-}" ]; then
        say "$why: not installed because HIL_NO_APT is set: $*"
        return 1
    fi
    if ! command -v apt-get >/dev/null || { [ "$(id -u)" -ne 0 ] && ! command -v sudo >/dev/null; }; then
        say "$why: please install these packages (or what your system calls them): $*"
        return 1
    fi
    say "$why: apt-get install $*"
    if as_root apt-get -qq -o DPkg::Lock::Timeout=600 update >/dev/null &&
        as_root apt-get -qq -o DPkg::Lock::Timeout=600 -o Dpkg::Use-Pty=0 \
            install -y --no-install-recommends "$@" >/dev/null; then
        return 0
    fi
    say "$why: that failed; please run: sudo apt-get install $*"
    return 1
}

test_packages() { # installs what the tests use besides Python; without it they say what they lack
    missing=
    for pair in \
        qemu-system-x86_64=qemu-system-x86 zstd=zstd candump=can-utils mbpoll=mbpoll cc=gcc \
        /usr/include/stdio.h=libc6-dev /usr/include/modbus/modbus.h=libmodbus-dev; do
        command -v "${pair%%=*}" >/dev/null || [ -f "${pair%%=*}" ] || missing="$missing ${pair#*=}"
    done
    for pair in libpangoft2-1.0.so.0=libpangoft2-1.0-0 libharfbuzz-subset.so.0=libharfbuzz-subset0; do # of WeasyPrint
        set -- /usr/lib/*/"${pair%%=*}"
        [ -e "$1" ] || missing="$missing ${pair#*=}"
    done
    # shellcheck disable=SC2086 # a list of words
    [ -z "$missing" ] || apt_install 'for the tests' $missing ||
        say "going on without; tests that need them will say so"
}

# -- the virtual environment ---------------------------------------------------------------------------------------------
is_python() { # is_python PYTHON [MODULE...]: new enough, and has the modules
    candidate=$1
    shift
    command -v "$candidate" >/dev/null && "$candidate" - "$@" 2>/dev/null <<'PYTHON'
import importlib, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
sys.exit(sys.version_info < (3, 11))
PYTHON
}

find_python() { # find_python [MODULE...]: sets $python
    for python in python3 python3.14 python3.13 python3.12 python3.11; do
        is_python "$python" "$@" && return 0
    done
    python=
    return 1
}

choose_python() {
    find_python venv ensurepip && return 0
    if find_python; then
        suffix=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
        apt_install 'to make a virtual environment' "python$suffix-venv" ||
            die "Python $suffix is here but cannot make a virtual environment"
    else
        apt_install 'no Python >= 3.11 found' python3 python3-venv || die 'Python >= 3.11 is needed'
        find_python || apt_install 'python3 is older than 3.11' python3.11 python3.11-venv || true
    fi
    find_python venv ensurepip || die 'found no Python >= 3.11 that can make a virtual environment'
}

installed() { # the whole of what this command needs, from this pyproject.toml, in this place
    [ -x "$venv/bin/python" ] && [ ! -e "$unfinished" ] &&
        { [ "$(cat "$venv/.hil-test" 2>/dev/null)" = "$key" ] ||
            { [ $level = run ] && [ "$(cat "$venv/.hil-run" 2>/dev/null)" = "$key" ]; }; }
}

reusable() { # a working venv of ours or made by hand; not one that was interrupted or moved
    [ ! -e "$unfinished" ] && is_python "$venv/bin/python" pip || return 1
    stamp=$(cat "$venv/.hil-run" 2>/dev/null) || return 0
    case $stamp in *" $root") ;; *) return 1 ;; esac
}

install() {
    if ! reusable; then
        choose_python
        say "making .venv with $("$python" --version)"
        rm -rf "$venv"
        mkdir "$venv"
        : >"$unfinished" # whatever stops us from here on, the next run starts afresh
        "$python" -m venv "$venv"
    fi
    : >"$unfinished"
    rm -f "$venv/.hil-run" "$venv/.hil-test"
    say "installing the project and what it needs into .venv (a minute or two, once)"
    if ! (cd "$root" && "$venv/bin/python" -m pip --quiet --disable-pip-version-check install $compile -e ".$extra"); then
        rm -f "$unfinished" # pip left no half package behind: try again from here
        die 'pip could not install the project; its message stands above'
    fi
    printf '%s\n' "$key" >"$venv/.hil-run"
    [ $level = run ] || printf '%s\n' "$key" >"$venv/.hil-test"
    rm -f "$unfinished"
}

case $1 in *pytest) test_packages ;; esac
if ! installed; then
    if command -v flock >/dev/null; then # two at once: the second waits and finds it done
        exec 9<"$root"
        flock -n 9 || { say 'waiting for another bootstrap to finish'; flock 9; }
    fi
    installed || install
    exec 9<&-
fi

VIRTUAL_ENV=$venv
PATH=$venv/bin:$PATH
export VIRTUAL_ENV PATH
unset PYTHONHOME
exec "$@"
