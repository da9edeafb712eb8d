#!/usr/bin/env bash
# Make or refresh the virtual environment: deploy/make-venv.sh VENV EXTRAS
# Debian packages that are needed are installed when run as root, and named otherwise.
set -euo pipefail
venv=$1
extras=$2
python=${PYTHON:-}
here=$(cd "$(dirname "$0")/.." && pwd)

if [ -z "$python" ]; then
    for candidate in python3.11 python3.12 python3.13 python3; do
        if command -v "$candidate" >/dev/null 2>&1; then python=$candidate; break; fi
    done
fi
[ -n "$python" ] || { echo "make setup: no Python found; install Python 3.11 or newer" >&2; exit 2; }
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
    || { echo "make setup: $python is too old; Python 3.11 or newer is needed (PYTHON=... chooses another)" >&2; exit 2; }

missing=()
"$python" -c 'import ensurepip' >/dev/null 2>&1 || missing+=(python3-venv)
if [ "$(uname -s)" = Linux ]; then
    # systemd-python has no wheel: it is compiled against libsystemd.
    command -v pkg-config >/dev/null 2>&1 || missing+=(pkg-config)
    pkg-config --exists libsystemd 2>/dev/null || missing+=(libsystemd-dev)
    command -v cc >/dev/null 2>&1 || command -v gcc >/dev/null 2>&1 || missing+=(gcc)
fi
if [ ${#missing[@]} -gt 0 ]; then
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
        echo "installing ${missing[*]}"
        export DEBIAN_FRONTEND=noninteractive
        apt-get update -qq
        # A Pi that has just been started may be at its own upgrades.
        apt-get -o DPkg::Lock::Timeout=300 install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
    else
        echo "make setup: these system packages are needed first: ${missing[*]}" >&2
        echo "  on Debian, Ubuntu and Raspberry Pi OS: sudo apt install ${missing[*]}" >&2
        exit 2
    fi
fi

[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --constraint "$here/deploy/constraints.txt" --editable "$here[$extras]"
echo "ready: $venv (extras: $extras)"
