"""Programs that make a body of a picture, each in an interpreter of its own.

They are given files and give a file; what they have made is kept, so that a start after a crash
makes only what is missing.
"""

import ctypes
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

from vgmpi.gaussians import files
from vgmpi.gaussians.checked import GaussianFileError
from vgmpi.gaussians.cloud import Cloud
from vgmpi.images.files import replace
from vgmpi.images.layout import BodiesTable
from vgmpi.misspelt import nearest_file

log = logging.getLogger("vgmpi.images")

PROGRAMS = Path(__file__).parent / "programs"
FOLDER = "bodies"  # of what was made, in the output's folder
TAIL = 1 << 16  # bytes of what a program says that are looked at
_GATED = re.compile(r"GatedRepoError|gated repo|is restricted|awaiting a review|401 Client Error")
_PAGE = re.compile(r"https://huggingface\.co/[\w.-]+/[\w.-]+")
_MISSING = re.compile(r"No module named '([\w.]+)'")
_MEMORY = re.compile(r"OutOfMemoryError|out of memory", re.IGNORECASE)


class Kind(NamedTuple):
    """A generator that is known. page: where it and its weights are; up: the axis of its files that
    points up, None where that is looked for."""

    page: str
    up: str | None


KINDS = {
    "triposplat": Kind("https://github.com/VAST-AI-Research/TripoSplat", None),
    "trellis": Kind("https://github.com/microsoft/TRELLIS", "-y"),
    "sam3d": Kind("https://github.com/facebookresearch/sam-3d-objects", None),
    "program": Kind("", None),
}


class GeneratorError(ValueError):
    """Why a body was not made, one line; key: of the table [bodies] that is to blame, or ""."""

    def __init__(self, said: str, key: str = ""):
        super().__init__(said)
        self.key = key


def make(name: str, crop: bytes, asked: BodiesTable, beside: Path, out: Path) -> Cloud:
    """The Gaussians that a generator makes of a picture, or has made before.

    name: of the object. crop: a PNG of the object alone. beside: folder of the layout; out: that
    of the scene. Raises GeneratorError, OSError.
    """
    script = PROGRAMS / f"by_{asked.by}.py"  # its folder comes first where packages are looked for
    if asked.by == "program":
        script = beside / asked.script
    if not script.is_file():
        raise GeneratorError(f"no such file{nearest_file(script)}: {script}", "script")
    folder = out / FOLDER
    body, noted = folder / f"{name}.ply", folder / f"{name}.json"
    note = {
        "crop": hashlib.sha256(crop).hexdigest(),
        "script": hashlib.sha256(script.read_bytes()).hexdigest(),
        "python": asked.python,
        "seed": asked.seed,
    }
    if _noted(noted) == note and body.is_file():
        try:
            cloud = files.read(body)
            log.info("'%s': its body was made before: %s", name, body)
            return cloud
        except GaussianFileError as error:
            log.warning("'%s': made anew: %s", name, error)
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.glob(f".{glob.escape(name)}.*"):  # of a start that was killed
        shutil.rmtree(left, ignore_errors=True)
    picture = folder / f"{name}.png"
    replace(picture, crop)
    log.info("'%s': %s makes its body ...", name, asked.by)
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=folder) as own:
        made = Path(own) / "body.ply"
        _run(asked, script, picture, made)
        try:
            cloud = files.read(made)
        except GaussianFileError as error:
            said = str(error).replace(str(made), "what it wrote")
            raise GeneratorError(f"{asked.by}: {said}") from None
        os.replace(made, body)
    replace(noted, json.dumps(note).encode())
    return cloud


def _noted(path: Path) -> object:
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None


def _run(asked: BodiesTable, script: Path, picture: Path, made: Path) -> None:
    """Start the program and wait for its end. Raises GeneratorError."""
    command = [asked.python, str(script), "--image", str(picture), "--output", str(made)]
    command += ["--seed", str(asked.seed)]
    with tempfile.TemporaryFile() as said:
        try:
            child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=said, stderr=said, start_new_session=True,
                preexec_fn=_ends_with_us,
                env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
            )  # fmt: skip
        except OSError as error:
            near = nearest_file(Path(asked.python))
            why = f"{asked.python}: no interpreter: {error.strerror}{near}"
            raise GeneratorError(why, "python") from None
        try:
            code = child.wait()
        except BaseException:  # Ctrl-C: nothing of it goes on
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
            raise
        said.seek(max(0, said.seek(0, os.SEEK_END) - TAIL))
        text = said.read().decode("utf-8", errors="replace")
    if code:
        raise told(asked, code, text)
    if not made.is_file():
        raise GeneratorError(f"{asked.by}: it ended well, but wrote no {made.name}")


def _ends_with_us() -> None:
    """In the child: it is killed when we are, or it would go on to fill the card that the next
    start wants (Linux)."""
    set_death_signal = 1  # PR_SET_PDEATHSIG
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(set_death_signal, int(signal.SIGKILL))


def told(asked: BodiesTable, code: int, text: str) -> GeneratorError:
    """The error for a program that ended with `code` and said `text`."""
    kind = KINDS[asked.by]
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    missing = _MISSING.search(text)
    if _GATED.search(text):
        page = _PAGE.search(text)
        where = page[0] if page else kind.page or "their page"
        return GeneratorError(
            f"{asked.by}: its weights are gated: ask for them at {where}, then `hf auth login`"
        )
    if missing:
        where = f": install it there as {kind.page} says" if kind.page else ""
        return GeneratorError(f"{asked.python}: has no package '{missing[1]}'{where}", "python")
    if _MEMORY.search(text) and code > 0:
        return GeneratorError(f"{asked.by}: out of the card's memory: {lines[-1][:200]}")
    again = "; what was made stays, the next start goes on from there"
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return GeneratorError(f"{asked.by}: was ended by {name}{again}")
    last = lines[-1][:300] if lines else "and said nothing"
    return GeneratorError(f"{asked.by}: ended with code {code}: {last}{again}")
