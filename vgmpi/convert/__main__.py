"""`python -m vgmpi.convert config.json -o scene.toml`: scenes out of other programs' files."""

import argparse
import sys
from pathlib import Path

from ..ends import guarded

WRONG = 2


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """The flags."""
    parser = argparse.ArgumentParser(
        prog="python -m vgmpi.convert",
        description="A configuration of PhysGaussian or VersaGauss becomes a scene. Each key that"
        " the scene does not have is named, on stderr and at the end of the scene.",
        epilog="exit codes: 0 done, 1 unexpected error, 2 something in the file or the flags is"
        " wrong, 130 interrupted",
    )
    parser.add_argument("config", type=Path, help="configuration (JSON)")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="the scene to write (TOML)"
    )
    parser.add_argument(
        "--gaussians", type=Path, action="append", default=[], metavar="FILE",
        help="the Gaussians of the body, or a folder of Gaussian splatting that has them in"
        " point_cloud/; once for each body, in order",
    )  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace the scene if it is there")
    return parser.parse_args(argv)


@guarded
def main(argv: list[str] | None = None) -> int:
    """The command; returns the exit code."""
    given = arguments(argv)
    from .reading import ConvertError
    from .scenes import converted

    try:
        if given.output.exists() and not given.overwrite:
            raise ConvertError([f"{given.output}: is there already: --overwrite replaces it"])
        scene, lines = converted(given.config, given.gaussians, given.output.parent)
        given.output.write_text(scene, encoding="utf-8")
    except ConvertError as error:
        for line in error.lines:
            print(line, file=sys.stderr)
        return WRONG
    except OSError as error:
        print(f"{given.output}: {error.strerror or error}", file=sys.stderr)
        return WRONG
    for line in lines:
        print(line, file=sys.stderr)
    kept = f"{len(lines)} keys are not in it or in part" if lines else "all keys are in it"
    print(f"{given.output}: written; {kept}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
