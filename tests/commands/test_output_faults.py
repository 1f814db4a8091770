"""An output that cannot be written: one line that names it, and one exit code for all commands."""

import json

import pytest
from PIL import Image

from tests.support import drawn_photograph, drawn_runs, fit_scenes
from tests.support.foreign_configs import ONE
from tests.support.small_disk import small_disk
from vgmpi.commands.command_table import main as vgmpi_main
from vgmpi.runtime.command_line import exit_code_from_exceptions

command = exit_code_from_exceptions(vgmpi_main)  # as `python -m vgmpi` has it

DENIED = "/sys/vgmpi"  # nobody makes a file there, whoever runs the tests
LAYOUT = '[[object]]\nname = "ball"\nbox = {}\nheight = "10 cm"\n[scene]\nend = "0.1 s"\n'


def words_of(name, folder, out):
    """The words of a command whose output is `out`, and which has all else that it needs."""
    if name in ("run", "prepare", "fit", "tradeoff", "energy"):
        scene, fit = fit_scenes.write_fit(folder, fit_scenes.SHORT, fit_scenes.FIT)
        if name == "fit":
            fit_scenes.reference(folder, fit_scenes.SHORT)
            return [name, str(scene), str(fit), "-o", out]
        return [name, str(scene), "-o", out]
    if name == "convert":
        (folder / "config.json").write_text(json.dumps(ONE))
        return [name, str(folder / "config.json"), "-o", f"{out}.toml"]
    if name == "export":
        return [name, str(drawn_runs.write(folder / "run", frames=1)), "-o", out]
    photo = folder / "photo.png"
    Image.fromarray(drawn_photograph.three().rgb).save(photo)
    box = drawn_photograph.bounding_box(drawn_photograph.three().masks[0])
    (folder / "layout.toml").write_text(LAYOUT.format(list(map(int, box))))
    return [name, str(photo), str(folder / "layout.toml"), "-o", out]


COMMANDS = ("run", "prepare", "fit", "tradeoff", "energy", "convert", "export", "photo")


@pytest.mark.parametrize("name", COMMANDS)
def test_a_place_that_is_read_only_is_the_users_error(name, tmp_path, capfd):
    words = words_of(name, tmp_path, f"{DENIED}/out")
    capfd.readouterr()
    assert command(words) == 2
    err = capfd.readouterr().err
    assert "Traceback" not in err and DENIED in err.splitlines()[-1]


@pytest.fixture
def full_disk(tmp_path):
    """A disk of 64 kB that is full."""
    with small_disk(tmp_path / "disk", 64 << 10) as folder:
        with open(folder / "filler", "wb", buffering=0) as file:
            file.write(bytes(64 << 10))
        yield folder


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in ("tradeoff", "energy")])
def test_a_full_disk_has_one_code(name, tmp_path, full_disk, capfd):
    words = words_of(name, tmp_path, str(full_disk / "out"))
    capfd.readouterr()
    assert command(words) == 1
    err = capfd.readouterr().err
    assert "Traceback" not in err and str(full_disk) in err.splitlines()[-1]
    assert "no space left" in err.splitlines()[-1].lower()
