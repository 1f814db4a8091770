"""Wrong fit files: each is refused with its line, key and what is allowed, before anything runs."""

import pytest

from tests.support.fit_scenes import BALL, FIT, reference, refused, write_fit
from vgmpi.tools.fit import __main__ as fit

KEY = "material.rubber.youngs_modulus"
TARGET = FIT[FIT.index("[target]") : FIT.index("[method]")]


def target(keys):
    return TARGET, f"[target]\n{keys}\n"


# what is replaced, by what, the line and key told, what is said
WRONG = {
    "not TOML": ("[method]", "[method", 9, "", "not valid TOML"),
    "no parameter": (FIT[: FIT.index("[target]")], "", 1, "parameter", "required key is missing"),
    "one table": ("[[parameter]]", "[parameter]", 1, "parameter", "must be"),
    "unknown table": ("[method]", "[metod]", 9, "metod", "did you mean 'method'?"),
    "unknown key": (
        "scan_points = 4", "scan_point = 4", 11, "method.scan_point", "did you mean 'scan_points'?"
    ),
    "no key": (f'key = "{KEY}"\n', "", 1, "parameter.0.key", "required key is missing: of the"),
    "key that is no key": (
        "youngs_modulus", "young_modulus", 2, "parameter.0.key", "did you mean 'youngs_modulus'?",
    ),
    "no such material": ("rubber.", "ruber.", 2, "parameter.0.key", "did you mean 'rubber'?"),
    "key of a text": (KEY, "title", 2, "parameter.0.key", "is no number of the scene"),
    "key of a list": (KEY, "domain.size", 3, "parameter.0.range.0", "the scene says"),
    "key of whole numbers": (
        f'key = "{KEY}"\nrange = ["4 kPa", "400 kPa"]\ninitial = "200 kPa"',
        'key = "time.frames"\nrange = [5, 9]', 2, "parameter.0.key",
        "cannot be looked for",
    ),
    "a key twice": (
        "[target]", f'[[parameter]]\nkey = "{KEY}"\nrange = [5e3, 1e5]\n[target]', 6,
        "parameter.1.key", "is named twice",
    ),
    "range of one": ('["4 kPa", "400 kPa"]', '["4 kPa"]', 3, "parameter.0.range", "too few values"),
    "range in metres": ('"4 kPa"', '"4 m"', 3, "parameter.0.range.0", "'m' does not measure"),
    "range of a truth": ('"4 kPa"', "true", 3, "parameter.0.range.0", "must be a number, or a"),
    "range beyond what may be": ('"4 kPa"', "-4", 3, "parameter.0.range.0", "must be > 0 Pa"),
    "range turned over": ('"4 kPa"', '"1 MPa"', 3, "parameter.0.range", "must be [low, high]"),
    "no logarithm": (
        FIT[: FIT.index("[target]")],
        '[[parameter]]\nkey = "object.ball.velocity.2"\nrange = [-1, 1]\ninitial = -1\n', 3,
        "parameter.0.range", "has no logarithm",
    ),
    "scale of another": (
        "initial =", 'scale = "perhaps"\ninitial =', 4, "parameter.0.scale", "must be one of log"
    ),
    "initial outside": (
        '"200 kPa"', '"2 MPa"', 4, "parameter.0.initial", "is not from 4000 to 400000",
    ),
    "scene's value outside": (
        'range = ["4 kPa", "400 kPa"]\ninitial = "200 kPa"', 'range = ["4 kPa", "10 kPa"]', 3,
        "parameter.0.range", "the scene's own value, 20000, is not from 4000 to 10000",
    ),
    "no target": (TARGET, "", 1, "target", "required key is missing: [target]"),
    "nothing to hold to": (*target("holdout_every = 5"), 5, "target", "give exactly one of video"),
    "two targets": (
        *target('run = "a"\ntable = "b"\nprobe = "ball"'), 5, "target", "given at once",
    ),
    "bins of a table": (
        "probe =", "density_bins = [4]\nprobe =", 5, "target", "has no density_bins"
    ),
    "no probe": ('probe = "ball"\n', "", 5, "target", "a table needs probe"),
    "no such probe": ('"ball"', '"bal"', 7, "target.probe", "did you mean 'ball'?"),
    "no such table": ("probe_ball", "probe_bal", 6, "target.table", "No such file"),
    "no such column": ('"center_z"', '"centre_z"', 8, "target.columns.0", "mean 'center_z'?"),
    "column not in the table": (
        '["center_z", "velocity_z"]', '{ center_z = "z" }', 8, "target.columns.center_z",
        "has no column 'z'; it has time, step",
    ),
    "no column of times": ("probe =", 'time = "t"\nprobe =', 7, "target.time", "no column 't'"),
    "no row": ("probe =", 'filter = { step = "no" }\nprobe =', 6, "target.table", "no row to fit"),
    "rows after the end": ("probe =", "time_scale = 60.0\nprobe =", 6, "target.table", "to 0.06 s"),
    "all held out": (
        "probe =", "holdout_every = 1\nprobe =", 5, "target", "leaves nothing to fit to",
    ),
    "no such folder": (*target('run = "referenc"'), 6, "target.run", "'reference'?"),
    "run of nothing": (
        *target('run = "reference"\nbodies = ["boll"]'), 7, "target.bodies.0", "'ball'?"
    ),
    "bins turned over": (
        *target('run = "reference"\ndensity_bins = [8, 4]'), 7, "target.density_bins",
        "larger than the one",
    ),
    "method of another": (
        "scan_points = 4", 'algorithm = "newton"', 11, "method.algorithm", "least-squares, cma",
    ),
    "too few runs": (
        "max_runs = 40", "max_runs = 5", 10, "method.max_runs", "must be 9 or more for 1",
    ),
    "step of nothing": ("scan_points = 4", "fd_step = 0", 11, "method.fd_step", "greater than 0"),
}  # fmt: skip


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """A folder with a reference run."""
    folder = tmp_path_factory.mktemp("wrong")
    reference(folder, BALL)
    return folder


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_told_by_its_line(beside, capsys, name):
    old, new, line, key, said = WRONG[name]
    assert FIT.count(old) >= 1
    file, told = refused(capsys, beside, FIT.replace(old, new, 1))
    assert told.startswith(f"{file}:{line}: {key}") and said in told, told
    assert not (beside / "fit" / "runs").exists()


