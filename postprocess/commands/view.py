"""Field view of a run: vgmpi view OUT --frame 25 --color J -o a.png

Particles are colored by any field and drawn with pyvista, off screen. Exit code 2 is for errors
that the user can correct, with one line.
"""

import argparse
import os
import sys
from pathlib import Path

import numpy as np

from vgmpi.gaussians.camera import fit_orbit_to_box, orbit_eye
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.runtime.command_line import ArgumentParser, exit_code_from_exceptions, usage_error_code

from ..frames import image_io
from ..frames.field_values import scalars, title

FOV = 30.0  # [degrees] vertical field of view
ANGLE = 25.0  # [degrees] around z, equal to that of the renderer


def picture(run: RunReader, index: int, color: str, path: Path, args: argparse.Namespace) -> None:
    """Draw one frame into a PNG file.

    Args:
        run: Files of the run.
        index: Number of the frame.
        color: Field to color by.
        path: File to write.
        args: Arguments of the command line: range, size, angle, point.
    """
    import pyvista as pv  # the import takes a second, and --help does without

    if "DISPLAY" not in os.environ:  # VTK would complain before it falls back to drawing off screen
        pv.vtk_verbosity("off")
    frame = run.frame(index)
    x = np.ascontiguousarray(frame["positions"], dtype=np.float32)
    if not len(x):
        raise RunError(f"{args.out}: frame {index} has no particles; vgmpi render draws all else")
    try:
        values = scalars(frame, color)
    except RunError as error:
        raise RunError(f"--color: {error}") from None
    size = run.scene.get("domain", {}).get("size")
    lower, upper = (np.zeros(3), np.array(size)) if size else (x.min(0), x.max(0))
    plotter = pv.Plotter(off_screen=True, window_size=args.size)
    plotter.set_background("white")  # type: ignore[arg-type]  # its decorator hides self
    plotter.add_mesh(
        pv.PolyData(x),
        scalars=values,
        clim=args.range,
        cmap="viridis",
        point_size=args.point,
        render_points_as_spheres=True,
        scalar_bar_args={
            "title": title(color) + "\n",
            "color": "black",
            "vertical": True,
            "position_x": 0.9,
            "position_y": 0.25,
            "height": 0.5,
            "width": 0.06,
        },
    )
    plotter.add_text(f"t = {run.times[index]:.4g} s", font_size=12, color="black")
    box = pv.Box((lower[0], upper[0], lower[1], upper[1], lower[2], upper[2]))
    plotter.add_mesh(box.extract_all_edges(), color="grey", line_width=2)
    target, distance, height = fit_orbit_to_box(
        lower, upper, FOV, args.size[0] / args.size[1], [args.angle]
    )
    eye = orbit_eye(target, distance, height, args.angle)
    plotter.camera.view_angle = FOV
    plotter.camera_position = [tuple(eye), tuple(target), (0.0, 0.0, 1.0)]
    plotter.reset_camera_clipping_range()
    try:
        pixels = plotter.screenshot(return_img=True)
    finally:
        plotter.close()
    image_io.write_png(path, np.asarray(pixels))


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = ArgumentParser(prog="vgmpi view", description=__doc__)
    p.add_argument("out", help="folder of the run")
    p.add_argument("--frame", type=int, default=-1, help="number of the frame [the last]")
    p.add_argument(
        "--color",
        default="velocity",
        help="field: J, velocity, velocity.z, F.0, object ... [velocity]",
    )
    p.add_argument("-o", "--output", default="view.png", help="output picture [view.png]")
    p.add_argument(
        "--range", type=float, nargs=2, metavar=("LOW", "HIGH"), help="range of the color map"
    )
    p.add_argument(
        "--size", type=int, nargs=2, default=(1000, 800), metavar=("W", "H"), help="[pixels]"
    )
    p.add_argument("--angle", type=float, default=ANGLE, help="view angle about z [degrees]")
    p.add_argument("--point", type=float, default=5.0, help="size of a particle [pixels]")
    return p


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parser().parse_args(argv)
    path = Path(args.output)
    if path.suffix != ".png":
        print(f"-o: {path}: allowed: a name that ends in .png", file=sys.stderr)
        return 2
    if not all(16 <= side <= 8192 for side in args.size) or not args.point > 0:
        print("allowed: --size 16 to 8192 pixels, --point greater than 0", file=sys.stderr)
        return 2
    try:
        run = RunReader(args.out)
        index = args.frame + len(run) if args.frame < 0 else args.frame
        if not 0 <= index < len(run):
            raise RunError(f"--frame: {args.frame}: the run has the frames 0..{len(run) - 1}")
        picture(run, index, args.color, path, args)
    except (RunError, image_io.VideoError) as error:
        print(error, file=sys.stderr)
        return usage_error_code(error)
    print(path)
    return 0
