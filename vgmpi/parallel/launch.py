"""Programs that start ranks: what Open MPI wants to be told, and how a user stops a run by them."""

import os
from collections.abc import Mapping
from pathlib import Path

OPEN_MPI = {  # allows root to start ranks, and more ranks than cores (releases 4 and 5)
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_btl_vader_single_copy_mechanism": "none",
}
SUPERVISOR_VARIABLE = "VGMPI_SUPERVISOR"  # of ranks: process that started them by itself
LAUNCHERS = frozenset(
    ("mpirun", "mpiexec", "orterun", "prterun", "mpiexec.hydra", "mpirun.openmpi", "mpirun.mpich")
)
# variables of a process that mpirun, srun or a batch job of SLURM started
_LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK", "MPI_LOCALRANKID")
_SLURM = ("SLURM_JOB_ID", "SLURM_NTASKS", "SLURM_PROCID")
_MAX_ANCESTORS = 8  # processes between a rank and its launcher; hydra has one


def launched_by(environment: Mapping[str, str] = os.environ) -> str:
    """Return the launcher that started this process: "mpirun", "SLURM", or "" for none."""
    if any(name in environment for name in _LAUNCHED):
        return "mpirun"
    return "SLURM" if any(name in environment for name in _SLURM) else ""


def find_launcher(processes: Path = Path("/proc")) -> int | None:
    """Return the process that started the ranks of this machine, or None if it is not here.

    Args:
        processes: Folder of processes, as Linux has it.
    """
    process = os.getppid()
    for _ in range(_MAX_ANCESTORS):
        try:
            name = (processes / str(process) / "comm").read_text().strip()
            state = (processes / str(process) / "stat").read_text()
        except OSError:
            return None
        if name in LAUNCHERS:
            return process
        process = int(state.rpartition(")")[2].split()[1])  # the name may hold anything
    return None


def describe_stop(
    library: str, launcher: int | None, job: str | None, supervisor: str | None = None
) -> str:
    """Return a line that says how to stop a run of several ranks with a checkpoint.

    Args:
        library: Name and version of the MPI library.
        launcher: Process of mpirun, None if it is not known.
        job: Number of the SLURM job, None outside of one.
        supervisor: Process of vgmpi that started the ranks by itself, None if it did not.
    """
    if supervisor is not None:
        return f"to stop with a checkpoint: Ctrl-C, or kill {supervisor}"
    if job is not None:
        return f"to stop with a checkpoint: scancel --batch --signal=USR1 {job}"
    command = f"kill -USR1 {launcher or 'PID of mpirun'}"
    if library.startswith("Open MPI"):
        version = library.split(",")[0].removeprefix("Open MPI v")
        patience = 1 if version.startswith("4.") else 0.25
        return (
            f"to stop with a checkpoint: {command}; after Ctrl-C, Open MPI {version} ends the"
            f" ranks within {patience:g} s"
        )
    return f"to stop with a checkpoint: Ctrl-C, or {command}"
