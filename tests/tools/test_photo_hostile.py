"""Odd pictures and layouts: taken, or refused by lines that say where; nothing is half-written."""

import io
import os

import numpy as np
import pytest
from PIL import Image

from vgmpi.tools.photo import grabcut, photograph
from vgmpi.tools.photo.__main__ import main

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
WIDTH, HEIGHT = 160, 120
MIDDLE, RADIUS = (70, 80), 24
HEAD = "[camera]\npitch = 20\n[[object]]\n"
GOOD = HEAD + 'name = "ball"\nheight = 0.1\n'
BOX = [MIDDLE[0] - 30, MIDDLE[1] - 30, MIDDLE[0] + 30, MIDDLE[1] + 30]
BOXED = GOOD + f"box = {BOX}\n"


def disc():
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return (x - MIDDLE[0]) ** 2 + (y - MIDDLE[1]) ** 2 < RADIUS**2


def pixels():
    """A red disc on grey with some noise, (height, width, 3) uint8."""
    rgb = np.where(disc()[..., None], (200, 60, 40), (110, 120, 130))
    return (rgb + np.random.default_rng(1).integers(-6, 7, rgb.shape)).astype(np.uint8)


def saved(image, kind="png", **options):
    held = io.BytesIO()
    image.save(held, kind, **options)
    return held.getvalue()


def plain(kind="png"):
    return saved(Image.fromarray(pixels()), kind)


def turned():
    """As a camera on its side saves it: pixels lie, EXIF says how they stand."""
    exif = Image.Exif()
    exif[0x0112] = 6  # to be shown a quarter turn clockwise
    return saved(Image.fromarray(np.rot90(pixels(), 1)), "jpeg", quality=95, exif=exif)


def clear():
    return saved(Image.fromarray(np.dstack([pixels(), np.where(disc(), 255, 0).astype(np.uint8)])))


def grey16():
    levels = pixels()[..., 1].astype(np.uint16) * 257
    return saved(Image.fromarray(levels))


def bomb():
    """The head of a picture that would have 2.5 billion pixels."""
    small = bytearray(plain())
    small[16:24] = (50000).to_bytes(4, "big") * 2
    import zlib

    small[29:33] = zlib.crc32(bytes(small[12:29])).to_bytes(4, "big")
    return bytes(small)


TAKEN = {
    "jpeg": lambda: plain("jpeg"),
    "grey": lambda: saved(Image.fromarray(pixels()[..., 0])),
    "grey with alpha": lambda: saved(Image.fromarray(pixels()[..., 0]).convert("LA")),
    "16 bits": grey16,
    "palette": lambda: saved(Image.fromarray(pixels()).convert("P")),
    "two levels": lambda: saved(Image.fromarray(disc())),
    "CMYK": lambda: saved(Image.fromarray(pixels()).convert("CMYK"), "jpeg", quality=95),
    "floats": lambda: saved(Image.fromarray(pixels()[..., 0] / np.float32(255)), "tiff"),
    "turned by EXIF": turned,
    "bmp": lambda: plain("bmp"),
    "gif": lambda: saved(Image.fromarray(pixels()).convert("P"), "gif"),
}
REFUSED = {
    "no file": (None, "no such file"),
    "empty": (lambda: b"", "photo.png: "),
    "a text": (lambda: b"hello" * 100, "photo.png: "),
    "truncated png": (lambda: plain()[:9000], "photo.png: "),
    "truncated jpeg": (lambda: plain("jpeg")[:1500], "photo.png: "),
    "only a head": (lambda: plain()[:40], "photo.png: "),
    "billions of pixels": (bomb, "2500000000 pixels"),
    "one pixel": (lambda: saved(Image.new("RGB", (1, 1))), "at least 32 x 32"),
    "thin": (lambda: saved(Image.new("RGB", (3000, 8))), "at least 32 x 32"),
    "thin when small": (lambda: saved(Image.new("RGB", (6000, 40))), "too long and too thin"),
    "one color": (
        lambda: saved(Image.new("RGB", (WIDTH, HEIGHT))),
        "box: its mask is empty",
    ),
}
LAYOUTS = {
    "not TOML": ("[[object]\n", "layout.toml:1: not valid TOML"),
    "not text": ("\x00\udcff", "not UTF-8"),
    "no objects": ("[camera]\nfov = 40\n", "no object is told"),
    "object is a number": ("object = 3\n", "object: "),
    "unknown key": (BOXED + "colur = 1\n", "layout.toml:7: object.ball.colur: unknown key"),
    "box outside": (GOOD + "box = [500, 10, 600, 50]\n", "lies outside the picture"),
    "box far out": (GOOD + "box = [0, 0, 400, 50]\n", "reaches far out of the picture"),
    "box turned": (GOOD + "box = [60, 60, 20, 20]\n", "right > left"),
    "box of words": (GOOD + 'box = ["a", 1, 2, 3]\n', "must be [left, top, right, bottom]"),
    "box of nan": (GOOD + "box = [nan, 1, inf, 3]\n", "must be [left, top, right, bottom]"),
    "box of three": (GOOD + "box = [1, 2, 3]\n", "must be [left, top, right, bottom]"),
    "box of a pixel": (GOOD + "box = [50, 50, 51, 51]\n", "less than 4 pixels"),
    "box is all": (GOOD + f"box = [0, 0, {WIDTH}, {HEIGHT}]\n", "the box is the whole picture"),
    "no box": (GOOD, "ball.box: needs a box"),
    "point outside": (
        BOXED + "point_prompts = [[900, 20]]\n", "ball.point_prompts: [900, 20] lies outside"
    ),
    "point beside": (BOXED + "point_prompts = [[5, 5]]\n", "lies outside the object's own box"),
    "point of words": (
        BOXED + 'point_prompts = [["x", 5]]\n', "toml:7: object.ball.point_prompts: must be"
    ),
    "no mask": (GOOD + 'mask = "musk.png"\n', "no such file (did you mean 'mask.png'?)"),
    "mask of another size": (GOOD + 'mask = "other.png"\n', "the photograph 160 x 120"),
    "mask is empty": (GOOD + 'mask = "black.png"\n', "ball.mask: its mask is empty"),
    "mask is all": (GOOD + 'mask = "white.png"\n', "no background is left"),
    "mask is a pixel": (GOOD + 'mask = "dot.png"\n', "has 1 pixels only"),
    "mask is no picture": (GOOD + 'mask = "layout.toml"\n', "ball.mask: "),
    "one name": (BOXED + BOXED[BOXED.index("[[") :], "two objects have the name 'ball'"),
    "one name but capitals": (
        BOXED + BOXED[BOXED.index("[[") :].replace("ball", "Ball"), "two objects have the name",
    ),
    "name is a path": (HEAD + 'name = "../ball"\nbox = [1, 2, 30, 40]\n', "must begin with"),
    "name is floor": (HEAD + 'name = "floor"\nbox = [1, 2, 30, 40]\n', "no object can be called"),
    "long name": (HEAD + f'name = "{"a" * 100}"\nbox = [1, 2, 30, 40]\n', "at most 60 letters"),
    "no name": (HEAD + "box = [1, 2, 30, 40]\n", "name: required key is missing"),
    "material": (BOXED + 'material = "ruber"\n', "no such material (did you mean 'rubber'?)"),
    "support": (BOXED + 'support = "tabel"\n', "there is no object 'tabel'"),
    "holds itself": (BOXED + 'support = "ball"\n', "it holds up itself"),
    "hold each other": (
        BOXED + 'support = "b"\n[[object]]\nname = "b"\nbox = [1, 2, 30, 40]\nsupport = "ball"\n',
        "they hold up each other",
    ),
    "no height": (HEAD + f'name = "a"\nbox = {BOX}\n', "give the height of at least one object"),
    "height in seconds": (GOOD.replace("0.1", '"1 s"') + f"box = {BOX}\n", "'s' does not measure"),
    "height of nothing": (GOOD.replace("0.1", "0") + f"box = {BOX}\n", "must be >= 1e-05 m"),
    "huge height": (GOOD.replace("0.1", "1e90") + f"box = {BOX}\n", "ball.height: "),
    "above the horizon": (BOXED.replace("pitch = 20", "pitch = -30"), "seen above the horizon"),
    "two bodies": (BOXED + 'reconstruction = "inflate"\nbody = "a.ply"\n', "only one of them"),
    "many objects": (
        "".join(f'[[object]]\nname = "a{k}"\nbox = {BOX}\n' for k in range(65)), "at most 64",
    ),
    "thick": (BOXED + 'reconstruction = "extrude"\nthickness = 40\n', "ball.thickness: "),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    """Masks of all kinds beside the layout."""
    every = {
        "mask": disc(), "black": np.zeros((HEIGHT, WIDTH), bool), "dot": np.zeros((HEIGHT, WIDTH)),
        "white": np.ones((HEIGHT, WIDTH), bool), "other": np.ones((30, 40), bool),
    }  # fmt: skip
    every["dot"][5, 5] = 1
    for name, mask in every.items():
        Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(tmp_path / f"{name}.png")
    return tmp_path


def told(folder, photo, layout, capsys):
    """Exit code and lines on stderr; what was there is there as it was, and nothing else."""
    where = folder / "layout.toml"
    where.write_bytes(layout.encode("utf-8", "surrogateescape"))
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    code = main([str(photo), str(where), "-o", str(folder / "out")])
    if code:
        assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
    assert not list(folder.rglob("*.part"))
    return code, capsys.readouterr().err.splitlines()


@pytest.mark.parametrize("name", TAKEN)
def test_pictures_of_all_kinds_are_taken(folder, name, capsys):
    photo = folder / "photo.png"
    photo.write_bytes(TAKEN[name]())
    code, lines = told(folder, photo, BOXED, capsys)
    assert code == 0, lines
    found = np.asarray(Image.open(folder / "out" / "masks" / "ball.png")) > 0
    assert found.shape == (HEIGHT, WIDTH) and grabcut.iou(found, disc()) > 0.9


@pytest.mark.parametrize("name", REFUSED)
def test_pictures_that_are_none_are_one_line(folder, name, capsys):
    make, needle = REFUSED[name]
    photo = folder / "photo.png"
    if make is not None:
        photo.write_bytes(make())
    code, lines = told(folder, photo, BOXED, capsys)
    assert code == 2 and len(lines) == 1 and needle in lines[0], lines


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_that_are_wrong_are_told_by_line(folder, name, capsys):
    layout, needle = LAYOUTS[name]
    (folder / "photo.png").write_bytes(plain())
    code, lines = told(folder, folder / "photo.png", layout, capsys)
    assert code == 2 and any(needle in line for line in lines) and len(lines) <= 2, lines
    assert "layout.toml" in lines[0] or name == "mask is all"


def test_a_damaged_tag_is_no_warning(folder, recwarn):
    """Pillow warns of a tag that is larger than the file, and then refuses the picture."""
    data = bytearray(plain("tiff"))
    tag = data.index(b"\x02\x01\x03\x00\x03\x00\x00\x00")  # bits per channel, of 3 channels
    data[tag + 4 : tag + 8] = (0x01000000).to_bytes(4, "little")
    path = folder / "damaged.tif"
    path.write_bytes(data)
    with pytest.raises(photograph.PhotographError, match="damaged.tif: "):
        photograph.read(path)
    with pytest.raises(photograph.PhotographError, match="damaged.tif: "):
        photograph.read_mask(path, None)
    assert not recwarn.list


def test_there_are_forty_of_them():
    assert len(REFUSED) + len(LAYOUTS) + len(TAKEN) >= 40


def test_alpha_is_a_mask(folder, capsys):
    (folder / "photo.png").write_bytes(clear())
    code, lines = told(folder, folder / "photo.png", GOOD, capsys)
    assert code == 0, lines
    found = np.asarray(Image.open(folder / "out" / "masks" / "ball.png")) > 0
    assert (found == disc()).all()


@pytest.mark.slow
def test_a_large_photograph_is_made_smaller(folder, capsys):
    """Boxes and masks stay in the pixels of its file."""
    size = (9 * WIDTH - 1, 9 * HEIGHT - 1)
    large = Image.fromarray(pixels()).resize(size, Image.Resampling.BICUBIC)
    large.save(folder / "photo.jpg")
    code, lines = told(
        folder, folder / "photo.jpg", GOOD + f"box = {[9 * v for v in BOX]}\n", capsys
    )
    assert code == 0, lines
    found = np.asarray(Image.open(folder / "out" / "masks" / "ball.png")) > 0
    assert max(found.shape) == 1280
    small = np.asarray(Image.fromarray(disc()).resize(found.shape[::-1]))
    assert grabcut.iou(found, small) > 0.95
    # its own mask, which is as small, is taken by the next start
    assert main([str(folder / "photo.jpg"), str(folder / "layout.toml"), "-o", str(folder)]) == 0
    # and so is one in the pixels of the file
    Image.fromarray(disc()).resize(size).save(folder / "mask.png")
    photo = photograph.read(folder / "photo.jpg")
    assert photo.size == size
    assert photograph.read_mask(folder / "mask.png", photo).shape == size[::-1]


@pytest.mark.parametrize("what", ["a pipe", "a folder", "the output is a file"])
def test_what_is_no_file(folder, what, capsys):
    photo = folder / "photo.png"
    if what == "a pipe":
        os.mkfifo(photo)
    elif what == "a folder":
        photo.mkdir()
    else:
        photo.write_bytes(plain())
        (folder / "out").touch()
    code, lines = told(folder, photo, BOXED, capsys)
    assert (
        code == 2 and len(lines) == 1 and ("no regular file" in lines[0] or "no folder" in lines[0])
    )
