"""Every way out of a command is an exit code, and says what a user can do."""

import subprocess
import sys

import pytest

from tests.support.launch import ROOT, run
from vgmpi.runtime import exit_handler


@pytest.mark.parametrize(
    "error, code, said",
    [
        (ValueError("boom"), 1, "please report it"),
        (MemoryError("8 GiB for x"), 1, "out of memory: 8 GiB for x"),
        (OSError(28, "No space left on device"), 1, "please report it"),  # of no printing
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_what_nobody_foresaw(error, code, said, capsys):
    @exit_handler.exit_code_from_exceptions
    def main():
        raise error

    assert main() == code
    err = capsys.readouterr().err
    assert said in err and bool(err) == bool(said)
    assert ("Traceback" in err and "CONTRIBUTING.md" in err) == ("report" in said)


def test_other_ends_stay_as_they_are():
    assert exit_handler.exit_code_from_exceptions(lambda words: len(words))(["a", "b", "c"]) == 3


PLAN = (sys.executable, "-m", "vgmpi", ROOT / "runs" / "dam_break" / "scene.toml", "--plan")


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_behind_stdout(unbuffered, monkeypatch):
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [str(word) for word in PLAN], cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 1
    assert done.stderr == "vgmpi: cannot write to stdout: No space left on device\n"


def test_letters_that_the_terminal_has_not():
    lines = (
        "import sys",
        "from vgmpi.runtime import exit_handler",
        "sys.exit(exit_handler.exit_code_from_exceptions(lambda: print('Größe') or 0)())",
    )
    code = "\n".join(lines)
    done = run([sys.executable, "-c", code], env={"PYTHONIOENCODING": "ascii", "LANG": "C"})
    assert done.returncode == 0 and done.stdout == "Gr\\xf6\\xdfe\n" and done.stderr == ""


def test_nobody_reads_on():
    words = " ".join(str(word) for word in PLAN)
    done = run(["bash", "-c", f"{words} | head -c 5; echo ${{PIPESTATUS[0]}}"])
    assert done.stdout in ("Dam b141\n", "Dam b0\n") and done.stderr == ""
