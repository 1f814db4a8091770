"""How fast this processor is: measured once, kept, and never mistaken."""

import json
import logging
import os
import time

import pytest

from tests.support.small_scenes import ROOM, write
from vgmpi.commands import cli
from vgmpi.planning.cost.feature_costs import group_features
from vgmpi.planning.cost.throughput import ASSUMED_THROUGHPUT, Throughput
from vgmpi.planning.plan import make_plan
from vgmpi.scene.loader import load
from vgmpi.solver.estimates import calibration

BALL = """
[[object]]
name = "ball"
material = "clay"
shape = { sphere = { center = [0.2, 0.2, 0.2], radius = 0.05 } }
"""


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """(law, precision) of every measurement, which takes no time here; an empty folder to keep."""
    found = []

    def measure(law, precision):
        found.append((law, precision))
        return {"fluid": 20.0, "elastic": 30.0}[law] + len(found)

    monkeypatch.setattr(calibration, "measure_throughput", measure)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return found


def test_it_is_measured_once(asked):
    first = calibration.host_throughput("single")
    assert first[:2] == (21.0, 32.0) and "measured on" in first.origin
    assert asked == [("fluid", "single"), ("elastic", "single")]
    assert (
        calibration.host_throughput("single") == calibration.cached_throughput("single") == first
        and len(asked) == 2
    )
    assert calibration.cached_throughput("double") is None
    assert calibration.host_throughput("double") != first and len(asked) == 4
    assert calibration.host_throughput("single", remeasure=True).fluid == 25.0 and len(asked) == 6
    assert calibration.cached_throughput("single").fluid == 25.0


def test_another_processor_is_another(asked, monkeypatch):
    calibration.host_throughput("single")
    monkeypatch.setattr(calibration, "model", lambda: "another")
    assert calibration.cached_throughput("single") is None
    assert calibration.host_throughput("single").origin.startswith("measured on another, ")


def test_another_cube_is_measured_anew(asked, monkeypatch):
    """What an earlier version measured in another way is no throughput of this one."""
    calibration.host_throughput("single")
    monkeypatch.setattr(calibration, "SCENE", calibration.SCENE + "# other")
    assert calibration.cached_throughput("single") is None


def test_a_pipe_in_place_of_the_cache_is_not_read(asked, tmp_path):
    """A reader of a pipe waits for ever; the measurement then replaces it."""
    path = calibration._path()
    path.parent.mkdir(parents=True)
    os.mkfifo(path)
    first = calibration.host_throughput("single")
    assert path.is_file() and calibration.cached_throughput("single") == first


def test_the_cube_is_timed_without_what_the_plan_adds(tmp_path):
    """Shifting and the transfer correction have prices of their own."""
    scene = load(tmp_path / "none", text=calibration.SCENE.format(
        room=0.44, precision="single", law=calibration.LAWS["fluid"]
    ))  # fmt: skip
    plan = make_plan(scene, [8], [8 * 0.005**3], False)
    assert not plan.correction_interval and not plan.features
    features = group_features(scene, plan, 0, Throughput(20.0, 30.0, "told"))
    assert [feature.name for feature in features] == ["law fluid"]


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "",
        lambda text: text[:-9],
        lambda text: "[]",
        lambda text: text.replace("21.0", "-21.0"),
        lambda text: text.replace("21.0", "NaN"),
        lambda text: text.replace("21.0", '"21"'),
        lambda text: text.replace("32.0", "1e300"),
        lambda text: text.replace('"when": "2', '"when": "\\u001b'),
        lambda text: json.dumps({key: 3 for key in json.loads(text)}),
        lambda text: "[" * 100_000,
    ],
)
def test_what_is_damaged_is_measured_again(asked, change):
    calibration.host_throughput("single")
    path = calibration._path()
    path.write_text(change(path.read_text()))
    assert calibration.cached_throughput("single") is None
    assert calibration.host_throughput("single").fluid == 23.0
    assert calibration.cached_throughput("single").fluid == 23.0


def test_where_nothing_can_be_kept_it_is_measured_each_time(asked, tmp_path):
    (tmp_path / "cache").write_text("")
    assert calibration.host_throughput("single").fluid == 21.0
    assert calibration.host_throughput("single").fluid == 23.0


def test_where_nothing_can_be_measured_it_is_assumed(asked, monkeypatch, caplog, tmp_path, capsys):
    def fails(law, precision):
        raise RuntimeError("no compiler")

    monkeypatch.setattr(calibration, "measure_throughput", fails)
    assert calibration.host_throughput("single") is ASSUMED_THROUGHPUT["single"]
    assert "cannot be measured: RuntimeError: no compiler" in caplog.text
    assert cli.main([str(write(tmp_path, ROOM + BALL)), "--plan"]) == 0
    assert "time        unknown: this processor is not measured yet" in capsys.readouterr().out


def test_compiling_is_said_before_and_is_no_measurement(monkeypatch, caplog):
    """0.4 s of it, in a measurement of some milliseconds."""
    compiled = calibration.compile_kernels
    monkeypatch.setattr(calibration, "SIDE", 6)

    def slow(plan, ranks):
        end = time.thread_time() + 0.4
        while time.thread_time() < end:
            pass
        compiled(plan, ranks)

    monkeypatch.setattr(calibration, "compile_kernels", slow)
    least = 0.4e9 / (20 * 12**3)  # in a cycle of 20 steps
    assert 1.0 < calibration.measure_throughput("fluid", "single") < 0.3 * least


def test_the_plan_measures_and_a_run_takes_what_is_kept(asked, tmp_path, capsys, caplog):
    path = str(write(tmp_path, ROOM.replace("end = 1", "end = 1e-4") + BALL))
    assert cli.main([path, "-o", str(tmp_path / "one"), "--stop-after", "1 step"]) == 75
    assert asked == [] and "unknown: this processor is not measured" in capsys.readouterr().out
    for _ in range(2):
        assert cli.main([path, "--plan"]) == 0
        assert "one core each, measured on " in capsys.readouterr().out
    assert asked == [("fluid", "double"), ("elastic", "double")]
    assert cli.main([path, "--plan", "--calibrate"]) == 0 and len(asked) == 4
    capsys.readouterr()
    assert cli.main([path, "-o", str(tmp_path / "two"), "--stop-after", "1 step"]) == 75
    assert len(asked) == 4 and "one core each, measured on " in capsys.readouterr().out


def test_calibrate_alone_measures_every_precision(asked, capsys):
    assert cli.main(["--calibrate"]) == 0
    assert [precision for _, precision in asked] == ["single"] * 2 + ["double"] * 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("single  21.0 ns per particle and step of a fluid, 32.0 elastic")
    with pytest.raises(SystemExit):
        cli.main(["--calibrate", "--plan"])


def test_a_measurement_is_announced(asked, caplog):
    with caplog.at_level(logging.INFO, "vgmpi"):
        calibration.host_throughput("single")
        (line,) = caplog.messages
        assert "measuring this processor for --plan" in line and "once the code is compiled" in line
        calibration.host_throughput("single")
        assert caplog.messages == [line]
