"""A run of a second with every kind of file, to which campaigns do things: begun and continued in
this process, and compared file by file with one that nothing happened to."""

import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from tests.support import small_scenes
from tests.support.damaged_files import PROBE
from tests.support.file_digests import files
from vgmpi.io import checkpoint, csv_log, file_layout
from vgmpi.io.run_reader import RunReader, inspect
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.scene.loader import load
from vgmpi.solver import run as runs

FRAMES, EVERY = 9, 10  # steps between checkpoints, of about 110
SCENE = f"""
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.24, 0.16, 0.16]
cell = 0.02
[time]
end = 0.04
frames = {FRAMES}
[material.water]
kind = "fluid"
tait_coefficient = 5e4
[material.rubber]
kind = "elastic"
density = 700
youngs_modulus = 2e5
[[object]]
name = "pool"
material = "water"
shape = {{ box = [[0, 0, 0], [0.1, 0.16, 0.06]] }}
velocity = [1, 0, 0]
[[object]]
name = "ball"
material = "rubber"
shape = {{ sphere = {{ center = [0.14, 0.08, 0.08], radius = 0.04 }} }}
velocity = [-1, 0, 0]
[[probe]]
name = "tap"
velocity = [0.08, 0.08, 0.04]
sampling_interval = "4 ms"
[output]
checkpoint_interval_steps = {EVERY}
"""
TABLES = {file_layout.LEDGER: file_layout.LEDGER_COLUMNS, "probe_tap.csv": PROBE}

logging.getLogger("vgmpi").addHandler(logging.NullHandler())  # nothing of it belongs on the screen


def go(scene: Path, out: Path, resume: bool = False, stop_steps: int = 0) -> int:
    """Run on one rank in this process; returns the exit code. What lies in `out` is gone on with,
    or replaced."""
    options = runs.Options(out, resume="" if resume else None, stop_steps=stop_steps)
    options.overwrite = not resume
    with runs.prepared_run(load(scene), SerialCommunicator(), options) as run:
        return run.run()


@contextmanager
def undisturbed() -> Iterator[tuple[Path, dict[str, bytes]]]:
    """(the scene's file, every file of its run). Compiles what is not compiled yet."""
    with tempfile.TemporaryDirectory() as folder:
        scene = small_scenes.write(Path(folder), SCENE)
        assert go(scene, scene.parent / "out") == runs.DONE
        yield scene, files(scene.parent / "out")


def manifests(out: Path) -> list[Path]:
    """Of the checkpoints that are said to be whole, the newest last."""
    return sorted((out / file_layout.CHECKPOINTS).glob("*.json"))


def check(out: Path) -> None:
    """All files that lie there under their own names are whole, and no checkpoint was lost. Raises
    what names the one that is not."""
    for path in manifests(out):
        checkpoint.verify(path.with_suffix(".h5"))
    for name, columns in TABLES.items():
        if (out / name).exists():
            csv_log.read_rows(out / name, columns)
    said = [inspect(path) for path in out.glob("frames/*.vtkhdf")]
    for name in (file_layout.GAUSSIANS, file_layout.SERIES):
        if (out / name).exists():
            said.append(inspect(out / name))
    assert not any("NOT VALID" in text for text in said), said
    if any(out.glob("frames/*.vtkhdf")):
        run = RunReader(out)
        assert sorted(run.frames) == list(range(len(run))), "a frame is missing between others"
        with h5py.File(run.path(-1 % len(run))) as f:
            step = int(f["VTKHDF/FieldData/step"][0])
        kept = [int(path.stem.rpartition("_")[2]) for path in manifests(out)]
        due = max(step - 1, 0) // EVERY * EVERY  # at the frame's own step it comes after the frame
        assert max(kept, default=0) >= due, f"checkpoints {kept} at step {step}: one was lost"


def ends_the_same(scene: Path, out: Path, want: dict[str, bytes], stopped: bool = False) -> str:
    """Go on from the newest checkpoint, or anew where there is none; "resumed" or "begun anew".
    Raises AssertionError where a file is not that of a run that nothing happened to. The checkpoint
    of a run that was `stopped` between two others takes the place of the older one."""
    resume = bool(manifests(out))
    assert go(scene, out, resume) == runs.DONE
    wrong = different(out, want)
    if stopped:
        newest = max(name for name in want if name.startswith(file_layout.CHECKPOINTS))
        of_end = newest.rpartition(".")[0]
        wrong = [
            name
            for name in wrong
            if not name.startswith(file_layout.CHECKPOINTS) or name.startswith(of_end)
        ]
    assert wrong == []
    return "resumed" if resume else "begun anew"


def different(out: Path, want: dict[str, bytes]) -> list[str]:
    """Names of files that are not as wanted: missing, more, or of other bytes."""
    found = files(out)
    return sorted(name for name in found | want if found.get(name) != want.get(name))
