"""Bodies of external image-to-3D programs, and their pose in the photograph.

Each program runs in an interpreter of its own and exchanges files with this one. Bodies are kept in
the output folder, so that a restart after a crash only makes the missing ones.

The pose of such a body in the photograph consists of the file axis that points up, the yaw, the
size and the place. Candidate rotations are drawn by the splatter, each where its outline fits the
box of the mask; the rotation whose outline and colors agree best is taken.
"""

import glob
import hashlib
import json
import logging
import os
import re
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vgmpi.gaussians import spherical_harmonics
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.formats.validation import GaussianFileError
from vgmpi.postprocess.raster import rasterize
from vgmpi.preprocess.placement import UP, axis_rotation
from vgmpi.runtime.death_signal import die_with_parent
from vgmpi.runtime.message_text import did_you_mean_file
from vgmpi.runtime.user_files import replace_file

from .grabcut import Box, box_of, iou
from .layout_config import BodiesTable
from .photo_camera import View

YAW_COUNT = 36  # yaw angles of the coarse search
YAW_OFFSETS = (
    0.0,
    2.5,
    -2.5,
    5.0,
    -5.0,
    7.5,
    -7.5,
    10.0,
    -10.0,
)  # [degrees] fine search about the best of them
# Both searches: pixels along the longer side of the mask in the compared pictures, and Gaussians.
COARSE, FINE = (72, 6_000), (160, 30_000)
COLOR_WEIGHT = 1.0  # [-] weight of the mean color difference, 0..1, relative to the outlines
PLACE_ITERATIONS = 6  # iterations for the place of a body
UP_AXES = ("z", "-y", "y", "-z", "x", "-x")
log = logging.getLogger("vgmpi.tools.photo")
PROGRAMS = Path(__file__).parent / "programs"
FOLDER = "bodies"  # folder of the generated bodies in the output folder
OUTPUT_TAIL = 1 << 16  # [bytes] of a program's messages that are searched, from their end
_GATED = re.compile(r"GatedRepoError|gated repo|is restricted|awaiting a review|401 Client Error")
_PAGE = re.compile(r"https://huggingface\.co/[\w.-]+/[\w.-]+")
_MISSING = re.compile(r"No module named '([\w.]+)'")
_MEMORY = re.compile(r"OutOfMemoryError|out of memory", re.IGNORECASE)


class Pose(NamedTuple):
    """Orientation of a body and its agreement with the photograph."""

    up: str  # axis of the body's file that points up
    yaw: float  # [degrees] rotation about the vertical
    iou: float  # [-] intersection over union of the outlines
    color_error: float  # [-] mean color difference inside both outlines, 0..1

    @property
    def score(self) -> float:
        """Return the agreement, larger is better."""
        return self.iou - COLOR_WEIGHT * self.color_error


class AlignedBody(NamedTuple):
    """Body about the eye, about 1 away, placed as its mask is seen, with its pose."""

    cloud: GaussianCloud
    pose: Pose


def align_to_photo(
    body: GaussianCloud,
    rgb: np.ndarray,
    mask: np.ndarray,
    view: View,
    up: str | None = None,
    yaw: float | None = None,
) -> AlignedBody:
    """Return the body in the pose in which the photograph shows it.

    Args:
        body: Gaussians in their own units and axes.
        rgb: Photograph, shape (height, width, 3) uint8.
        mask: The object, shape (height, width) bool.
        view: Camera of the photograph.
        up: Axis of the file that points up, or None to search it.
        yaw: Rotation about the vertical [degrees], or None to search it.
    """
    coarse = _trial(body, rgb, mask, view, COARSE)
    ups = UP_AXES if up is None else (up,)
    yaws = [360 * k / YAW_COUNT for k in range(YAW_COUNT)] if yaw is None else [yaw]
    pose = _best(coarse, [(axis, turn) for axis in ups for turn in yaws])
    if yaw is None:
        fine = _trial(body, rgb, mask, view, FINE)
        pose = _best(fine, [(pose.up, pose.yaw + offset) for offset in YAW_OFFSETS])
    upright = _upright(body, pose.up, pose.yaw)
    placement = _fit_box(upright.x, view, box_of(mask))
    return AlignedBody(upright.transformed(np.eye(3), float(placement[3]), placement[:3]), pose)


class Trial(NamedTuple):
    """Body and a small picture with which its rotations are compared."""

    body: GaussianCloud
    view: View
    mask: np.ndarray  # (height, width) bool
    color: np.ndarray  # (height, width, 3) in 0..1