@pytest.mark.parametrize(
    "table, line, said",
    [
        ("time,z\n0,0\n0.05,up\n", 3, "z: 'up' is no number"),
        ("# mm\ntime,z\n0,0\n0.05\n", 4, "1 columns, the header has 2"),
    ],
)
def test_a_wrong_table_is_told_by_its_line(beside, capsys, table, line, said):
    (beside / "a.csv").write_text(table)
    text = FIT.replace("reference/probe_ball.csv", "a.csv")
    text = text.replace('["center_z", "velocity_z"]', '{ center_z = "z" }')
    scene, file = write_fit(beside, BALL, text)
    assert fit.main([str(scene), str(file), "-o", str(beside / "fit")]) == 2
    assert capsys.readouterr().err.startswith(f"{beside / 'a.csv'}:{line}: {said}")


def test_a_damaged_table_of_a_run_is_told(beside, capsys):
    rows = (beside / "reference" / "probe_ball.csv").read_text().splitlines()
    rows[4] = rows[4].replace("0", "1", 1)
    (beside / "b.csv").write_text("\n".join(rows) + "\n")
    scene, file = write_fit(beside, BALL, FIT.replace("reference/probe_ball.csv", "b.csv"))
    assert fit.main([str(scene), str(file), "-o", str(beside / "fit")]) == 2
    assert "b.csv:5: damaged" in capsys.readouterr().err


def test_frames_of_other_times_or_another_domain_are_refused(beside, capsys):
    text = FIT.replace(TARGET, '[target]\nrun = "reference"\n')
    for old, new, said in (
        ("frames = 7", "frames = 6", "has a frame at 0.01 s, of which the scene has none"),
        ("size = [0.24, 0.24, 0.24]", "size = [0.24, 0.24, 0.28]", "another domain, 0.24 x 0.24"),
    ):
        scene, file = write_fit(beside, BALL.replace(old, new), text)
        assert fit.main([str(scene), str(file), "-o", str(beside / "fit")]) == 2
        told = capsys.readouterr().err
        assert told.startswith(f"{file}:6: target.run: ") and said in told
