"""The command line: exit codes, and the lines a user gets."""

import sys

import numpy as np
import pytest

import vgmpi
from tests.support import launch, simulated_ranks
from tests.support.launch import ROOT
from tests.support.small_scenes import MIXED, ROOM, write
from vgmpi.commands import cli, flags
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.kernels.nodal_fields import momentum
from vgmpi.runtime import process_limits
from vgmpi.solver.run_outcome import BlowUp


@pytest.fixture
def scene(tmp_path):
    return write(tmp_path, MIXED.replace("PRECISION", "single"))


def test_check_and_plan_write_nothing(scene, capsys):
    assert cli.main([str(scene), "--check"]) == 0
    assert "0 errors, 0 warnings" in capsys.readouterr().out
    assert cli.main([str(scene), "--plan", "-v"]) == 0
    said = capsys.readouterr().out
    for word in (
        "4,724 particles",
        "ball",
        "cube",
        "fluid",
        "76 bytes each: x 12, v 12, C 36, vol0 4, theta 4, id 8; once for all: density",
        "set by material 'rubber'",
    ):
        assert word in said
    assert sorted(p.name for p in scene.parent.iterdir()) == ["scene.toml"]


def test_a_title_is_one_line_that_no_terminal_obeys(scene, capsys):
    assert cli.main([str(scene), "--plan", "--set", r'title="a\u001b[31m\nb"']) == 0
    assert capsys.readouterr().out.startswith(r"a\x1b[31m\nb: 4,724 particles")


