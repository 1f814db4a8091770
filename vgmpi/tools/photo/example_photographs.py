"""Examples of `vgmpi photo --demo`: photographs with their layouts.

Three photographs are those of scikit-image, which is an extra; three are drawn.
"""

import io
from pathlib import Path

from vgmpi.runtime.message_text import did_you_mean
from vgmpi.runtime.user_files import replace_file

from .layout_config import LayoutError
from .photograph import PhotographError

FOLDER = Path(__file__).with_name("examples")
SUMMARIES = {
    "coffee": "a cup of coffee is dropped onto its saucer (photograph of scikit-image)",
    "chelsea": "the head of a cat tips forward (photograph of scikit-image)",
    "rocket": "a model of a rocket collapses (photograph of scikit-image)",
    "milk": "an orange falls onto a glass of milk (drawn)",
    "tower": "a ball falls onto a stack of two boxes (drawn)",
    "balls": "two balls fall onto a ball and a box (drawn)",
}
MISSING = "not installed: pip install 'vgmpi[demo]'"


def write_example(name: str, folder: Path) -> tuple[Path, Path]:
    """Write photo.png, layout.toml and masks of an example; files that exist stay.

    Returns:
        Paths of the photograph and of the layout.

    Raises:
        LayoutError: There is no such example.
        PhotographError: scikit-image is missing.
        OSError: A file cannot be written.
    """
    if name not in SUMMARIES:
        names = f"known: {', '.join(SUMMARIES)}"
        raise LayoutError(
            [f"--demo: no such example{did_you_mean(name, list(SUMMARIES))}; {names}"]
        )
    contents = {
        file.relative_to(FOLDER / name): file.read_bytes()
        for file in sorted((FOLDER / name).rglob("*"))
        if file.is_file()
    }
    photo = next((file for file in contents if file.stem == "photo"), Path("photo.png"))
    if photo not in contents and not (folder / photo).exists():
        contents[photo] = _photograph_bytes(name)
    for file, content in contents.items():
        path = folder / file
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, content)
    return folder / photo, folder / "layout.toml"


def _photograph_bytes(name: str) -> bytes:
    """Return a photograph of scikit-image as PNG; raise a PhotographError if it is missing."""
    from PIL import Image

    try:
        from skimage import data
    except ImportError:
        message = f"the photograph '{name}' is that of scikit-image, {MISSING}"
        raise PhotographError(message) from None
    buffer = io.BytesIO()
    Image.fromarray(getattr(data, name)()).save(buffer, "png")
    return buffer.getvalue()
