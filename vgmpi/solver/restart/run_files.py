"""Files that a run writes into its folder: frames, conservation log and checkpoints."""

import logging
from collections.abc import Sequence
from pathlib import Path

from vgmpi.io import checkpoint, file_layout
from vgmpi.io.csv_log import ConservationLog, CsvLog
from vgmpi.io.frames import Frames
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.runtime.versions import versions
from vgmpi.scene.scene import Scene
from vgmpi.solver.diagnostics.liquid_fill import liquid_phases
from vgmpi.solver.simulation import Simulation

from .state_io import frame_rows, save

log = logging.getLogger("vgmpi")


class RunFiles:
    """Files of one run. All methods are collective.

    Attributes:
        scene: The scene.
        simulation: The state that is written.
        folder: Folder of the run.
        particles: Identity of the particles (particle_set_id).
        history: What was changed at resumes.
        versions: Versions of the program and its packages.
        frames: Frames.
        ledger: Conservation log.
    """

    def __init__(
        self, scene: Scene, simulation: Simulation, folder: Path, frame: int,
        last_step: int | None, particles: int, history: list[dict],
    ):  # fmt: skip
        """Open the files; those of an earlier run are cut where this one begins.

        Args:
            scene: The scene.
            simulation: The state at the start.
            folder: Folder of the run.
            frame: Number of the next frame.
            last_step: Step from which the run goes on, None from the start.
            particles: Identity of the particles.
            history: What was changed at resumes.
        """
        self.scene, self.simulation, self.folder = scene, simulation, folder
        self.particles, self.history = particles, history
        self.versions = versions()  # asked here, since a stop may leave little time to a checkpoint
        plan, ranks = simulation.plan, simulation.ranks
        compresses = scene.output.compression == "gzip"
        self.frames = Frames(folder, ranks, plan.particles, frame, particles, compresses)
        has_momentum = any(feature.has_momentum for feature in plan.features)
        self.ledger = ConservationLog(
            folder, ranks, last_step, plan.changes_mass, bool(liquid_phases(plan)), has_momentum
        )
        if last_step is None:
            checkpoint.clear(folder / file_layout.CHECKPOINTS, ranks)

    def write_frame(self, number: int, conservation: list[dict]) -> None:
        """Write the present state as a frame, and its conservation entries."""
        self._write_state(self.frames, number)
        self.ledger.append(conservation)

    def write_blow_up(self) -> Path:
        """Write the present state for inspection; return the path of its file."""
        simulation, folder = self.simulation, self.folder / file_layout.BLOWUP
        return self._write_state(Frames(folder, simulation.ranks, simulation.plan.particles), 0)

    def _write_state(self, frames: Frames, number: int) -> Path:
        """Write the present state as frame number `number`; return its path."""
        simulation = self.simulation
        ids, fields = frame_rows(simulation, self.scene.output.fields)
        return frames.write(
            number, simulation.time, simulation.step, ids, fields, simulation.poses()
        )

    def write_checkpoint(self, frame: int, probe_tables: Sequence[CsvLog]) -> None:
        """Write a checkpoint.

        Args:
            frame: Number of the next frame.
            probe_tables: Tables of the probes, whose checksums it holds.
        """
        simulation, scene = self.simulation, self.scene
        state = save(simulation)
        state["attrs"] |= {
            "frame": frame,
            "scene_text": scene.text,
            "overrides": list(scene.overrides),
            "resume_history": self.history,
            "gaussians_crc": self.particles,
            "log_checksums": {table.path.name: table.sum for table in (self.ledger, *probe_tables)},
            "scene": scene.to_json(),
            "plan_report": format_plan(scene, simulation.plan, ranks=1).splitlines(),
            "versions": self.versions,
        }
        path = checkpoint.write(self.folder / file_layout.CHECKPOINTS, simulation.ranks, state)
        log.info("checkpoint %s at step %d, %.6g s", path, simulation.step, simulation.time)
