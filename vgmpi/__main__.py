"""`python -m vgmpi scene.toml`."""

import sys

from .ends import guarded


@guarded
def main() -> int:
    """The command in a process of its own: `vgmpi`."""
    from . import cli  # what it brings takes a while, in which a user may interrupt

    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
