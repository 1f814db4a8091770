"""Flags and environments that nobody means: refused in a line with exit code 2, or they work.

What stands in the output folder stays as it was wherever a command is refused.
"""

import sys
from pathlib import Path

import numpy as np

from tests.campaigns import cases
from tests.campaigns.result import Result
from tests.support.launch import run
from tests.support.small_scenes import BALL, ROOM

ROTOR = """
[[object]]
name = "rotor"
role = "scenery"
collider = true
shape = { box = [[0.1, 0.18, 0.02], [0.3, 0.22, 0.06]] }
motion = { keyframes = [{ time = "50 ms", angle = 1e18 }] }
"""
TEXT = ROOM.replace("end = 1", "end = 0.01\nframes = 2")
RADIUS = "object.ball.shape.sphere.radius=0.06"
# flags, environment, more of the scene, what is said; "" where it works
FLAGS: list[tuple[list[str], dict[str, str], str, str]] = [
    (["--threads", "1000000"], {}, "", "threads must be at most"),
    (["--threads", "0"], {}, "", "must be at least 1"),
    (["--threads", "-3"], {}, "", "must be at least 1"),
    (["--threads", "x"], {}, "", "invalid int value"),
    (["--engine", "cuda"], {"CUDA_VISIBLE_DEVICES": ""}, "", "cuda"),
    (["--engine", "numpy", "--threads", "2"], {}, "", "engine numpy"),
    (["--stop-after", "soon"], {}, "", "--stop-after"),
    (["--set", "nothing"], {}, "", "expected key=value"),
    (["--set", "time.end=nan"], {}, "", "time.end"),
    (["--resume", "--overwrite"], {}, "", "give one of them"),
    (["--change"], {}, "", "--change is for --resume"),
    (["--resume", "--change", "--set", RADIUS], {}, "", "a new run makes others"),
    (["--resume", "--change", "--set", "seed=5"], {}, "", "a new run makes others"),
    (["--pilot", "--check"], {}, "", "--pilot is for"),
    (["-o", "FILE"], {}, "", "a folder is needed"),
    (["-o", "LINK"], {}, "", "is a link to nothing"),
    (["--resume", "none.h5"], {}, "", "none.h5"),
    (["--plan"], {}, ROTOR, "are possible"),
    ([], {"LANG": "C", "PYTHONUTF8": "0"}, "", ""),
    ([], {"HOME": "/nonexistent"}, "", ""),
    ([], {"VGMPI_CONTRACTION": "?"}, "", ""),
    ([], {"TZ": "no/where"}, "", ""),
]
NAME, COUNT, SMALL = "flags", len(FLAGS), 4


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of the list, from an element that depends on the seed."""
    first = seed % len(FLAGS)

    def case(k: int, random: np.random.Generator, own: Path) -> str:
        flags, environment, more, said = FLAGS[(first + k) % len(FLAGS)]
        scene = own / "scene.toml"
        scene.write_text(TEXT + BALL + more)
        (own / "FILE").write_text("mine")
        (own / "LINK").symlink_to(own / "nothing")
        if "--change" in flags and "--resume" in flags:
            job = run([sys.executable, "-m", "vgmpi", scene, "-q", "--stop-after", "2 steps"])
            assert job.returncode == 75, job.stderr
        before = _files(own)
        words = [str(own / word) if word in ("FILE", "LINK", "none.h5") else word for word in flags]
        job = run([sys.executable, "-m", "vgmpi", scene, *words], env=environment)
        assert "Traceback" not in job.stderr, job.stderr
        if not said:
            assert job.returncode == 0, job.stderr
            return "works"
        assert job.returncode == 2 and said in job.stderr, (job.returncode, job.stderr)
        assert _files(own) == before and (own / "FILE").read_text() == "mine"
        return "refused"

    return cases.each(count, seed, folder, case)


def _files(folder: Path) -> dict[str, bytes | None]:
    """Return the contents of all files below a folder; None for what is not a file."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }
