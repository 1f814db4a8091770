"""Results of scenes in this program and in another checkout of it, to the bit.

Each checkout begins the same scene files with its own code and stops after some steps. What is
compared are the sha256 of all HDF5 datasets: the prepared particles, frames, and a checkpoint with
everything that a step changes.
"""

import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py

from tests.support.file_digests import digests
from tests.support.launch import ROOT, mpirun
from vgmpi.solver.run_outcome import STOPPED
from vgmpi.tools.bench.benchmark_case import BenchError


def compare_bits(
    tree: Path, scenes: list[str], steps: int, ranks: int, settings: list[str], say: Callable
) -> Iterator[str]:
    """Yield a line for each scene, and one that counts those that differ.

    Args:
        tree: Folder of the other checkout.
        scenes: Scene files, or names of folders of runs/.
        steps: Number of steps.
        ranks: Number of ranks.
        settings: "key=value" that replace values of the scenes.
        say: Called with what is going on.

    Raises:
        BenchError: If a run ends otherwise than by its limit or its end.
    """
    different = 0
    for name in scenes:
        path = Path(name) if Path(name).suffix else ROOT / "runs" / name / "scene.toml"
        with tempfile.TemporaryDirectory(prefix="vgmpi-bits-") as folder:
            found = []
            for number, checkout in enumerate((ROOT, tree.resolve())):
                say(f"{name}: {checkout}")
                out = Path(folder) / str(number)
                found.append(_datasets(checkout, path.resolve(), steps, ranks, settings, out))
        ours, theirs = found
        other = [key for key in {**ours, **theirs} if ours.get(key) != theirs.get(key)]
        different += bool(other)
        verdict = f"{len(other)} differ: {', '.join(other[:4])}" if other else "all equal"
        yield f"{name}: {len(ours)} datasets, {verdict}"
    yield f"{different} of {len(scenes)} scenes differ"


def _datasets(
    checkout: Path, scene: Path, steps: int, ranks: int, settings: list[str], out: Path
) -> dict[str, str]:
    """Return the sha256 of each dataset that the first steps of a scene leave."""
    overrides = [word for setting in settings for word in ("--set", setting)]
    job = mpirun(
        ranks, "-m", "vgmpi", scene, "--stop-after", f"{steps} steps", "-o", out, *overrides,
        env={"PYTHONPATH": str(checkout)}, cwd=checkout,
    )  # fmt: skip
    if job.returncode not in (0, STOPPED):
        lines = (job.stderr + job.stdout).strip().splitlines() or [f"exit code {job.returncode}"]
        raise BenchError(f"{checkout}, {scene}: {lines[-1]}")
    return {
        name: _content(out, name) if name.endswith((":attrs", ":scene")) else value
        for name, value in digests(out).items()
        if ":" in name and not name.endswith(":crc")  # of the texts, too
    }


def _content(out: Path, name: str) -> str:
    """Return what a file says, in one order: no versions, no report, no empty lists of a scene.

    Args:
        out: Folder of the run.
        name: File and dataset, with a colon between.
    """
    path, dataset = name.split(":")
    with h5py.File(out / path) as file:
        value = json.loads(file[dataset][()])
    for key in ("versions", "plan_report"):
        value.pop(key, None)
    for table in (value, value.get("scene")):
        if isinstance(table, dict):
            for key in [key for key, rows in table.items() if rows == []]:
                del table[key]
    return json.dumps(value, sort_keys=True)
