"""The studio and what it should never be given: a clear line, or a picture without NaN."""

import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.io import file_layout, initial_state
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer

NO_TABLE = ["3", '"sun"', "true", "[1, 2]", "nan", "inf", "-1", "1e300", "[]", '[["a"]]']
NO_NUMBER = ['"many"', "nan", "inf", "-inf", "-1", "1e300", "[]", "[1, 2, 3]", "{}", "1979-05-27"]
NO_SHARE = [*NO_NUMBER, "1.0001", "-1e-9", "1e-300"]
NO_WORD = [
    "3",
    "nan",
    "-inf",
    "true",
    "[]",
    '["studio"]',
    '""',
    '"Studio"',
    '"stud"',
    "{}",
    '"a\\nb"',
]
BAD = {
    "look.preset": NO_WORD,
    "look.grains_per_particle": [*NO_NUMBER, "0", "65", "1.5", "true", '"16"'],
    "look.tear": [
        "3", '"far"', "nan", "[]", "[2]", "[2, 3, 4]", "[4, 2]", "[0.5, 3]", "[2, 21]", "[nan, 3]",
        "[2, inf]", "[-1, 3]", '["a", "b"]', "[1e300, 1e301]", "{}", "true",
    ],
    "look.dust": NO_SHARE,
    "look.foam": NO_SHARE,
    "liquid.cells_per_spacing": [*NO_NUMBER, "0.99", "4.01", "0"],
    "liquid.scattering_coefficient": [*NO_NUMBER, "-1e-9", "1e-300"],
    "liquid.clip_at_walls": [
        '"maybe"', "3", "nan", "-1", "[]", "[true]", "{}", '""', "1e300", "inf", "1979-05-27",
    ],
    "liquid.absorption_length": [*NO_NUMBER, "0", "1e-300", "-0.5"],
    "light.key": [*NO_NUMBER, "10.1", "1e-300"],
    "light.sky": [*NO_NUMBER, "10.1", "1e-300"],
    "light.width": [*NO_NUMBER, "0", "0.004", "0.51"],
    "light.cells": [*NO_NUMBER, "15", "401", "0", "16.5"],
    "light.captures": NO_SHARE,
    "picture.tone_mapping": NO_WORD,
    "picture.edge_samples": [*NO_NUMBER, "0", "9", "2.5"],
    "picture.floor.kind": NO_WORD,
    "picture.floor.tile_size": [*NO_NUMBER, "-1e-9", "1e-300"],
    "light": NO_TABLE,
    "picture.floor": NO_TABLE,
}  # fmt: skip


def load(folder, text):
    path = folder / "render.toml"
    path.write_text(text)
    return render_config.load(path)


@pytest.mark.parametrize("key", BAD)
def test_mistakes_are_one_line_each_with_file_line_and_key(tmp_path, key):
    assert len(BAD[key]) >= 10
    for value in BAD[key]:
        *table, name = key.split(".")
        text = f"# of a test\n\n[{'.'.join(table)}]\n{name} = {value}\n"
        if not table:
            text = f"# of a test\n\n\n{name} = {value}\n"
        with pytest.raises(render_config.SettingsError) as caught:
            load(tmp_path, text)
            pytest.fail(f"{key} = {value} was taken")
        for line in caught.value.lines:
            assert line.startswith(f"{tmp_path / 'render.toml'}:4: {key}"), (value, line)
            assert "\n" not in line and len(line) < 400, (value, line)
            assert "Traceback" not in line


def small(folder, chosen, index=0, eye=None, near=None, change=None):
    """The picture of 32 x 24 pixels of a frame that `change` has changed, and what it covers."""
    chosen = {key: dict(value) for key, value in chosen.items()}
    chosen["picture"] = {"width": 32, "height": 24} | chosen.get("picture", {})
    if eye is not None:
        chosen["camera"] = {"kind": "fixed", "eye": eye, "target": (0.5, 0.5, 0.3)}
    painter = FrameRenderer(
        RunReader(folder), render_config.Settings.model_validate(chosen), folder, alpha=True
    )
    if change is not None:
        painter.look.run = Changed(painter.look.run, change)
    (image, left, *_) = painter.pixels_of(index, 0.0)[0]
    assert image.shape == (24, 32, 3)
    assert np.isfinite(image).all() and np.isfinite(left).all()
    assert image.min() >= -1e-6 and image.max() <= 1 + 1e-6
    assert left.min() >= -1e-6 and left.max() <= 1 + 1e-6
    return image, left


class Changed:
    """A run's files whose frames are changed after they are read."""

    def __init__(self, run, change):
        self._run, self._change = run, change

    def __getattr__(self, name):
        return getattr(self._run, name)

    def frame(self, index):
        frame = {name: np.array(a) for name, a in self._run.frame(index).items()}
        return self._change(frame)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run"))


