"""`python -m vgmpi scene.toml` and `vgmpi COMMAND ...`."""

import sys

from vgmpi.runtime.command_line import exit_code_from_exceptions


@exit_code_from_exceptions
def main() -> int:
    """Run the command of this process's command line; returns the exit code."""
    # imported here: an interrupt while this loads ends the program in one line
    from vgmpi.commands import command_table

    return command_table.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
