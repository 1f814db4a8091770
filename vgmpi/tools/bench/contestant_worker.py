"""A contestant's process: makes the contestant, then answers the rounds it is asked for.

    python -m vgmpi.tools.bench.contestant_worker '{"module": "plain", "socket": "...", ...}'

One line of JSON each way over a Unix socket. While a contestant waits it sleeps, so that it takes
no time from the one whose turn it is; on several ranks each has a socket of its own for that
reason.
"""

import importlib
import json
import socket
import sys

# the modules that make contestants, by what a round calls them; a checkout that measures another
# one knows its own alone, and asks for the other's by this name
CONTESTANTS = {
    "own": "vgmpi.tools.bench.vgmpi_contestant",
    "plain": "vgmpi.tools.bench.numba_baseline",
    "taichi_rival": "vgmpi.tools.bench.taichi_baseline",
    "warp_rival": "vgmpi.tools.bench.warp_baseline",
}


def main(config: dict) -> None:
    """Make the contestant and answer its requests."""
    link = socket.socket(socket.AF_UNIX)
    link.connect(config["socket"])
    lines = link.makefile("rw", encoding="utf-8")

    def say(**answer) -> None:
        """Send one answer."""
        lines.write(json.dumps(answer) + "\n")
        lines.flush()

    try:
        path = config.get("path") or CONTESTANTS[config["module"]]
        rival = importlib.import_module(path).Contestant(config)
    except Exception as error:  # the one who asked says it in the contestant's row
        missing = getattr(error, "name", None) if isinstance(error, ImportError) else None
        say(error=f"{type(error).__name__}: {error}", missing=missing)
        raise
    say(versions=rival.versions)
    for line in lines:
        request = json.loads(line)
        say(**getattr(rival, request.pop("do"))(**request))


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
