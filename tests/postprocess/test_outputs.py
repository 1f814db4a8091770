"""What the renderer writes: films, sequences, opacity and depth, several cameras, ranks."""

import json
import shutil
import subprocess

import imageio.v3 as iio
import numpy as np
import pytest

from tests.postprocess.test_camerafiles import as_transforms
from tests.postprocess.test_video import gradient, read
from tests.support import drawn_runs
from tests.support.launch import mpirun
from vgmpi.gaussians.camera import look_at
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames import frame_renderer, image_io

SMALL = "[picture]\nwidth = 96\nheight = 80\n"
DRAW = ("-m", "vgmpi", "render")
TWO = '[[camera]]\nname = "south"\nazimuth = 0\n[[camera]]\nname = "east"\nazimuth = 90\n'


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=4)


def draw(out, folder, text, *argv):
    """Call the command with a render.toml; it must succeed."""
    (folder / "render.toml").write_text(drawn_runs.on_paper(SMALL + text))
    assert render.main([str(out), str(folder / "render.toml"), "-q", *map(str, argv)]) == 0


@pytest.mark.parametrize("suffix", [".webm", ".gif"])
@pytest.mark.parametrize("width, height", [(64, 48), (65, 47)])
def test_other_films_hold_the_pictures_in_order(tmp_path, suffix, width, height):
    path = tmp_path / f"v{suffix}"
    pictures = [np.full((height, width, 3), 40 * k, np.uint8) for k in range(5)]
    pictures[2] = gradient(width, height)
    with image_io.Film(path, width, height, fps=10) as film:
        for picture in pictures:
            film.add(picture)
    _, got = read(path)
    assert len(got) == 5
    for picture, back in zip(pictures, got):
        assert np.abs(back[:height, :width].astype(int) - picture).mean() < 8
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


LIT = """background = "#ddeeff"
floor = { height = 0 }
[light]
"""


def test_a_floor_and_a_light_on_any_number_of_processes(out, tmp_path):
    draw(out, tmp_path, LIT, "-o", tmp_path / "one", "--depth", tmp_path / "depth")
    draw(out, tmp_path, LIT, "-o", tmp_path / "two", "--jobs", 2)
    draw(out, tmp_path, LIT.replace("[light]\n", ""), "-o", tmp_path / "plain")
    draw(out, tmp_path, "supersample = 2\n" + LIT, "-o", tmp_path / "fine")
    for k in range(4):
        one, two, plain, fine = (
            iio.imread(tmp_path / name / f"frame_0000{k}.png").astype(int)
            for name in ("one", "two", "plain", "fine")
        )
        assert (one == two).all() and np.abs(one - plain).max() > 30
        assert 0 < np.abs(one - fine).mean() < 8
        depth = np.load(tmp_path / "depth" / f"frame_0000{k}.npy")
        assert 0.5 < np.median(depth[np.isfinite(depth)]) < 5


def test_an_environment_that_is_no_picture(out, tmp_path, capsys):
    sky = '[liquid.environment]\npicture = "sky.png"\n'
    (tmp_path / "render.toml").write_text(SMALL + sky)
    assert render.main([str(out), str(tmp_path / "render.toml"), "-q"]) == 2
    assert "liquid.environment.picture: " in capsys.readouterr().err


def test_cameras_draw_as_if_they_were_alone(out, tmp_path, capsys):
    draw(out, tmp_path, TWO, "-o", tmp_path / "pictures", "--depth", tmp_path / "depth")
    said = capsys.readouterr().out.split()
    assert said == [str(tmp_path / "pictures" / name) for name in ("south", "east")]
    for name, angle in (("south", 0), ("east", 90)):
        (tmp_path / name).mkdir()
        draw(out, tmp_path / name, f"[camera]\nazimuth = {angle}\n", "-o", tmp_path / name / "p")
        for k in range(4):
            alone = iio.imread(tmp_path / name / "p" / f"frame_0000{k}.png")
            got = iio.imread(tmp_path / "pictures" / name / f"frame_0000{k}.png")
            np.testing.assert_array_equal(got, alone)
        assert len(list((tmp_path / "depth" / name).iterdir())) == 4
    a, b = (iio.imread(tmp_path / "pictures" / n / "frame_00000.png") for n in ("south", "east"))
    assert (a != b).any()


