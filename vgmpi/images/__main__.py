"""`python -m vgmpi.images photo.jpg layout.toml -o runs/mine`: a scene out of a photograph."""

import argparse
import logging
import sys
from pathlib import Path

from ..ends import guarded

WRONG = 2


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """The flags."""
    parser = argparse.ArgumentParser(
        prog="python -m vgmpi.images",
        description="Objects in a photograph become Gaussians and a scene in which they stand as"
        " they do in the photograph. Every guess is written into the layout, where it can be"
        " changed; docs/pictures.md.",
        epilog="exit codes: 0 done, 1 unexpected error, 2 something in the layout, the pictures or"
        " the flags is wrong, 130 interrupted",
    )
    parser.add_argument("photo", type=Path, help="the photograph")
    parser.add_argument(
        "layout", type=Path, nargs="?", help="what is where in it (TOML); with --find it is made"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="where the scene goes"
    )
    parser.add_argument(
        "--find", action="store_true",
        help="propose a layout with boxes of what may be objects, and stop there",
    )  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace a scene that was changed")
    return parser.parse_args(argv)


@guarded
def main(argv: list[str] | None = None) -> int:
    """The command; returns the exit code."""
    given = arguments(argv)
    from .layout import LayoutError
    from .made import make, propose
    from .masks import MaskError
    from .photograph import PhotographError

    lines = _listen()
    try:
        if given.find:
            where = propose(given.photo, given.layout, given.output)
            print(f"{where}: proposed; {given.output / 'find.png'} shows the boxes")
            print("next: names and one height in it, then the same without --find")
            return 0
        if given.layout is None:
            raise LayoutError(["no layout is given: --find proposes one"])
        make(given.photo, given.layout, given.output, given.overwrite)
    except LayoutError as error:
        for line in error.lines:
            print(line, file=sys.stderr)
        return WRONG
    except (PhotographError, MaskError) as error:
        print(error, file=sys.stderr)
        return WRONG
    except OSError as error:
        print(f"{error.filename or given.output}: {error.strerror or error}", file=sys.stderr)
        return WRONG
    finally:
        logging.getLogger("vgmpi.images").removeHandler(lines)
    out = given.output
    lines.write(out)
    print(f"{out / 'check.png'}: the photograph beside the first frame")
    print(f"next: python -m vgmpi {out / 'scene.toml'}")
    print(f"then: python -m postprocess.render {out / 'out'} {out / 'render.toml'}")
    return 0


def _listen():
    """Print what is decided, and keep it."""
    from .files import Decisions

    heard = Decisions(lambda line: print(line, flush=True))
    log = logging.getLogger("vgmpi.images")
    log.setLevel(logging.INFO)
    log.addHandler(heard)
    return heard


if __name__ == "__main__":
    sys.exit(main())
