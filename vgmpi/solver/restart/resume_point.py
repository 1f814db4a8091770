"""Checkpoint from which a run goes on: which one it is, and what may have changed since."""

import logging
from pathlib import Path
from typing import NamedTuple

from vgmpi.io import checkpoint, file_layout
from vgmpi.io.csv_log import ledger_columns, optional_ledger_columns, verify_logs
from vgmpi.io.run_reader import particle_set_id
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.scene.resume_rules import (
    changes_without_effect,
    forbidden_changes,
    may_change,
    with_accuracy_of_run,
)
from vgmpi.scene.scene import Scene
from vgmpi.solver.diagnostics.probe_sampling import files
from vgmpi.solver.initial_particles import on_all

from .checkpoint_validation import check_attrs

log = logging.getLogger("vgmpi")


class ResumePoint(NamedTuple):
    """State from which a run goes on; of a run from its start nothing but the defaults."""

    path: Path | None = None  # checkpoint
    attrs: dict = {}  # its attributes
    history: list[dict] = []  # what was changed at resumes, this one included

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        return self.attrs.get("time", 0.0)


def find_resume_point(
    scene: Scene, requested: str, change: bool, folder: Path, ranks: SerialCommunicator
) -> tuple[Scene, ResumePoint]:
    """Return the scene as the run goes on with it, and where it goes on. Collective.

    Args:
        scene: The scene as it is now.
        requested: Path of a checkpoint, or "" for the newest valid one.
        change: Whether keys may have changed that change the results.
        folder: Folder of the run, whose tables are checked.
        ranks: Communicator.

    Raises:
        CheckpointError: If there is no valid checkpoint.
        SceneError: If a key has changed that may not.
        RunError: If a table of the run does not belong to the checkpoint.
    """
    path, attrs = resolve_checkpoint(requested, folder, ranks)
    scene = with_accuracy_of_run(scene, attrs["scene"])
    history = _extend_history(scene, attrs, change)
    ledger = folder / file_layout.LEDGER
    present = False, False
    if ranks.rank == 0:  # it reads the tables
        present = optional_ledger_columns(ledger, *present)
    columns = ledger_columns(scene.changes_mass, *present)
    tables = {ledger: columns, **files(scene, folder)}
    verify_logs(tables, ranks, attrs["step"], attrs.get("log_checksums", {}))
    return scene, ResumePoint(path, attrs, history)


def resolve_checkpoint(
    requested: str, folder: Path, ranks: SerialCommunicator
) -> tuple[Path, dict]:
    """Return the checkpoint that `--resume` means, and its attributes. Collective.

    `requested` is its path, or "" for the newest valid one. Raises CheckpointError if there is
    none or it is not valid.
    """
    path = checkpoint.select(requested, folder / file_layout.CHECKPOINTS, ranks)
    with on_all(ranks, path, lambda: checkpoint.open(path)) as saved:
        check_attrs(path, saved.attrs)
        return path, saved.attrs


def identify_particles(resume_point: ResumePoint, folder: Path, ranks: SerialCommunicator) -> int:
    """Return the identity of the particles in a folder (particle_set_id). Collective.

    Raises:
        CheckpointError: If the checkpoint is of other particles.
    """
    gaussians = folder / file_layout.GAUSSIANS
    particles = on_all(ranks, gaussians, lambda: particle_set_id(gaussians))
    if resume_point.attrs.get("gaussians_crc") not in (None, particles):
        path = resume_point.path
        raise checkpoint.CheckpointError(f"{path}: is of other particles than {gaussians}")
    return particles


def _extend_history(scene: Scene, attrs: dict, change: bool) -> list[dict]:
    """Return the changes of the scene at all resumes, including this one.

    Raises:
        SceneError: If a key has changed that may not, unless `change` is set, or one that cannot.
    """
    history = list(attrs.get("resume_history", []))
    differences = forbidden_changes(scene, attrs["scene"])
    if not differences:
        return history
    lines = scene.error(differences).lines
    if not change:
        free = ", ".join(may_change())
        raise scene.error(differences).with_line(
            f"--resume may change {free}; with --change all else too"
        )
    if without_effect := changes_without_effect(scene, differences):
        raise scene.error(without_effect)
    for line in lines:
        log.warning("changed from here on: %s", line)
    return [*history, {"step": attrs["step"], "time": attrs["time"], "changes": lines}]
