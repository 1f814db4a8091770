"""Command `python -m vgmpi convert config.json -o scene.toml`: scenes from other programs."""

import argparse
import sys
from pathlib import Path

from vgmpi.runtime.command_line import ArgumentParser, exit_code_from_exceptions, report_file_error
from vgmpi.runtime.user_files import replace_file

WRONG = 2


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """Return the command-line arguments."""
    parser = ArgumentParser(
        prog="vgmpi convert",
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
        help="Gaussian file of a body, or a 3DGS model folder with point_cloud/; repeat for each"
        " body, in order",
    )  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace an existing scene")
    return parser.parse_args(argv)


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command and return the exit code."""
    args = arguments(argv)
    from .config_reader import ConvertError
    from .scene_converter import convert_scene

    try:
        if args.output.exists() and not args.overwrite:
            raise ConvertError([f"{args.output}: is there already: --overwrite replaces it"])
        scene, lines = convert_scene(args.config, args.gaussians, args.output.parent)
        replace_file(args.output, scene)
    except ConvertError as error:
        for line in error.lines:
            print(line, file=sys.stderr)
        return WRONG
    except OSError as error:
        return report_file_error(error, args.output)
    for line in lines:
        print(line, file=sys.stderr)
    summary = f"{len(lines)} keys are not in it or in part" if lines else "all keys are in it"
    print(f"{args.output}: written; {summary}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
