"""`python -m vgmpi scene.toml` and `vgmpi COMMAND ...`."""

import atexit
import gc
import sys

from vgmpi.runtime.command_line import exit_code_from_exceptions

NEW_OBJECTS = 50_000  # made until Python searches them for cycles: modules make many, and no cycles


@exit_code_from_exceptions
def main() -> int:
    """Run the command of this process's command line; returns the exit code."""
    gc.set_threshold(NEW_OBJECTS)
    atexit.register(gc.freeze)  # what modules hold is not searched once more at the end
    # imported here: an interrupt while this loads ends the program in one line
    from vgmpi.commands import command_table

    return command_table.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
