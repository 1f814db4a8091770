"""Doubts about values: files that hold sizes, opacities or coordinates other than the format says.

Clouds of known kinds are written as their format says and as other programs do; the first must give
no doubt at any size, the second the one that names the columns."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.gaussian_files import columns, compressed, splat, table
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry

GUITAR = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "guitar.compressed.ply"
UNITS = [1e-3, 1e-2, 0.1, 1.0, 10.0, 1e3, 1e5]  # [m] from millimeters to hundreds of kilometers


def capture(unit=1.0, n=3000, cover=1.0, offset=(0, 0, 0), seed=0):
    """Discs on a sphere of `unit` radius like those of a capture."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(n, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    sizes = np.exp(rng.normal(0, 0.7, (n, 3))) * [1, 1, 0.2] * cover * np.sqrt(4 / n)
    logits = rng.normal(0.5, 2.5, n)
    return unit * d + np.asarray(offset), unit * sizes, 1 / (1 + np.exp(-logits))


def of(tmp_path, x, scale, opacity, types="float", suffix=".ply"):
    """The doubts about a file with these numbers in its columns."""
    some = {axis: (types, x[:, k].tolist()) for k, axis in enumerate("xyz")}
    some |= {f"scale_{k}": ("float", scale[:, k].tolist()) for k in range(3)}
    some |= {"opacity": ("float", opacity.tolist())}
    path = tmp_path / f"cloud{suffix}"
    path.write_bytes(table(columns(n=len(x), **some)))
    return registry.read(path).record.doubts


def logit(opacity):
    return np.log(opacity / (1 - opacity))


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("cover", [0.3, 1.0, 3.0])
def test_no_doubt_about_captures_of_any_size(tmp_path, unit, cover):
    x, scale, opacity = capture(unit, cover=cover)
    assert of(tmp_path, x, np.log(scale), logit(opacity)) == ()


@pytest.mark.parametrize("unit", [0.01, 0.1, 1.0])
def test_sizes_in_place_of_logarithms(tmp_path, unit):
    x, scale, opacity = capture(unit)
    (doubt,) = of(tmp_path, x, scale, logit(opacity))
    assert doubt.startswith("scale_0..2 look like lengths, not logarithms") and "\n" not in doubt


def test_opacities_in_place_of_logits(tmp_path):
    x, scale, opacity = capture()
    (doubt,) = of(tmp_path, x, np.log(scale), opacity)
    assert doubt == "opacity looks like opacities, not logits: all values lie in 0..1"
    assert len(of(tmp_path, x, scale, opacity)) == 2


@pytest.mark.parametrize("value", [0.02, 0.3, 0.5, 0.55, 0.625, 0.7, 0.72, 0.95, 0.99])
def test_one_opacity_for_all(tmp_path, value):
    """Made by a program: as round opacity or as logit of one, which is no round number."""
    x, scale, _ = capture()
    same = np.full(len(x), value)
    assert of(tmp_path, x, np.log(scale), logit(same)) == ()
    assert len(of(tmp_path, x, np.log(scale), same)) == 1


def test_one_opacity_of_1_for_all(tmp_path):
    x, scale, _ = capture()
    assert len(of(tmp_path, x, np.log(scale), np.ones(len(x)))) == 1


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("opacity", [0.02, 0.6, 0.65])
def test_no_doubt_about_what_a_run_exports(tmp_path, unit, opacity):
    """Balls of one size in a lattice, half of their distance wide."""
    x = unit * np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3)
    n = len(x)
    cloud = GaussianCloud(
        x, np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 0.5 * unit), np.full(n, opacity),
        np.zeros((n, 1, 3)),
    )  # fmt: skip
    for suffix in (".ply", ".splat"):
        registry.write(tmp_path / f"c{suffix}", cloud)
        assert registry.read(tmp_path / f"c{suffix}").record.doubts == ()


def test_coordinates_of_a_map_in_single_precision(tmp_path):
    """Steps of float32 are 1/32 m at 512 km and 1/2 m at 5403 km; the sizes are below 4 cm."""
    offset = np.array([512345.25, 5403210.5, 310.0])
    x, scale, opacity = capture(0.5, offset=offset)
    (doubt,) = of(tmp_path, x, np.log(scale), logit(opacity))
    assert doubt.startswith("x, y are too coarse for the sizes of the Gaussians")
    assert of(tmp_path, x, np.log(scale), logit(opacity), types="double") == ()
    rounded = x.astype(np.float32).astype(np.float64)  # single precision on the way
    assert len(of(tmp_path, rounded, np.log(scale), logit(opacity), types="double")) == 1


def test_colors_of_floating_point_numbers_above_1(tmp_path):
    some = {name: ("float", [255.0, 128.0, 200.0]) for name in ("red", "green", "blue")}
    path = tmp_path / "cloud.ply"
    path.write_bytes(table(columns(f_dc_0=None, f_dc_1=None, f_dc_2=None, **some)))
    assert registry.read(path).record.doubts == (
        "red, green, blue are floating-point numbers, but most are above 1",
    )


def test_the_record_of_a_splat(tmp_path):
    path = tmp_path / "cloud.splat"
    rows = [((5e6, k, 0), (0.01,) * 3, (9, 9, 9, 255), (255, 128, 128, 128)) for k in range(3)]
    path.write_bytes(splat(rows))
    record = registry.read(path).record
    assert record.encoding == ".splat"
    assert [doubt[:14] for doubt in record.doubts] == ["x are too coar"]


def test_the_values_are_taken_as_the_format_says(tmp_path):
    x, scale, opacity = capture()
    of(tmp_path, x, scale, opacity)
    cloud = registry.read(tmp_path / "cloud.ply")
    np.testing.assert_allclose(cloud.scale, np.exp(scale), rtol=1e-6)
    np.testing.assert_allclose(cloud.opacity, 1 / (1 + np.exp(-opacity)), rtol=1e-6)


@pytest.mark.parametrize("rest", [0, 9])
@pytest.mark.parametrize("writer", ["Generated by GaussForge", "Generated by SuperSplat 2.7.1"])
def test_colors_that_gaussforge_packed_are_doubted(tmp_path, writer, rest):
    """It writes them in an order that no program reads; findings/splat_converters.sh."""
    rng, n = np.random.default_rng(0), 20
    higher = rng.integers(0, 256, (n, rest)) if rest else None
    data = compressed(
        rng.normal(size=(n, 3)), rng.normal(size=(n, 4)), rng.normal(-3, 1, (n, 3)),
        rng.random((n, 3)), rng.random(n), higher,
    )  # fmt: skip
    path = tmp_path / "a.ply"
    path.write_bytes(data.replace(b"made by a test", writer.encode(), 1))
    record = registry.read(path).record
    assert record.comments == (writer,)
    expected = rest > 0 and "GaussForge" in writer
    assert ["in a wrong order: gaussforge" in doubt for doubt in record.doubts] == [True] * expected


@pytest.mark.data
def test_a_real_capture_and_what_other_programs_make_of_it(tmp_path):
    if not GUITAR.exists():
        pytest.skip(f"{GUITAR} is not here")
    guitar = registry.read(GUITAR)
    assert guitar.record.doubts == ()
    registry.write(tmp_path / "c.ply", guitar)
    assert registry.read(tmp_path / "c.ply").record.doubts == ()
    logits = logit(np.clip(guitar.opacity, 1e-7, 1 - 1e-7))
    assert len(of(tmp_path, guitar.x, guitar.scale, logits)) == 1
    assert len(of(tmp_path, guitar.x, np.log(guitar.scale), guitar.opacity)) == 1