def _trial(
    body: GaussianCloud, rgb: np.ndarray, mask: np.ndarray, view: View, size: tuple[int, int]
) -> Trial:
    """Return a trial whose mask has size[0] pixels on its longer side, with size[1] Gaussians."""
    from PIL import Image

    box = box_of(mask)
    scale = min(1.0, size[0] / max(box.right - box.left, box.bottom - box.top))
    width, height = (max(16, round(n * scale)) for n in (view.width, view.height))
    shape, mean = (width, height), Image.Resampling.BOX
    levels = Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).resize(shape, mean)
    color = np.asarray(Image.fromarray(rgb).resize(shape, mean)) / 255.0
    small = View(width, height, view.fov, view.pitch)
    return Trial(_thinned(body, size[1]), small, np.asarray(levels) > 127, color)


def _best(trial: Trial, turns: list[tuple[str, float]]) -> Pose:
    """Return the best pose among pairs of up axis and yaw [degrees]."""
    poses = [_score(trial, up, yaw % 360) for up, yaw in turns]
    return max(poses, key=lambda pose: pose.score)


def _thinned(body: GaussianCloud, max_count: int) -> GaussianCloud:
    """Select at most max_count Gaussians at random, enlarged to cover the same area."""
    if len(body) <= max_count:
        return body
    rows = np.random.default_rng(0).choice(len(body), max_count, replace=False)
    some = body.select(np.sort(rows))
    enlargement = np.sqrt(len(body) / max_count)
    return GaussianCloud(some.x, some.quat, some.scale * enlargement, some.opacity, some.sh)


def _upright(body: GaussianCloud, up: str, yaw: float) -> GaussianCloud:
    """Return the body upright, rotated, of height 1, with the middle of its base at the origin."""
    rotation = axis_rotation((0.0, 0.0, 1.0), np.radians(yaw)) @ np.asarray(UP[up], dtype=float)
    rotated = body.transformed(rotation)
    low, high = rotated.x.min(axis=0), rotated.x.max(axis=0)
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    size = 1 / max(float(high[2] - low[2]), 1e-12)
    return rotated.transformed(np.eye(3), size, -size * base)


def _fit_box(x: np.ndarray, view: View, box: Box) -> np.ndarray:
    """Return base point about the eye, 1 away, and size (4,) so that points (n, 3) fill a box."""
    ray = view.rays(np.array([(box.left + box.right) / 2, (box.top + box.bottom) / 2]))
    middle = ray / max(float(ray[1]), 0.05)
    wanted = np.array([box.right - box.left, box.bottom - box.top], dtype=np.float64)
    size = float(wanted[1] / view.focal * np.linalg.norm(middle))
    centre = (x.min(axis=0) + x.max(axis=0)) / 2
    base = middle - size * centre
    for _ in range(PLACE_ITERATIONS):
        pixels, depth = view.pixels(base + size * x)
        visible = np.isfinite(pixels).all(axis=1) & (depth > 1e-3)
        if visible.sum() < 2:
            break
        low, high = pixels[visible].min(axis=0), pixels[visible].max(axis=0)
        size *= float(wanted.sum() / max((high - low).sum(), 1e-9))
        pixels, depth = view.pixels(base + size * x)
        low, high = np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)
        offset = np.array([box.left + box.right, box.top + box.bottom]) / 2 - (low + high) / 2
        distance = float(np.nanmean(depth))
        right, down, _ = view.rotation()
        base = base + distance / view.focal * (offset[0] * right + offset[1] * down)
        base, size = base / base[1], size / base[1]
    return np.append(base, size)


def _score(trial: Trial, up: str, yaw: float) -> Pose:
    """Draw the body in one orientation and measure its agreement with the photograph."""
    upright = _upright(trial.body, up, yaw)
    placed = _fit_box(upright.x, trial.view, box_of(trial.mask))
    cloud = upright.transformed(np.eye(3), float(placed[3]), placed[:3])
    camera = trial.view.camera(np.zeros(3), near_plane=0.02)
    splats = rasterize.ProjectableGaussians(
        cloud.x, cloud.cov(), cloud.opacity, spherical_harmonics.evaluate(cloud.sh, cloud.x)
    )
    drawn, transmittance = rasterize.render(splats, camera, np.zeros(3))
    outline = transmittance < 0.5
    both = outline & trial.mask
    color_error = (
        float(np.abs(np.clip(drawn, 0, 1) - trial.color)[both].mean()) if both.any() else 1.0
    )
    return Pose(up, yaw, iou(outline, trial.mask), color_error)


class Kind(NamedTuple):
    """Known generator."""

    page: str  # address of the generator and its weights
    up: str | None  # axis of its files that points up, None if that must be searched


KINDS = {
    "triposplat": Kind("https://github.com/VAST-AI-Research/TripoSplat", None),
    "trellis": Kind("https://github.com/microsoft/TRELLIS", "-y"),
    "sam3d": Kind("https://github.com/facebookresearch/sam-3d-objects", None),
    "program": Kind("", None),
}