def test_shapes_are_worked_out_once_for_all_cameras(out, tmp_path, monkeypatch):
    calls = []
    whole = frame_renderer.Appearance._covariances
    monkeypatch.setattr(
        frame_renderer.Appearance,
        "_covariances",
        lambda self, *a: calls.append(1) or whole(self, *a),
    )
    draw(out, tmp_path, TWO, "-o", tmp_path / "v.mp4")
    assert len(calls) == 4
    assert sorted(p.name for p in tmp_path.glob("*.mp4")) == ["v_east.mp4", "v_south.mp4"]


def test_a_transparent_picture_over_a_color_is_the_picture_on_that_color(out, tmp_path):
    draw(out, tmp_path, 'background = "none"\n', "-o", tmp_path / "a.png")
    draw(out, tmp_path, 'background = "#204060"\n', "-o", tmp_path / "b.png")
    clear, want = iio.imread(tmp_path / "a.png"), iio.imread(tmp_path / "b.png")
    assert clear.shape == (80, 96, 4) and clear[0, 0, 3] == 0 and clear[..., 3].max() > 200
    alpha = clear[..., 3:] / 255.0
    got = clear[..., :3] * alpha + np.array([0x20, 0x40, 0x60]) * (1 - alpha)
    assert np.abs(got - want).max() < 2.0  # both are rounded


def test_a_transparent_film(out, tmp_path):
    draw(out, tmp_path, 'background = "none"\n', "-o", tmp_path / "v.webm")
    command = [read_exe(), "-v", "error", "-c:v", "libvpx-vp9", "-i", str(tmp_path / "v.webm")]
    done = subprocess.run(
        [*command, "-f", "rawvideo", "-pix_fmt", "rgba", "-"], capture_output=True, check=True
    )
    got = np.frombuffer(done.stdout, np.uint8).reshape(4, 80, 96, 4)
    assert got[0, 0, 0, 3] < 20 and got[0, ..., 3].max() > 200


def read_exe():
    import imageio_ffmpeg

    return imageio_ffmpeg.get_ffmpeg_exe()


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_films_without_transparency_say_so(out, tmp_path, suffix, capfd):
    (tmp_path / "r.toml").write_text('[picture]\nbackground = "none"\n')
    argv = [str(out), str(tmp_path / "r.toml"), "-o", str(tmp_path / f"v{suffix}")]
    assert render.main(argv) == 2
    said = capfd.readouterr().err.strip()
    assert f"{suffix} has no transparency" in said and "\n" not in said
    assert [p.name for p in tmp_path.iterdir()] == ["r.toml"]


def test_opacity_and_depth_of_the_pictures(out, tmp_path):
    more = ["--alpha", tmp_path / "alpha", "--depth", tmp_path / "depth"]
    text = 'background = "#000000"\n[camera]\nkind = "fixed"\neye = [0.5, -2, 0.85]\n'
    draw(out, tmp_path, text + "target = [0.5, 0.5, 0.85]\n", "-o", tmp_path / "p", *more)
    alpha = iio.imread(tmp_path / "alpha" / "frame_00000.png")
    depth = np.load(tmp_path / "depth" / "frame_00000.npy")
    picture = iio.imread(tmp_path / "p" / "frame_00000.png")
    assert alpha.dtype == np.uint16 and alpha.shape == depth.shape == (80, 96)
    assert alpha[0, 0] == 0 and (picture[alpha == 0] == 0).all()
    assert np.isinf(depth[0, 0]) and depth.dtype == np.float32
    assert alpha[40, 48] > 60000 and depth[40, 48] == pytest.approx(2.5, abs=0.05)  # the bar


def test_a_preview(out, tmp_path, capsys):
    draw(out, tmp_path, "", "--preview")
    assert capsys.readouterr().out.strip() == str(out / "preview.png")
    assert iio.imread(out / "preview.png").shape == (80, 96, 3)  # it is small enough already
    assert render.main([str(out), "--preview", "-q", "-o", str(tmp_path / "a.png")]) == 0
    last = iio.imread(tmp_path / "a.png")
    assert last.shape == (400, 400, 3) and (last < 200).any(axis=2).mean() > 0.1
    more = ["--preview", "-q", "--frame", "0", "-o", str(tmp_path / "b.png")]
    assert render.main([str(out), *more]) == 0
    assert (iio.imread(tmp_path / "b.png") != last).any()
    assert render.main([str(out), "--preview", "-o", "v.mp4"]) == 2


