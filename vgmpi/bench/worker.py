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


def main(given: dict) -> None:
    link = socket.socket(socket.AF_UNIX)
    link.connect(given["socket"])
    lines = link.makefile("rw", encoding="utf-8")

    def say(**answer) -> None:
        lines.write(json.dumps(answer) + "\n")
        lines.flush()

    try:
        rival = importlib.import_module(f"vgmpi.bench.{given['module']}").Contestant(given)
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