class GeneratorError(ValueError):
    """Error of a generator; one line.

    `key` is the key of the table [bodies] that is to blame, or "".
    """

    def __init__(self, message: str, key: str = ""):
        super().__init__(message)
        self.key = key


def make(
    name: str, crop: bytes, config: BodiesTable, layout_folder: Path, out: Path
) -> GaussianCloud:
    """Return the Gaussians that a generator makes of a picture, or made of it before.

    Args:
        name: Name of the object.
        crop: PNG of the object alone.
        config: Table [bodies] of the layout.
        layout_folder: Folder of the layout.
        out: Folder of the scene.

    Raises:
        GeneratorError: The generator fails.
        OSError: A file cannot be read or written.
    """
    script = (
        PROGRAMS / f"run_{config.method}.py"
    )  # Python searches packages in the script's folder first
    if config.method == "program":
        script = layout_folder / config.script
    if not script.is_file():
        raise GeneratorError(f"no such file{did_you_mean_file(script)}: {script}", "script")
    folder = out / FOLDER
    body, noted = folder / f"{name}.ply", folder / f"{name}.json"
    note = {
        "crop": hashlib.sha256(crop).hexdigest(),
        "script": hashlib.sha256(script.read_bytes()).hexdigest(),
        "python": config.python,
        "seed": config.seed,
    }
    if _read_note(noted) == note and body.is_file():
        try:
            cloud = registry.read(body)
            log.info("'%s': its body was made before: %s", name, body)
            return cloud
        except GaussianFileError as error:
            log.warning("'%s': made anew: %s", name, error)
    folder.mkdir(parents=True, exist_ok=True)
    for leftover in folder.glob(f".{glob.escape(name)}.*"):  # a killed start leaves these
        shutil.rmtree(leftover, ignore_errors=True)
    picture = folder / f"{name}.png"
    replace_file(picture, crop)
    log.info("'%s': %s makes its body ...", name, config.method)
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=folder) as workspace:
        output = Path(workspace) / "body.ply"
        _run(config, script, picture, output)
        try:
            cloud = registry.read(output)
        except GaussianFileError as error:
            message = str(error).replace(str(output), "what it wrote")
            raise GeneratorError(f"{config.method}: {message}") from None
        os.replace(output, body)
    replace_file(noted, json.dumps(note).encode())
    return cloud


def _read_note(path: Path) -> object:
    """Read the note of an earlier start, None if there is none."""
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None


def _run(config: BodiesTable, script: Path, picture: Path, output: Path) -> None:
    """Start the program and wait for its end.

    Raises:
        GeneratorError: The program cannot be started, fails or writes no file.
    """
    command = [config.python, str(script), "--image", str(picture), "--output", str(output)]
    command += ["--seed", str(config.seed)]
    with tempfile.TemporaryFile() as log_file:
        try:  # it would outlive a start that was killed, and fill the GPU that the next one needs
            child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log_file, stderr=log_file,
                start_new_session=True, preexec_fn=die_with_parent(signal.SIGKILL),
                env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
            )  # fmt: skip
        except OSError as error:
            hint = did_you_mean_file(Path(config.python))
            why = f"{config.python}: no interpreter: {error.strerror}{hint}"
            raise GeneratorError(why, "python") from None
        try:
            code = child.wait()
        except BaseException:  # Ctrl-C ends the program too
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
            raise
        log_file.seek(max(0, log_file.seek(0, os.SEEK_END) - OUTPUT_TAIL))
        text = log_file.read().decode("utf-8", errors="replace")
    if code:
        raise program_error(config, code, text)
    if not output.is_file():
        raise GeneratorError(f"{config.method}: it ended well, but wrote no {output.name}")


def program_error(config: BodiesTable, code: int, text: str) -> GeneratorError:
    """Return the error of a program from its exit code and its messages.

    Args:
        config: Table [bodies] of the layout.
        code: Exit code, negative for a signal.
        text: End of the program's messages.
    """
    kind = KINDS[config.method]
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    missing = _MISSING.search(text)
    if _GATED.search(text):
        page = _PAGE.search(text)
        where = page[0] if page else kind.page or "their page"
        return GeneratorError(
            f"{config.method}: its weights are gated: ask for them at {where}, then `hf auth login`"
        )
    if missing:
        where = f": install it there as {kind.page} says" if kind.page else ""
        return GeneratorError(f"{config.python}: has no package '{missing[1]}'{where}", "python")
    if _MEMORY.search(text) and code > 0:
        return GeneratorError(f"{config.method}: out of the card's memory: {lines[-1][:200]}")
    resume_hint = "; what was made stays, the next start goes on from there"
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return GeneratorError(f"{config.method}: was ended by {name}{resume_hint}")
    last = lines[-1][:300] if lines else "and said nothing"
    return GeneratorError(f"{config.method}: ended with code {code}: {last}{resume_hint}")