def test_a_camera_of_another_tool_sees_what_ours_sees(out, tmp_path):
    """Off-centre and with its own lens: the bar is where the pinhole formula puts it."""
    camera = look_at((0.5, -2, 0.85), (0.5, 0.5, 0.85), (0, 0, 1), 40, 128, 64)
    (tmp_path / "t.json").write_text(json.dumps(as_transforms([camera])))
    text = 'background = "#000000"\n[camera]\nkind = "transforms"\nfile = "t.json"\n'
    draw(out, tmp_path, text, "-o", tmp_path / "a.png")
    red = iio.imread(tmp_path / "a.png").astype(int)
    y, x = np.nonzero((red[..., 0] > 120) & (red[..., 1] < 60))
    # the centre of the picture is at 60, 30; the last frame's bar points at the viewer
    assert x.mean() + 0.5 == pytest.approx(60, abs=1) and y.mean() + 0.5 == pytest.approx(30, abs=1)


def test_a_wrong_camera_file_ends_with_code_2_and_one_line(out, tmp_path, capfd):
    (tmp_path / "r.toml").write_text('[camera]\nkind = "colmap"\nfolder = "none"\n')
    assert render.main([str(out), str(tmp_path / "r.toml")]) == 2
    said = capfd.readouterr().err.strip()
    assert "cameras.txt: No such file" in said and "\n" not in said


@pytest.mark.mpi
@pytest.mark.parametrize("count", [2, 3])  # 3 do not divide the 4 frames
def test_ranks_share_the_frames_without_changing_them(out, tmp_path, count):
    draw(out, tmp_path, TWO, "-o", tmp_path / "alone")
    done = mpirun(count, *DRAW, out, tmp_path / "render.toml", "-o", tmp_path / "shared", "-q")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(tmp_path / "shared" / name) for name in ("south", "east")]
    alone = sorted((tmp_path / "alone").rglob("*.png"))
    assert len(alone) == 8
    for path in alone:
        other = tmp_path / "shared" / path.relative_to(tmp_path / "alone")
        np.testing.assert_array_equal(iio.imread(other), iio.imread(path))


def drawn_by(done):
    """Lines of vgmpi's own; mpirun adds words about the exit code."""
    return [line for line in done.stderr.splitlines() if "render.toml" in line or "frame" in line]


@pytest.mark.mpi
def test_ranks_end_together_with_one_message(out, tmp_path):
    (tmp_path / "render.toml").write_text("[camera]\nfovv = 3\n")
    done = mpirun(2, *DRAW, out, tmp_path / "render.toml", "-o", tmp_path / "v.mp4")
    assert done.returncode == 2 and len(drawn_by(done)) == 1, done.stderr
    broken = tmp_path / "broken"
    shutil.copytree(out, broken)
    frame = sorted((broken / "frames").iterdir())[3]  # rank 1 meets it, in the second round
    frame.write_bytes(b"no frame")
    small = tmp_path / "small.toml"
    small.write_text(drawn_runs.on_paper(SMALL))
    done = mpirun(2, *DRAW, broken, small, "-o", tmp_path / "v.mp4", "-q")
    assert done.returncode == 2 and len(drawn_by(done)) == 1, done.stderr
    assert frame.name in done.stderr
    (tmp_path / "file").touch()  # rank 0 alone cannot write
    done = mpirun(2, *DRAW, out, small, "-o", tmp_path / "file" / "pictures", "-q")
    assert done.returncode == 2 and "Not a directory" in done.stderr, done.stderr
    assert not (tmp_path / "v.mp4").exists()


def test_the_processes_of_a_launcher_are_counted(monkeypatch):
    for name in render.LAUNCHER_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("SLURM_NTASKS", "8")  # a job's script, not one of its tasks
    assert render.ranks_of_launcher() is None


def test_a_size_that_no_launcher_set(out, tmp_path, monkeypatch):
    for name in render.LAUNCHER_VARIABLES:
        monkeypatch.setenv(name, "abc")
    assert render.ranks_of_launcher() is None
