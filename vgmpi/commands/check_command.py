"""Check of a scene without a run: its particles and its plan are made, and nothing is written."""

import logging

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.scene_warnings import note_lines, warning_lines
from vgmpi.scene.scene import Scene
from vgmpi.solver.initial_particles import plan_for, prepare

log = logging.getLogger("vgmpi")


class WarningCounter(logging.Handler):
    """Counter of the warnings that are logged.

    Attributes:
        count: Number of warnings so far.
    """

    def __init__(self) -> None:
        """Start at zero."""
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Count a record.

        Args:
            record: The record.
        """
        self.count += 1


def check_scene(scene: Scene) -> int:
    """Print warnings and notes on a scene, and their number; return the exit code.

    Raises:
        SceneError: All that is wrong with the scene.
    """
    counter = WarningCounter()
    log.addHandler(counter)
    try:  # only this finds unreadable files and bodies outside the domain
        plan = plan_for(scene, prepare(scene, SerialCommunicator(), None))
    finally:
        log.removeHandler(counter)
    for line in (warnings := warning_lines(scene, plan)):
        print(f"warning: {line}")
    for line in note_lines(scene, plan):
        print(f"note: {line}")
    count = counter.count + len(warnings)
    print(f"{scene.path}: 0 errors, {count} warning{'s' * (count != 1)}")
    return 0
