"""Sizes of the files that a run writes, for --plan; io/file_layout.py has their layout."""

from vgmpi.planning.plan import Plan
from vgmpi.planning.region_groups import group_counts
from vgmpi.runtime.process_limits import format_bytes
from vgmpi.scene.scene import Scene

# [bytes] of a particle in a frame: number, position, object, velocity field, and VTK's tables
BYTES_OF_EVERY_FRAME = 8 + 12 + 4 + 4 + 8
BYTES_OF_FIELD = {
    "velocity": 12, "J": 4, "F": 36, "stress": 24, "pressure": 4, "strain": 24,
    "volume_fraction": 4,
}  # fmt: skip


def frame_bytes(scene: Scene, plan: Plan) -> int:
    """Return the size of a frame with all particles of a run [bytes]."""
    has_deformation = any(group.has_deformation for group in plan.groups)
    each = BYTES_OF_EVERY_FRAME
    for name in scene.output.fields:
        if name != "F" or has_deformation:
            each += BYTES_OF_FIELD[name]
    if plan.colors is not None:
        each += 4 * 3 * int(plan.colors.coefficients.max())
    return each * plan.particles


def checkpoint_bytes(plan: Plan) -> int:
    """Return the size of a checkpoint with all particles of a run [bytes]."""
    return sum(count * plan.bytes_per_particle(group) for count, group in group_counts(plan))


def file_size_line(scene: Scene, plan: Plan) -> str:
    """Return the line of a plan about the files."""
    frame, frames = frame_bytes(scene, plan), len(plan.times)
    return (
        f"  disk        {frames} frames of {_size(frame)}, {_size(frame * frames)} in all;"
        f" a checkpoint takes {_size(checkpoint_bytes(plan))}"
    )


def _size(size: int) -> str:
    """Return a number of bytes as text."""
    return f"{size / 2**20:.3g} MiB" if size < 2**30 else format_bytes(size)
