"""Cups of a photograph: hollow, with handles, and with a liquid at its level."""

import numpy as np
import pytest
from scipy import ndimage

from tests.support import drawn_photograph
from vgmpi.tools.photo import hollow_body, layout_config, mask_to_mesh
from vgmpi.tools.photo.hollow_body import Cup
from vgmpi.tools.photo.layout_config import LayoutError
from vgmpi.tools.photo.mask_to_mesh import BodyError, Profile
from vgmpi.tools.photo.photo_camera import View

VIEW = View(480, 360, 20.0, 40.0)
RADIUS, WALL, BASE, RIM = 0.06, 0.2, -0.92, -0.79  # about the eye, whose axis is at the depth 1
TRUE = Cup(Profile(0.0, np.linspace(BASE, RIM, 200), np.full(200, RADIUS)), WALL * RADIUS)


def outline(profile):
    """The pixels of a solid body of revolution."""
    discs = [hollow_body._disc(profile, k, VIEW) for k in range(len(profile.heights))]
    return np.logical_or.reduce(discs)


def volume(mesh):
    a, b, c = np.moveaxis(mesh.corners(), 1, 0)
    return abs(float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6)


def is_closed(mesh):
    """Whether each edge has one triangle on either side."""
    edges = np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    there = {tuple(edge) for edge in edges}
    return len(there) == len(edges) and all((b, a) in there for a, b in there)


def test_a_cup_is_hollow_and_closed():
    """The volume is that of a cylinder less that of its cavity, of polygons with 64 corners."""
    mesh = hollow_body.cup_surface(TRUE)
    area = 64 / 2 * np.sin(2 * np.pi / 64)
    wall, height = WALL * RADIUS, RIM - BASE
    cavity = RIM - TRUE.cavity.heights[0]
    true = area * (RADIUS**2 * height - (RADIUS - wall) ** 2 * cavity)
    assert is_closed(mesh) and volume(mesh) == pytest.approx(true, rel=1e-6)
    assert cavity == pytest.approx(height - wall, rel=0.02)


def test_a_cup_is_as_large_as_it_is_drawn():
    cup = hollow_body.cup(outline(TRUE.profile), VIEW, WALL)
    radius, heights = cup.profile.radius, cup.profile.heights
    print(f"radius {radius.max() / RADIUS:.3f}, height {np.ptp(heights) / (RIM - BASE):.3f}")
    assert radius.max() == pytest.approx(RADIUS, rel=0.03)
    assert np.ptp(heights) == pytest.approx(RIM - BASE, rel=0.05)
    assert cup.wall == pytest.approx(WALL * radius.max())


@pytest.mark.parametrize("filling", [0.5, 0.7, 0.9])
def test_the_level_of_a_liquid_is_that_of_its_surface(filling):
    cavity = TRUE.cavity
    k = int(filling * (len(cavity.heights) - 1))
    opening = hollow_body._disc(cavity, len(cavity.heights) - 1, VIEW)
    visible = hollow_body._disc(cavity, k, VIEW) & opening
    level, agreement = hollow_body.liquid_level(TRUE, visible, VIEW)
    assert abs(level - cavity.heights[k]) < 0.03 * np.ptp(cavity.heights) and agreement > 0.95
    mesh = hollow_body.liquid_surface(TRUE, level)
    gap = hollow_body.CLEARANCE * RADIUS
    radius = RADIUS * (1 - WALL) - gap
    area = 64 / 2 * np.sin(2 * np.pi / 64) * radius**2
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(area * (level - cavity.heights[0] - gap), rel=1e-6)


def test_a_liquid_that_no_level_gives_is_refused():
    mask = np.zeros((VIEW.height, VIEW.width), dtype=bool)
    mask[300:340, 20:60] = True
    with pytest.raises(BodyError, match="no level of a liquid is seen as its mask"):
        hollow_body.liquid_level(TRUE, mask, VIEW)


def test_a_wall_that_fills_the_cup_is_refused():
    flat = Profile(0.0, np.linspace(BASE, BASE + 0.03, 200), np.full(200, RADIUS))
    with pytest.raises(BodyError, match="leaves no cavity: a smaller wall"):
        hollow_body.cup(outline(flat), VIEW, 0.5)