@pytest.mark.parametrize("flag", ["--check", "--plan", "--prepare", "-q"])
def test_a_wrong_scene_ends_with_2_and_writes_nothing(scene, capsys, flag):
    scene.write_text(scene.read_text().replace("cell = 0.02", 'cell = "2 kg"'))
    assert cli.main([str(scene), flag]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{scene}:6: domain.cell: ") and "'kg' does not measure a length" in line
    assert sorted(p.name for p in scene.parent.iterdir()) == ["scene.toml"]


TETRAHEDRON = "f 1 2 3\nf 1 4 2\nf 2 4 3\nf 1 3 4\n"
POST = """
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.1, 0.1, 0], [0.2, 0.2, 0.1]] }
"""
SPECK = """
[[object]]
name = "speck"
material = "clay"
shape = { sphere = { center = [0.2, 0.2, 0.2], radius = "1 mm" } }
"""
SHARELESS = SPECK.replace('"1 mm"', '"5 cm"') + (
    'volume_fraction_profile = { axis = "x", positions = [0, 1], values = [0, 0] }\n'
)


@pytest.mark.parametrize(
    "objects, says",
    [
        ("", "required table [[object]] is missing"),
        (POST, "all objects are scenery: at least one must be a body"),
        (POST + SPECK, "object.speck.shape: too small or thin: no particle fits in"),
        (SHARELESS, "leaves no particle: its values are 0 everywhere"),
    ],
)
@pytest.mark.parametrize("flag", ["--check", "--plan", "-q"])
def test_a_scene_without_particles_is_refused(tmp_path, capsys, flag, objects, says):
    """Every body has some, so that a run has a wave speed and with it a time step."""
    assert cli.main([str(write(tmp_path, ROOM + objects)), flag]) == 2
    said = capsys.readouterr().err.splitlines()
    assert all("scene.toml:" in line for line in said) and says in said[0], said
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.toml"]


def test_a_body_outside_the_domain_is_found_by_check(scene, capsys):
    assert cli.main([str(scene), "--check", "--set", "object.ball.position=[0.1, 0.12, 0.2]"]) == 2
    said = capsys.readouterr().err
    assert "outside the domain" in said and "on its side" not in said  # a shape stands as it is


def test_a_fixed_step_above_the_bound_names_the_material(scene, capsys):
    assert cli.main([str(scene), "--plan", "--set", "time.dt=1 ms"]) == 2
    line = capsys.readouterr().err
    assert "time.dt" in line and "material 'rubber'" in line and "at most" in line


@pytest.mark.parametrize(
    "item, says",
    [
        ("time.end=1e20", "1e+20 s are too many steps of 0."),
        ("time.dt=1e-90", "1e-90 s, set by time.dt; at most 4.5e+15 are possible"),
        ("time.cfl=1e-90", "set by material 'rubber'"),
        ("time.end=1e99", "set by material 'rubber'"),
        ("object.ball.velocity=[1e90, 0, 0]", "set by material 'rubber'"),
    ],
)
@pytest.mark.parametrize("flag", ["--plan", "-q"])
def test_more_steps_than_the_time_can_tell_apart(scene, capsys, flag, item, says):
    assert cli.main([str(scene), flag, "--set", item]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert ": time.end: " in line and " are too many steps of " in line and says in line
    assert sorted(p.name for p in scene.parent.iterdir()) == ["scene.toml"]


@pytest.mark.parametrize("flag", ["--plan", "-q"])
def test_a_law_beyond_single_precision(scene, capsys, flag):
    stiff = [
        "--set",
        "material.water.density=1e-30",
        "--set",
        "material.water.tait_coefficient=1e9",
    ]
    assert cli.main([str(scene), flag, *stiff]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert ": material.water: its law has numbers beyond accuracy.precision = 'single'" in line
    assert cli.main([str(scene), flag, "--set", "material.water.density=1e-90"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "material.water.density: is 1e-90 in SI units; single precision computes with" in line


def test_too_little_memory_is_refused(scene, capsys, monkeypatch):
    monkeypatch.setattr(
        process_limits, "available_memory", lambda swap=False: 1 << (30 if swap else 20)
    )
    assert cli.main([str(scene), "--plan"]) == 2
    assert "90 %" in capsys.readouterr().err
    assert cli.main([str(scene), "--plan", "--force"]) == 0


def test_prepare_makes_the_particles_alone(scene, capsys):
    assert cli.main([str(scene), "--prepare"]) == 0
    assert "4,724 particles" in capsys.readouterr().out
    assert [p.name for p in (scene.parent / "out").iterdir()] == ["gaussians.h5"]


def test_plain_numpy_has_one_thread(scene, capsys):
    assert cli.main([str(scene), "--engine", "numpy", "--threads", "2"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "--engine numpy computes on one rank and one thread; asked for 1 x 2"
    assert sorted(p.name for p in scene.parent.iterdir()) == ["scene.toml"]


def test_a_blow_up_before_the_first_step_is_one_line(tmp_path, capsys, monkeypatch):
    """A field whose `accumulator_range` is too small is found while kernels are made ready."""
    body = '[[object]]\nname = "lump"\nmaterial = "clay"\nshape = { box = [[0.1, 0.1, 0.1], '
    scene = write(tmp_path, ROOM + body + "[0.2, 0.2, 0.2]] }\n")
    full = momentum.accumulator_range
    monkeypatch.setattr(momentum, "accumulator_range", lambda plan, speed: 1e-6 * full(plan, speed))
    assert cli.main([str(scene), "-q"]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("vgmpi: blow-up: before the first step, ")
    assert "phase 'lump', near (" in line and "mass or momentum at a node is beyond" in line

    def blown(ranks):
        with pytest.raises(BlowUp, match="before the first step, .*phase 'lump'"):
            vgmpi.run(vgmpi.load(scene), ranks=ranks)

    simulated_ranks.run(2, blown)  # none waits for another


def test_resume_without_a_checkpoint(scene, capsys):
    assert cli.main([str(scene), "--resume"]) == 2
    assert "no valid checkpoint" in capsys.readouterr().err


@pytest.mark.parametrize("amount", ["0", "0 steps", "12", "ten", "5.5 steps", "-3 s", "3 days"])
def test_amounts_that_make_no_sense(scene, capsys, amount):
    with pytest.raises(SystemExit) as ended:
        cli.main([str(scene), f"--stop-after={amount}"])
    assert ended.value.code == 2
    assert "--stop-after: " in (said := capsys.readouterr().err)
    assert "500 steps" in said or "whole number" in said


@pytest.mark.parametrize(
    "text, want",
    [
        ("", (0, 0.0)),
        ("12 steps", (12, 0.0)),
        ("1 step", (1, 0.0)),
        ("90 s", (0, 90.0)),
        ("1.5 min", (0, 90.0)),
        ("2h", (0, 7200.0)),
    ],
)
def test_amounts(text, want):
    assert flags._amount(text) == want


def test_inspect(scene, capsys):
    assert cli.main(["--inspect", str(scene.parent / "none.h5")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert cli.main(["--inspect", "a" * 5000]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    cli.main([str(scene), "--prepare"])
    capsys.readouterr()
    assert cli.main(["--inspect", str(scene.parent / "out" / "gaussians.h5")]) == 0
    assert "vol0" in capsys.readouterr().out


def test_inspect_of_what_a_body_is_made_of(tmp_path, capsys):
    cloud = tmp_path / "ball.ply"
    x = np.arange(12.0).reshape(4, 3)
    ones = np.ones((4, 1))
    quat = ones * [1.0, 0, 0, 0]
    registry.write(
        cloud, GaussianCloud(x, quat, 0.1 * ones * [1, 1, 1], ones[:, 0] / 2, np.zeros((4, 1, 3)))
    )
    assert cli.main(["--inspect", str(cloud)]) == 0
    said = capsys.readouterr().out
    assert "4 Gaussians, colors of degree 0" in said and "x 0 .. 9, y 1 .. 10" in said
    mesh = tmp_path / "one.obj"
    mesh.write_text("v 0 0 0\nv 2 0 0\nv 0 3 0\nf 1 2 3\n")
    assert cli.main(["--inspect", str(mesh)]) == 0
    said = capsys.readouterr().out
    assert "a mesh of 1 triangles, 3 points\n" in said and "y 0 .. 3" in said
    cloud.write_text("ply\n")
    assert cli.main(["--inspect", str(cloud)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(cloud) in line


def test_a_misspelt_override_is_named(scene, capsys):
    assert cli.main([str(scene), "--check", "--set", "domian.cell='1 cm'"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "--set domian.cell='1 cm': domian: unknown key (did you mean 'domain'?)"
    assert cli.main([str(scene), "--check", "--set", "object.ball.materail=water"]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.endswith("unknown key (did you mean 'material'?)"), "the hint is hidden"


def test_the_scene_that_the_reference_begins_with(tmp_path, capsys):
    text = (
        (ROOT / "docs" / "reference" / "scene.md").read_text().split("```toml\n")[1].split("```")[0]
    )
    scene = write(tmp_path, text)
    assert cli.main([str(scene), "--check"]) == 2
    assert "there is no file" in capsys.readouterr().err
    x = 0.4 * np.stack(np.meshgrid(*[np.arange(8.0)] * 3), axis=-1).reshape(-1, 3)
    ones = np.ones((len(x), 1))
    quat, scale = ones * [1.0, 0, 0, 0], 0.2 * ones * [1, 1, 1]
    registry.write(
        tmp_path / "duck.ply", GaussianCloud(x, quat, scale, ones[:, 0], np.zeros((len(x), 1, 3)))
    )
    assert cli.main([str(scene), "--check"]) == 0, capsys.readouterr().err


def test_what_may_lie_on_its_side_gets_a_hint(scene, capsys):
    """A body from a file that does not say which way is up; others do not."""
    (scene.parent / "pole.obj").write_text("v 0 0 0\nv 0 3 0\nv .1 3 0\nv .1 0 .1\n" + TETRAHEDRON)
    pole = '[[object]]\nname = "pole"\nmaterial = "rubber"\nmesh = "pole.obj"\n'
    scene.write_text(scene.read_text() + pole + "position = [0.2, 0.1, 0]\n")
    assert cli.main([str(scene), "--check"]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "object.pole" in line]
    assert "outside the domain" in line and 'most captures need up = "-y"' in line
    assert cli.main([str(scene), "--check", "--set", "object.pole.up=z"]) == 2
    assert "most captures" not in capsys.readouterr().err


def test_no_escape_codes_of_numbas(monkeypatch):
    """Where colorama is installed, which other programs bring."""
    pytest.importorskip("colorama")
    monkeypatch.delenv("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", raising=False)  # set here by us
    says = "from numba.core import errors; print(errors.termcolor().errmsg('word'))"
    done = launch.run([sys.executable, "-c", f"import vgmpi; {says}"])
    assert done.stdout == "word\n", done.stderr


def test_a_wrong_material_is_told_alone(scene, capsys):
    """What depends on its kind is not told beside it."""
    flags = ["--set", "material.water.density='3 m'", "--set", "object.pool.opacity_scale=0.5"]
    assert cli.main([str(scene), "--check", *flags]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "material.water.density" in line
