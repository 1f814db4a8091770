"""Live page of a run: vgmpi live OUT --port 8080

The page follows the folder of a run while it is written, or plays a run that has ended. It listens
on this machine alone unless --host tells otherwise; then the address holds a token. It needs viser:
pip install "vgmpi[live]". Ctrl-C ends the page and leaves the run alone.
"""

import argparse
import logging
import os
import re
import secrets
import signal
import socket
import sys
import threading
from pathlib import Path

from vgmpi.io.run_reader import RunError
from vgmpi.runtime import user_files
from vgmpi.runtime.command_line import ArgumentParser, exit_code_from_exceptions
from vgmpi.runtime.message_text import did_you_mean_file

from ..frames import render_config
from ..frames.render_config import SettingsError

log = logging.getLogger("vgmpi")

MAX_PARTICLES = 300_000  # Gaussians that a browser draws at a usable rate
LOCAL_HOSTS = ("127.0.0.1", "localhost", "::1")
ANY_HOST = ("0.0.0.0", "::", "")  # all interfaces of this machine
MIN_TOKEN = 8  # letters of a token
MAX_TOKEN = 1024  # [bytes] of the file of a token
LOW_PRIORITY = 10  # of a page that a run has started


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = ArgumentParser(prog="vgmpi live", description=__doc__)
    p.add_argument("out", type=Path, help="folder of the run")
    p.add_argument(
        "settings",
        nargs="?",
        type=Path,
        help="render.toml: appearance and camera [the one in or beside OUT]",
    )
    p.add_argument("--port", type=int, default=8080, help="port; 0: any free one [8080]")
    p.add_argument(
        "--host", default="127.0.0.1", help="interface; 0.0.0.0: all of them [this machine alone]"
    )
    tokens = p.add_mutually_exclusive_group()
    tokens.add_argument(
        "--token",
        action="store_true",
        help="require a random word in the address, which is printed [with --host: always]",
    )
    tokens.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="require the word in this file, which nobody else may read (chmod 600)",
    )
    p.add_argument(
        "--particles",
        type=int,
        default=100_000,
        help=f"maximum number of Gaussians, to {MAX_PARTICLES} [100000]",
    )
    p.add_argument(
        "--linger",
        type=float,
        metavar="SECONDS",
        help="end when the run has ended and nobody has watched for this time [never]",
    )
    # of a page that a run has started: messages go to this file, and other processes go first
    p.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    return p


def check_arguments(args: argparse.Namespace) -> None:
    """Check the flags. Raises RunError with one line."""
    if not args.out.is_dir():
        raise RunError(f"{args.out}: no such folder{did_you_mean_file(args.out)}")
    if not 0 <= args.port <= 65535:
        raise RunError(f"--port: {args.port}: allowed: 0 to 65535")
    if not 1 <= args.particles <= MAX_PARTICLES:
        raise RunError(f"--particles: {args.particles}: allowed: 1 to {MAX_PARTICLES}")
    if args.linger is not None and not args.linger >= 0:
        raise RunError(f"--linger: {args.linger}: allowed: 0 or more seconds")


def choose_token(args: argparse.Namespace) -> str | None:
    """Return the token of the page, None for a page of this machine alone. Raises RunError."""
    if args.token_file is not None:
        return read_token(args.token_file)
    if not args.token and args.host in LOCAL_HOSTS:
        return None
    return secrets.token_urlsafe(24)


def read_token(path: Path) -> str:
    """Return the word in a file that only its owner may read. Raises RunError."""
    try:
        word = user_files.read_regular_file(path, MAX_TOKEN).decode("ascii").strip()
        mode = path.stat().st_mode
    except UnicodeDecodeError:
        word, mode = "", 0
    except OSError as error:
        raise RunError(f"--token-file: {path}: {error.strerror}") from None
    if mode & 0o077:
        raise RunError(f"--token-file: {path}: others may read it: chmod 600 {path}")
    if not re.fullmatch(rf"[A-Za-z0-9_-]{{{MIN_TOKEN},}}", word):
        message = f"allowed: one word of {MIN_TOKEN} or more letters, digits, - and _"
        raise RunError(f"--token-file: {path}: {message}")
    return word


def address(host: str, port: int, token: str | None) -> str:
    """Return the address for a browser."""
    name = "localhost" if host in LOCAL_HOSTS else host
    name = socket.gethostname() if host in ANY_HOST else name
    name = f"[{name}]" if ":" in name else name
    return f"http://{name}:{port}/" + ("" if token is None else f"?token={token}")


def serve_page(args: argparse.Namespace) -> int:
    """Serve the page until it is interrupted; return the exit code. Raises RunError."""
    # imported late, so that --help stays quick
    from ..live.followed_run import FollowedRun
    from ..live.guarded_server import AccessRules, open_socket, start_server, stop_server
    from ..live.live_page import LivePage, PageOptions

    path = args.settings or render_config.find_settings(args.out)
    chosen = render_config.load(path)
    token = choose_token(args)
    sock = open_socket(args.host, args.port)
    port = sock.getsockname()[1]
    server = start_server(args.host, AccessRules(token, port), sock, f"vgmpi: {args.out.name}")
    camera_path = path or args.out / render_config.SETTINGS_NAME
    followed = FollowedRun(args.out, args.particles, chosen.look)
    page = LivePage(server, followed, chosen, PageOptions(path, camera_path, args.linger))
    was_interrupted = threading.Event()

    def end_page(*_: object) -> None:
        """End the page at a signal."""
        was_interrupted.set()
        page.end()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, end_page)
    process = "" if args.log is None else f" (process {os.getpid()})"
    print(f"live page of {args.out}: {address(args.host, port, token)}{process}", flush=True)
    if args.log is not None:
        leave_terminal(args.log)
    try:
        page.run()
    finally:
        stop_server(server)
    print("the live page has ended", flush=True)
    return 130 if was_interrupted.is_set() else 0


def leave_terminal(path: Path) -> None:
    """Write further messages to a file: a launcher waits for those who hold its output."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o644)
    sys.stdout.flush()
    os.dup2(handle, sys.stdout.fileno())
    os.dup2(handle, sys.stderr.fileno())
    os.close(handle)


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parser().parse_args(argv)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    try:
        check_arguments(args)
        if args.log is not None:
            os.nice(LOW_PRIORITY)
            os.sched_setaffinity(0, range(os.cpu_count() or 1))  # not the core of a rank
        return serve_page(args)
    except SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
    except RunError as error:
        print(error, file=sys.stderr)
    return 2
