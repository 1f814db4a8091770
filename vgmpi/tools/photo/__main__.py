"""Command `python -m vgmpi photo photo.jpg layout.toml -o runs/mine`: photograph to scene."""

import argparse
import contextlib
import logging
import secrets
import subprocess
import sys
from pathlib import Path

from vgmpi.runtime.command_line import ArgumentParser, exit_code_from_exceptions, report_file_error

EXIT_USAGE = 2


def parse_arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = ArgumentParser(
        prog="vgmpi photo",
        description="Objects in a photograph become Gaussians and a scene in which they stand as"
        " they do in the photograph. Every guess is written into the layout, where it can be"
        " changed; docs/how-to/photo-to-scene.md.",
        epilog="exit codes: 0 done, 1 unexpected error, 2 something in the layout, the pictures or"
        " the flags is wrong, 130 interrupted",
    )
    parser.add_argument("photo", type=Path, nargs="?", help="the photograph")
    parser.add_argument(
        "layout",
        type=Path,
        nargs="?",
        help="layout.toml: objects in the photograph; --find creates one",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="output folder; required"
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
    parser.add_argument(
        "--demo", nargs="?", const="", metavar="NAME",
        help="make the scene of an example, with its photograph; without NAME: list them",
    )  # fmt: skip
    parser.add_argument(
        "--video", action="store_true", help="also run the scene and draw its video"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace a scene that was edited")
    return parser.parse_args(argv)


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parse_arguments(argv)
    from vgmpi.io.run_reader import RunError

    from .example_photographs import write_example
    from .grabcut import MaskError
    from .layout_config import LayoutError
    from .photograph import PhotographError
    from .pipeline import photo_to_scene, propose

    lines = _listen()
    try:
        if args.demo == "":
            return _list_examples()
        _check_flags(args)
        if args.demo is not None:
            args.photo, args.layout = write_example(args.demo, args.output)
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
        return report_file_error(error, args.output)
    finally:
        logging.getLogger("vgmpi.tools.photo").removeHandler(lines)
    out = args.output
    lines.write(out)
    print(f"{out / 'check.png'}: the photograph beside the first frame")
    if args.video:
        return _make_video(out)
    print(f"next: python -m vgmpi {out / 'scene.toml'}")
    print(f"then: vgmpi render {out / 'out'} {out / 'render.toml'}")
    return 0


def _check_flags(args: argparse.Namespace) -> None:
    """Check the flags; raise a LayoutError with one line."""
    from .layout_config import LayoutError

    if args.output is None:
        raise LayoutError(["-o: an output folder is needed"])
    if args.demo is not None and (args.photo or args.find):
        word = "--find" if args.find else "a photograph"
        raise LayoutError([f"--demo: not allowed with {word}: an example has its own layout"])
    if args.photo is None and args.demo is None:
        raise LayoutError(["no photograph is given: name one, or an example with --demo NAME"])
    if args.video and (args.find or args.edit):
        raise LayoutError(["--video: not allowed with --find and --edit, which make no scene"])
    if args.find and args.edit:
        raise LayoutError(["--edit: not allowed with --find: first the one, then the other"])
    if args.port is not None and not args.edit:
        raise LayoutError(["--port: allowed with --edit only"])
    if args.port is not None and not 0 <= args.port <= 65535:
        raise LayoutError([f"--port: {args.port}: allowed: 0 to 65535"])


def _list_examples() -> int:
    """Print the examples; return the exit code."""
    from .example_photographs import SUMMARIES

    for name, summary in SUMMARIES.items():
        print(f"{name:8}  {summary}")
    print("next: vgmpi photo --demo NAME -o FOLDER --video")
    return 0


def _make_video(out: Path) -> int:
    """Run the scene of a folder and draw its video; return the exit code."""
    for words in (
        ["run", str(out / "scene.toml"), "--overwrite"],
        ["render", str(out / "out"), str(out / "render.toml")],
    ):
        code = subprocess.call([sys.executable, "-m", "vgmpi", *words])
        if code != 0:
            return code
    return 0


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
    log = logging.getLogger("vgmpi.tools.photo")
    log.setLevel(logging.INFO)
    log.addHandler(decisions)
    return decisions


if __name__ == "__main__":
    sys.exit(main())
