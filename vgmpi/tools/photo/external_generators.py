"""External image-to-3D programs, each in an interpreter of its own.

They exchange files with this program. Their bodies are kept in the output folder, so that a restart
after a crash only makes the missing ones.
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

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.formats.validation import GaussianFileError
from vgmpi.runtime.death_signal import die_with_parent
from vgmpi.runtime.message_text import did_you_mean_file
from vgmpi.runtime.user_files import replace_file

from .layout_config import BodiesTable

log = logging.getLogger("vgmpi.tools.photo")

PROGRAMS = Path(__file__).parent / "programs"
FOLDER = "bodies"  # folder of the generated bodies in the output folder
OUTPUT_TAIL = 1 << 16  # [bytes] of a program's messages that are searched, from their end
_GATED = re.compile(r"GatedRepoError|gated repo|is restricted|awaiting a review|401 Client Error")
_PAGE = re.compile(r"https://huggingface\.co/[\w.-]+/[\w.-]+")
_MISSING = re.compile(r"No module named '([\w.]+)'")
_MEMORY = re.compile(r"OutOfMemoryError|out of memory", re.IGNORECASE)


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
