"""Fits whose runs are on ranks or side by side: the same bits as in one process."""

import csv
import os
import signal

import pytest

from tests.support import launch
from tests.support.fit_scenes import FIT, SHORT, bits, command, fitted_alone, go, write_fit
from vgmpi.tools.fit.run_pool import RECORD

FEW = FIT.replace("max_runs = 40\nscan_points = 4", "max_runs = 10\nscan_points = 2")
assert FEW != FIT

pytestmark = pytest.mark.mpi


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A folder with a scene and a fit, and in it what one process alone made of them."""
    launch.on_ranks(1)  # skips where there is no mpirun
    return fitted_alone(tmp_path_factory.mktemp("ranks"), FEW)


@pytest.mark.parametrize(
    "flags", [pytest.param(("--ranks", "2"), marks=pytest.mark.slow), ("--jobs=2", "--ranks=2")]
)
def test_the_same_bits(alone, flags):
    out = alone / "".join(flags)
    done = go(alone / "scene.toml", alone / "fit.toml", out, *flags)
    assert done.returncode == 0, done.stderr
    assert bits(out) == bits(alone / "alone")


def test_a_run_that_blows_up_is_told(alone, tmp_path):
    """A stiffness at which the ball is pressed through the floor: on ranks as in one process, and
    the fit goes on with the others."""
    text = FEW.replace('["4 kPa", "400 kPa"]', '["5 Pa", "400 kPa"]')
    text = text.replace("reference/", f"{alone}/reference/")
    fast = SHORT.replace("velocity = [0, 0, -1.0]", "velocity = [0, 0, -8.0]")
    scene, file = write_fit(tmp_path, fast, text)
    found = []
    for ranks in ("1", "2"):
        done = go(scene, file, tmp_path / ranks, "--ranks", ranks)
        assert done.returncode == 0, done.stderr
        with open(tmp_path / ranks / "fit.csv") as f:
            found.append([(row["loss"], row["holdout_loss"]) for row in csv.DictReader(f)])
    assert found[0] == found[1]
    assert ("blew up", "") in found[0] and any(loss != "blew up" for loss, _ in found[0])


def has_processes(group) -> bool:
    """Whether a process group has members; one that has ended counts until it is waited for."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize(
    "flags",
    [*(pytest.param(f, marks=pytest.mark.slow) for f in ((), ("--jobs", "2"))), ("--ranks", "2")],
)
def test_ctrl_c_ends_it_and_it_goes_on(alone, flags):
    out = alone / f"stopped{''.join(flags)}"
    begun = launch.start(command(alone / "scene.toml", alone / "fit.toml", out, *flags))
    launch.until(lambda: len(list(out.glob(f"runs/*/{RECORD}"))) >= 2, "two runs")
    os.killpg(begun.pid, signal.SIGINT)  # as a terminal does, to all of them
    done = launch.finish(begun)
    assert done.returncode == 130 and "Traceback" not in done.stderr, done.stderr
    launch.until(lambda: not has_processes(begun.pid), "the end of all its processes")
    assert not (out / "fitted.toml").exists()
    again = go(alone / "scene.toml", alone / "fit.toml", out, *flags)
    assert again.returncode == 0, again.stderr
    assert bits(out) == bits(alone / "alone")
