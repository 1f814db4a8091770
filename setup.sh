#!/usr/bin/env bash
# All set-up for `make demo` and `make test`: system packages, then .venv with an h5py that speaks parallel HDF5.
# Installs only what is missing, so a second call installs nothing. For Debian 12, Ubuntu 24.04 and their kin,
# as root or as a user with sudo.
#   PYTHON=python3.12 ./setup.sh    another interpreter (3.11 or newer)
#   EXTRAS= ./setup.sh              without what tests, docs and pages of a run want (names from pyproject.toml)
#   HDF5=serial ./setup.sh          without building h5py (2 minutes): ranks then write through rank 0, the same bytes
# Without root, or elsewhere: docs/how-to/run-on-a-cluster.md.
set -euo pipefail
cd "$(dirname "$0")"

H5PY=3.16.0  # no wheel carries parallel HDF5, so this one version is built here
PYTHON=${PYTHON:-python3}
EXTRAS=${EXTRAS-test,dev,docs,validate,live}
HDF5=${HDF5:-parallel}
VENV=.venv

say() { echo "setup: $*"; }
fail() { echo "setup: $*" >&2; exit 1; }
installed() { [ "$(dpkg-query -W -f='${db:Status-Status}' "$1" 2>/dev/null)" = installed ]; }

system_packages() {
    local missing=() needed=(openmpi-bin) p
    # the last row: what an offscreen pyvista picture needs on a machine without a display
    [ "$HDF5" = serial ] || needed+=(libopenmpi-dev libhdf5-openmpi-dev build-essential
                                     libegl1 libegl-mesa0 libgl1-mesa-dri libgl1 libxrender1)
    for p in "${needed[@]}"; do
        installed "$p" || missing+=("$p")
    done
    if ! command -v "$PYTHON" >/dev/null; then
        missing+=(python3 python3-venv python3-dev)
    else
        "$PYTHON" -c 'import venv, ensurepip' 2>/dev/null || missing+=(python3-venv)
        [ "$HDF5" = serial ] || "$PYTHON" -c 'import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' || missing+=(python3-dev)
    fi
    [ ${#missing[@]} -gt 0 ] || return 0

    local root=()
    if [ "$(id -u)" != 0 ]; then
        command -v sudo >/dev/null || fail "missing packages: ${missing[*]}. Install them as root and call again;" \
            "or use \`pip install .\`, which runs on one rank without them; docs/how-to/run-on-a-cluster.md says how ranks work without root."
        root=(sudo)
    fi
    say "system packages: ${missing[*]}"
    local apt=("${root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 -qq)
    "${apt[@]}" update </dev/null || say "apt-get update failed; trying with the lists that are here"
    "${apt[@]}" install -y --no-install-recommends "${missing[@]}" </dev/null >/dev/null ||
        fail "apt-get could not install: ${missing[*]}"
}

venv_folder() {
    "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
        fail "Python 3.11 or newer is needed; $PYTHON is $("$PYTHON" -V 2>&1). Set PYTHON=..."
    "$VENV/bin/python" -m pip --version >/dev/null 2>&1 && return 0
    say "$VENV"
    "$PYTHON" -m venv --clear "$VENV"
}

pip_install() { "$VENV/bin/python" -m pip --disable-pip-version-check install -q "$@" </dev/null; }

parallel_h5py() {
    local have
    have=$("$VENV/bin/python" -c 'import h5py; print(h5py.__version__, h5py.get_config().mpi)' 2>/dev/null || true)
    [ "$have" = "$H5PY True" ] && return 0
    say "h5py $H5PY with parallel HDF5 (about 2 minutes)"
    pip_install "setuptools>=77,<90" wheel "cython>=3,<4" "pkgconfig>=1.5,<2" "numpy>=2.0,<3" "mpi4py>=4.0,<5"
    local hdf5 log=$VENV/h5py.log
    hdf5=/usr/lib/$(gcc -print-multiarch)/hdf5/openmpi
    printf '[build_ext]\nparallel = %s\n' "$(nproc)" > "$VENV/dist.cfg"
    # without build isolation: an isolated build would compile mpi4py too (8 minutes)
    DIST_EXTRA_CONFIG=$PWD/$VENV/dist.cfg CFLAGS="-O1 -g0" CC=mpicc HDF5_MPI=ON HDF5_DIR=$hdf5 \
        "$VENV/bin/python" -m pip --disable-pip-version-check install --no-build-isolation --no-deps \
        --no-cache-dir --force-reinstall --no-binary=h5py "h5py==$H5PY" </dev/null >"$log" 2>&1 ||
        { tail -20 "$log" >&2; fail "building h5py failed; the whole output is in $log"; }
}

# The stamp says for which set-up script, package list and interpreter the folder was filled; extras stand beside it.
stamp() { cat setup.sh pyproject.toml <("$PYTHON" -V) | sha256sum | cut -d' ' -f1; }

# A set-up with parallel HDF5, with whatever extras, serves a serial one, too.
is_ready() {
    local parallel serial
    parallel=$(cat "$VENV/ready-parallel" 2>/dev/null || true)
    serial=$(cat "$VENV/ready-serial" 2>/dev/null || true)
    if [ "$parallel" = "$want $EXTRAS" ] || { [ "$HDF5" = serial ] && [ "${parallel%% *}" = "$want" ]; }; then
        "$VENV/bin/python" -c 'import vgmpi, h5py, sys; sys.exit(not h5py.get_config().mpi)' 2>/dev/null
    elif [ "$HDF5" = serial ] && [ "$serial" = "$want" ]; then
        "$VENV/bin/python" -c 'import vgmpi, h5py' 2>/dev/null
    else
        return 1
    fi
}

want=$(stamp)
is_ready && exit 0
system_packages
venv_folder
rm -f "$VENV"/ready-*
[ "$HDF5" = serial ] || parallel_h5py
say "Python packages"
pip_install "setuptools>=77,<90" wheel
pip_install --no-build-isolation -e ".${EXTRAS:+[$EXTRAS]}"
if [ "$HDF5" = serial ]; then echo "$want" > "$VENV/ready-serial"; else echo "$want $EXTRAS" > "$VENV/ready-parallel"; fi
[[ ,$EXTRAS, != *,dev,* ]] || .githooks/install.sh || say "commit messages are not checked"
[ "$HDF5" != serial ] || say "h5py is serial: ranks write through rank 0; \`make setup\` builds the parallel one (2 minutes)"
say "ready"
