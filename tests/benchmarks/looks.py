"""What pictures of the studio are held to, measured on finished runs.

    python -m tests.benchmarks.looks flicker splash RUN         what changes though nothing but a
    little moves
    python -m tests.benchmarks.looks cost splash RUN            processor time and memory of a
    picture
    python -m tests.benchmarks.looks steps splash RUN -o a.jpg  what a picture is made of, side by
    side

Flicker: the particles go on with their velocity for 0 to 0.2 ms; the rms of the second difference
of the three pictures over the pixels that change [levels of 255], and as part of the change.
"""

import argparse
import resource
import time
from pathlib import Path

import numpy as np

from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer

SIZE = {"width": 960, "height": 640}
LENS = {"fov": 34, "azimuth": 25}
CAMERAS = {
    "splash": {
        "target": (0.48, 0.24, 0.15), "distance": 1.62, "height": 0.62, "fov": 36, "azimuth": 18,
    },
    "snowball": {"target": (0.38, 0.22, 0.14), "distance": 1.15, "height": 0.40, **LENS},
    "castle_falls": {"target": (0.44, 0.36, 0.1), "distance": 1.3, "height": 0.48, **LENS},
}  # fmt: skip
FRAMES = {"splash": 8, "snowball": 4, "castle_falls": 7}
STEP = 1e-4  # s between the pictures of a flicker
CHANGES = 1.5  # levels


def painter(name: str, run: str, **tables) -> FrameRenderer:
    """A painter with the scene's camera; tables: of render.toml."""
    tables["picture"] = {**SIZE, **tables.get("picture", {})}
    chosen = render_config.Settings.model_validate({"camera": CAMERAS[name], **tables})
    return FrameRenderer(RunReader(run), chosen, Path("."))


def moments(one: FrameRenderer, frame: int) -> np.ndarray:
    """Three pictures of particles that go on for a moment, before they are rounded to bytes."""
    load, out = one.look.frame, []
    for k in range(3):

        def later(index, k=k):
            now = load(index)
            x = np.asarray(now["positions"], dtype=np.float64)
            return {
                **now,
                "positions": x + k * STEP * np.asarray(now["velocity"], dtype=np.float64),
            }

        one.look.frame = later
        out.append(255 * one.pixels_of(frame, 0.0)[0][0].astype(np.float64))
    one.look.frame = load
    return np.array(out)


def flicker(name: str, run: str) -> None:
    """Print the flicker of a scene's picture."""
    a = moments(painter(name, run), FRAMES[name])
    second, change = a[0] - 2 * a[1] + a[2], a[2] - a[0]
    where = (np.abs(change).max(axis=-1) > CHANGES) | (np.abs(second).max(axis=-1) > CHANGES)
    rms = np.sqrt((second[where] ** 2).mean())
    part = rms / np.sqrt((change[where] ** 2).mean())
    print(
        f"{name}: {rms:.2f} levels, {part:.2f} of the change, in {100 * where.mean():.1f} % of it"
    )


def cost(name: str, run: str) -> None:
    """Print processor time of a picture, the least of three, and the most memory."""
    for label, edges, longest in (
        ("one sample", 1, None),
        ("edges refined", 3, None),
        ("preview", 1, 400),
    ):
        tables = {"picture": {**SIZE, "edge_samples": edges}}
        chosen = render_config.Settings.model_validate({"camera": CAMERAS[name], **tables})
        one = FrameRenderer(RunReader(run), chosen, Path("."), longest=longest)
        one.draw(FRAMES[name])
        took = []
        for _ in range(3):
            one.studio.foam_sources.clear()  # of foam: as in a process of its own
            begin = time.process_time()
            one.draw(FRAMES[name])
            took.append(time.process_time() - begin)
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(f"{name}, {label}: {min(took):.2f} s of a processor, {most:.2f} GiB at most")


def steps(name: str, run: str, to: str) -> None:
    """Write what a picture is made of: albedo, normals, light without the liquid, the picture."""
    import imageio.v3 as iio

    from vgmpi.postprocess.studio import tone_mapping

    one, kept = painter(name, run), {}
    paint, composed = one.studio._paint, one.studio._composed

    def painted(*arguments):
        kept["painted"] = paint(*arguments)
        return kept["painted"]

    def drawn(stage, *rest):
        kept["light"] = stage.buffers.light.copy()
        return composed(stage, *rest)

    one.studio._paint, one.studio._composed = painted, drawn
    picture = one.draw(FRAMES[name])
    albedo, normal, _, left = kept["painted"]
    light = np.empty(kept["light"].shape)
    tone_mapping.show(kept["light"], 1, light)
    shown = np.empty(light.shape)
    tone_mapping.show(albedo, 0, shown)
    parts = [shown + left[..., None], normal + left[..., None], light]
    small = [np.clip(255 * part[::4, ::4], 0, 255).astype(np.uint8) for part in parts]
    iio.imwrite(to, np.hstack([*small, picture[::2, ::2]]), quality=88)


def main() -> None:
    """Command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    p.add_argument("what", choices=("flicker", "cost", "steps"))
    p.add_argument("scene", choices=sorted(CAMERAS))
    p.add_argument("run", help="folder of the finished run")
    p.add_argument("-o", "--output", default="steps.jpg", help="of steps [steps.jpg]")
    chosen = p.parse_args()
    if chosen.what == "steps":
        steps(chosen.scene, chosen.run, chosen.output)
        return
    {"flicker": flicker, "cost": cost}[chosen.what](chosen.scene, chosen.run)


if __name__ == "__main__":
    main()
