"""Every way out of a command is an exit code, and says what a user can do."""

import logging
import subprocess
import sys

import pytest

from tests.support.launch import ROOT, run
from vgmpi.runtime import command_line


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
    @command_line.exit_code_from_exceptions
    def main():
        raise error

    assert main() == code
    err = capsys.readouterr().err
    assert said in err and bool(err) == bool(said)
    assert ("Traceback" in err and "CONTRIBUTING.md" in err) == ("report" in said)


def test_other_ends_stay_as_they_are():
    assert command_line.exit_code_from_exceptions(lambda words: len(words))(["a", "b", "c"]) == 3


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
        "from vgmpi.runtime import command_line",
        "sys.exit(command_line.exit_code_from_exceptions(lambda: print('Größe') or 0)())",
    )
    code = "\n".join(lines)
    done = run([sys.executable, "-c", code], env={"PYTHONIOENCODING": "ascii", "LANG": "C"})
    assert done.returncode == 0 and done.stdout == "Gr\\xf6\\xdfe\n" and done.stderr == ""


def test_nobody_reads_on():
    words = " ".join(str(word) for word in PLAN)
    done = run(["bash", "-c", f"{words} | head -c 5; echo ${{PIPESTATUS[0]}}"])
    assert done.stdout in ("Dam b141\n", "Dam b0\n") and done.stderr == ""


@pytest.mark.parametrize(
    "text, shown",
    [
        ("\x1b]0;owned\x07\x1b[2J", r"\x1b]0;owned\x07\x1b[2J"),
        ("a\x9b31mb\x7f\0", r"a\x9b31mb\x7f\x00"),
        ("safe\roverwritten", r"safe\roverwritten"),
        ("\u202egnp.exe\u2066", r"\u202egnp.exe\u2066"),
        ("Größe 水 🦆\tcm\r\nnext", "Größe 水 🦆\tcm\r\nnext"),
        ("\r 50%", "\r 50%"),  # a progress bar
    ],
)
def test_no_text_from_a_file_is_an_order_to_the_terminal(text, shown, capsys):
    @command_line.exit_code_from_exceptions
    def main():
        handler = logging.StreamHandler()
        log = logging.getLogger("vgmpi.test")
        log.addHandler(handler)
        print(text)
        sys.stdout.writelines([text, "\n"])
        log.warning("%s", text)
        log.removeHandler(handler)
        raise ValueError(text)

    before = sys.stdout, sys.stderr
    assert main() == 1
    assert (sys.stdout, sys.stderr) == before
    out, err = capsys.readouterr()
    assert out == f"{shown}\n" * 2 and err.startswith(f"{shown}\n")
    assert "\x1b" not in err and "\u202e" not in err and "\x9b" not in err


def test_words_of_a_mesh_are_escaped(tmp_path):
    """Anybody may have written its file."""
    mesh = tmp_path / "a.obj"
    mesh.write_text("mtllib \x1b[31m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 \x1b[2J\n")
    done = run([sys.executable, "-m", "vgmpi", "inspect", mesh])
    assert done.returncode == 2 and "\x1b" not in done.stdout + done.stderr
    assert str(mesh) in done.stderr
