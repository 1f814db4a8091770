"""A contestant's process: makes the contestant, then answers the rounds it is asked for.

    python -m vgmpi.bench.worker '{"module": "plain", "socket": "...", ...}'

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
    "own": "vgmpi.bench.own",
    "plain": "vgmpi.bench.plain",
    "taichi_rival": "vgmpi.bench.taichi_rival",
    "warp_rival": "vgmpi.bench.warp_rival",
}


def main(given: dict) -> None:
    link = socket.socket(socket.AF_UNIX)
    link.connect(given["socket"])
    lines = link.makefile("rw", encoding="utf-8")

    def say(**answer) -> None:
        lines.write(json.dumps(answer) + "\n")
        lines.flush()

    try:
        path = given.get("path") or CONTESTANTS[given["module"]]
        rival = importlib.import_module(path).Contestant(given)
    except Exception as error:  # the one who asked says it in the contestant's row
        missing = getattr(error, "name", None) if isinstance(error, ImportError) else None
        say(error=f"{type(error).__name__}: {error}", missing=missing)
        raise
    say(versions=rival.versions)
    for line in lines:
        asked = json.loads(line)
        say(**getattr(rival, asked.pop("do"))(**asked))


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