def test_a_handle_stays_with_its_hole_and_touches_the_cup():
    body = outline(TRUE.profile)
    rows, columns = np.nonzero(body)
    y, x = np.mgrid[: VIEW.height, : VIEW.width]
    away = np.hypot(x - columns.max() - 8, y - int(rows.mean()))
    ring = (away < 28) & (away > 15)
    mask = body | ring
    ((surface, pixels),) = hollow_body.handles(TRUE, mask, VIEW)
    assert pixels == pytest.approx((ring & ~body).sum(), rel=0.15)
    places, _ = VIEW.pixels(surface.corners().mean(axis=1))
    covered = np.zeros(mask.shape, dtype=bool)
    covered[places[:, 1].astype(int), places[:, 0].astype(int)] = True
    covered = ndimage.binary_closing(covered, iterations=2)
    hole = (away < 11) & (x > columns.max() + 2)
    assert not covered[hole].any() and covered[ring & ~body].mean() > 0.7
    # its depth is that of the cup's side, not in front of it or behind
    axis = VIEW.pixels(np.array([[0.0, 1.0, (BASE + RIM) / 2]]))[1][0]
    depth = VIEW.pixels(surface.points)[1]
    assert abs(depth.mean() - axis) < RADIUS


def test_an_inflated_outline_keeps_its_hole():
    y, x = np.mgrid[: VIEW.height, : VIEW.width]
    away = np.hypot(x - 240, y - 180)
    mesh = mask_to_mesh.body((away < 90) & (away > 40), VIEW, "inflate")
    places, _ = VIEW.pixels(mesh.points[np.unique(mesh.triangles)])
    assert np.hypot(*(places - (240.5, 180.5)).T).min() > 36


CUPS = [
    ('reconstruction = "revolve"\nwall = 0.1', "wall: allowed with reconstruction = \"cup\" only"),
    ('inside = "cup"\nsupport = "floor"', "has inside and support: its cup decides its body"),
    ('inside = "cup"\nreconstruction = "inflate"', "has inside and reconstruction"),
    ('inside = "can"', "'can' is no object with reconstruction = \"cup\"; such objects: cup"),
    ('inside = "tea"', "'tea' is no object with reconstruction"),
    ('reconstruction = "cup"\nwall = 0.9', "wall"),
]  # fmt: skip


@pytest.mark.parametrize("keys, says", CUPS)
def test_wrong_keys_of_cups_are_one_line(tmp_path, keys, says):
    path = tmp_path / "layout.toml"
    head = '[[object]]\nname = "cup"\nbox = [1, 1, 90, 90]\nreconstruction = "cup"\n'
    path.write_text(f'{head}[[object]]\nname = "tea"\nbox = [9, 9, 80, 50]\n{keys}\n')
    with pytest.raises(LayoutError) as error:
        layout_config.read(path)
    (line,) = error.value.lines
    assert line.startswith(f"{path}:") and says in line


def test_the_cup_of_a_photograph_holds_its_liquid(tmp_path, monkeypatch):
    """The can of the drawn photograph, whose dark upper end is the liquid of a cup."""
    pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
    from PIL import Image

    from vgmpi.tools.photo.__main__ import main

    rgb, mask = drawn_photograph.three().rgb, drawn_photograph.three().masks[1]
    dark = ndimage.binary_opening(mask & (rgb.max(axis=-1) < 90))
    label, _ = ndimage.label(dark)
    dark = label == label[np.nonzero(dark)[0][0], np.nonzero(dark)[1][0]]
    photo, layout = drawn_photograph.put(
        tmp_path,
        f"[camera]\nfov = {drawn_photograph.VIEW.fov}\npitch = {drawn_photograph.VIEW.pitch}\n"
        '[[object]]\nname = "cup"\nmask = "cup.png"\nreconstruction = "cup"\nheight = "10 cm"\n'
        '[[object]]\nname = "tea"\nmask = "tea.png"\ninside = "cup"\n',
    )
    Image.fromarray(mask).save(tmp_path / "cup.png")
    Image.fromarray(dark).save(tmp_path / "tea.png")
    fitted, fit = [], hollow_body.cup
    monkeypatch.setattr(hollow_body, "cup", lambda *given: fitted.append(fit(*given)) or fitted[-1])
    for _ in range(2):  # the second start reads what the first has written
        fitted.clear()
        assert main([str(photo), str(layout), "-o", str(tmp_path / "out")]) == 0
        assert len(fitted) == 1  # the cup and its liquid share it
    cup, tea = (drawn_photograph.corners(tmp_path / "out", name) for name in ("cup", "tea"))
    assert (tea[0] > cup[0]).all() and (tea[1] < cup[1]).all()
    text = (tmp_path / "out" / "scene.toml").read_text()
    assert text.count('fill = "closed"') == 1
    assert "support" not in layout.read_text().split('name = "tea"')[1]