BOUNDS = {
    "least": {
        "look": {"grains_per_particle": 1, "tear": (1.0, 1.0), "dust": 0.0, "foam": 0.0},
        "liquid": {
            "cells_per_spacing": 1.0,
            "scattering_coefficient": 0.0,
            "absorption_length": 1e-9,
            "refractive_index": 1.0,
            "clip_at_walls": False,
        },
        "light": {"key": 0.0, "sky": 0.0, "width": 0.005, "cells": 16, "captures": 0.0},
        "picture": {"tone_mapping": "none", "edge_samples": 1, "floor": {"tile_size": 0.0}},
    },
    "most": {
        "look": {"grains_per_particle": 64, "tear": (20.0, 20.0), "dust": 1.0, "foam": 1.0},
        "liquid": {
            "cells_per_spacing": 4.0,
            "scattering_coefficient": 1e100,
            "absorption_length": 1e100,
            "refractive_index": 3.0,
        },
        "light": {"key": 10.0, "sky": 10.0, "width": 0.5, "cells": 200, "captures": 1.0},
        "picture": {
            "tone_mapping": "neutral",
            "edge_samples": 8,
            "floor": {"kind": "studio", "tile_size": 1e100},
        },
    },
    "tiny": {
        "liquid": {
            "scattering_coefficient": 1e-100,
            "absorption_length": 1e-100,
            "cells_per_spacing": 1.0,
        },
        "light": {"key": 1e-100, "sky": 1e-100, "cells": 16, "direction": (1.0, 0.0, 0.0)},
        "picture": {"floor": {"tile_size": 1e-100, "kind": "plain", "checker_size": 1e-100}},
    },
    "from below": {
        "light": {"direction": (0.0, 0.0, 1.0), "cells": 16},
        "picture": {"background": "none"},
    },
}


@pytest.mark.parametrize("name", BOUNDS)
def test_values_at_the_bounds_draw(run, name):
    small(run, BOUNDS[name], index=1)


def all_at(place):
    def change(frame):
        frame["positions"][:] = place
        return frame

    return change


def kept(rows):
    def change(frame):
        return {name: a[rows] for name, a in frame.items()}

    return change


def with_field(name, value):
    def change(frame):
        frame[name] = np.full_like(frame[name], value)
        return frame

    return change


def without(*names):
    def change(frame):
        return {name: a for name, a in frame.items() if name not in names}

    return change


def far_away(frame):
    frame["positions"][::7] += np.float32(1e6)
    frame["positions"][3::7] -= np.float32(1e6)
    return frame


CHANGES = {
    "no particles": kept(slice(0)),
    "one particle": kept(slice(1)),
    "one of a body": kept(slice(-1, None)),
    "no liquid": kept(slice(drawn_runs.WATER, None)),
    "only liquid": kept(slice(drawn_runs.WATER)),
    "all at one place": all_at([0.5, 0.5, 0.5]),
    "all in a corner": all_at([0.0, 0.0, 0.0]),
    "all far away": all_at([1e6, -1e6, 1e6]),
    "some far away": far_away,
    "velocities of NaN": with_field("velocity", np.nan),
    "infinite velocities": with_field("velocity", np.inf),
    "huge velocities": with_field("velocity", 1e30),
    "F of 0": with_field("F", 0.0),
    "no velocity": without("velocity"),
    "no J": without("J"),
    "no velocity, no J": without("velocity", "J"),
}
QUICK = {
    "liquid": {"cells_per_spacing": 1.0},
    "light": {"cells": 32},
    "picture": {"edge_samples": 2},
}


@pytest.mark.parametrize("name", CHANGES)
def test_frames_that_are_odd_are_drawn(run, name):
    small(run, QUICK, index=1, change=CHANGES[name])


@pytest.mark.parametrize("name", ["positions", "F", "J"])
def test_frames_of_no_numbers_are_told(run, name):
    with pytest.raises(RunError, match=f"frame 1 holds {name} that are not finite"):
        small(run, QUICK, index=1, change=with_field(name, np.nan))


@pytest.mark.parametrize("family", ["fluid", "sand", "snow", "solid"])
def test_all_of_one_family(tmp_path, family):
    write(tmp_path, family)
    image, left = small(tmp_path, QUICK, index=1)
    assert np.ptp(image) > 0.1


def write(folder, family=None, domain=True):
    """The run of `runs`, with another family or without a domain, its bodies as they are."""
    drawn_runs.write(folder, scene=domain)
    if family is None:
        return
    rows, objects, scenery = drawn_runs.rest_state()
    objects = [o if o["family"] is None else o | {"family": family} for o in objects]
    scene = {"domain": {"size": [1.0, 1.0, 1.0]}}
    (folder / file_layout.GAUSSIANS).unlink()
    initial_state.write(
        folder / file_layout.GAUSSIANS, SerialCommunicator(), rows, objects, scenery, scene
    )


def test_a_scene_without_a_domain(tmp_path):
    write(tmp_path, domain=False)
    small(tmp_path, QUICK)


@pytest.mark.parametrize(
    "eye",
    [
        (0.5, 0.5, 0.31),
        (0.3, 0.3, 0.2),
        (0.5, 0.4, -0.5),
        (0.5, 0.2, 1e-9),
        (1e6, 0, 1e6),
        (9, 9, 0),
    ],
    ids=["in the liquid", "on a wall", "below the ground", "on the ground", "far", "at the rim"],
)
def test_cameras_at_odd_places(run, eye):
    small(run, QUICK, eye=eye)
