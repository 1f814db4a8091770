"""Command `python -m vgmpi photo photo.jpg layout.toml -o runs/mine`: photograph to scene."""

import argparse
import contextlib
import logging
import secrets
import sys
from pathlib import Path

from vgmpi.runtime.exit_handler import exit_code_from_exceptions

EXIT_USAGE = 2


def parse_arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        prog="vgmpi photo",
        description="Objects in a photograph become Gaussians and a scene in which they stand as"
        " they do in the photograph. Every guess is written into the layout, where it can be"
        " changed; docs/how-to/photo-to-scene.md.",
        epilog="exit codes: 0 done, 1 unexpected error, 2 something in the layout, the pictures or"
        " the flags is wrong, 130 interrupted",
    )
    parser.add_argument("photo", type=Path, help="the photograph")
    parser.add_argument(
        "layout",
        type=Path,
        nargs="?",
        help="layout.toml: objects in the photograph; --find creates one",
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="output folder"
    )
    parser.add_argument(
        "--find", action="store_true",
        help="propose a layout with boxes of possible objects, and stop",
    )  # fmt: skip
    parser.add_argument(
        "--edit", action="store_true",
        help="open a page in the browser to click on objects and to paint their masks, and stop",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=int, help="with --edit: port of the page on this machine [any free one]"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace a scene that was edited")
    return parser.parse_args(argv)


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parse_arguments(argv)
    from vgmpi.io.run_reader import RunError

    from .grabcut import MaskError
    from .layout_config import LayoutError
    from .photograph import PhotographError
    from .pipeline import photo_to_scene, propose

    lines = _listen()
    try:
        _check_flags(args)
        if args.edit:
            return _edit(args)
        if args.find:
            where = propose(args.photo, args.layout, args.output)
            print(f"{where}: proposed; {args.output / 'find.png'} shows the boxes")
            print("next: names and one height in it, then the same without --find")
            return 0
        if args.layout is None:
            raise LayoutError(["no layout is given: --find proposes one, --edit draws one"])
        photo_to_scene(args.photo, args.layout, args.output, args.overwrite)
    except LayoutError as error:
        for line in error.lines:
            print(line, file=sys.stderr)
        return EXIT_USAGE
    except (PhotographError, MaskError, RunError) as error:
        print(error, file=sys.stderr)
        return EXIT_USAGE
    except OSError as error:
        print(f"{error.filename or args.output}: {error.strerror or error}", file=sys.stderr)
        return EXIT_USAGE
    finally:
        logging.getLogger("vgmpi.apps.photo").removeHandler(lines)
    out = args.output
    lines.write(out)
    print(f"{out / 'check.png'}: the photograph beside the first frame")
    print(f"next: python -m vgmpi {out / 'scene.toml'}")
    print(f"then: vgmpi render {out / 'out'} {out / 'render.toml'}")
    return 0


def _check_flags(args: argparse.Namespace) -> None:
    """Check the flags; raise a LayoutError with one line."""
    from .layout_config import LayoutError

    if args.find and args.edit:
        raise LayoutError(["--edit: not allowed with --find: first the one, then the other"])
    if args.port is not None and not args.edit:
        raise LayoutError(["--port: allowed with --edit only"])
    if args.port is not None and not 0 <= args.port <= 65535:
        raise LayoutError([f"--port: {args.port}: allowed: 0 to 65535"])


def _edit(args: argparse.Namespace) -> int:
    """Serve the page on which a layout is edited until it is ended; return the exit code."""
    from . import photograph
    from .mask_editor.edit_server import EditServer
    from .mask_editor.edit_session import EditSession

    path = args.layout if args.layout is not None else args.output / "layout.toml"
    session = EditSession(photograph.read(args.photo), path)
    with EditServer(session, args.port or 0, secrets.token_urlsafe(24)) as server:
        print(f"objects of {args.photo}: {server.address}", flush=True)
        print("the page writes the layout when you save; Ctrl-C or its button ends it", flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
    print(f"{path}: {'saved' if server.was_saved else 'nothing was saved'}")
    if server.was_saved:
        print(f"next: vgmpi photo {args.photo} {path} -o {args.output}")
    return 0


def _listen():
    """Print the decisions of the package's logger and record them for images.log."""
    from .output_folder import Decisions

    decisions = Decisions(lambda line: print(line, flush=True))
    log = logging.getLogger("vgmpi.apps.photo")
    log.setLevel(logging.INFO)
    log.addHandler(decisions)
    return decisions


if __name__ == "__main__":
    sys.exit(main())
