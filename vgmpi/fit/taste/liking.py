"""How a video model likes runs: of each its loss, its code, and what pulls at that."""

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ... import inputs, room
from ...study.runs import StudyError
from ..films import alike
from ..pictures import Pictures
from ..runs import RECORD
from ..settings import FitFile
from ..shared import replaced
from ..target import Target
from . import distilled
from .folder import ModelError
from .kind import Kind, kind_of
from .settings import Sds

PACKAGES = ("torch", "diffusers", "transformers", "accelerate")


class Taste(Target):
    """One number of each draw of noise: the root of the mean square of what the model's guess of it
    is off by. Their mean square is the denoising loss. What a model says of a run is kept in its
    folder, and not asked again."""

    def __init__(self, file: FitFile, kind: Kind | None = None):
        """kind: in place of the one in the model's folder. Loads nothing. Raises FitFileError,
        postprocess.settings.SettingsError, and StudyError where packages are missing."""
        super().__init__()
        assert file.settings.sds is not None
        self.file, self.asked = file, file.settings.sds
        self.said = "root of the mean square of what the model's guess of the noise is off by"
        self.pulls = file.settings.method.kind == "descent"
        self.given, self.loaded = kind is not None, kind is not None
        self.kind = kind or self._model()
        self.drawn = Pictures(file.folder / self.asked.render)
        self.size = self.asked.size or self.drawn.size
        self.numbers = self._frames()
        self.picture = self._picture() if self.kind.by == "image" else None
        if not self.given:
            self._check_size()
            _packages()
            self.before = self._room()
        self.values = [np.zeros(self.asked.draws)]
        self.held = [np.zeros(self.asked.draws, bool)]

    def _model(self) -> Kind:
        try:
            found = kind_of(self.file.folder / self.asked.model, self.asked)
        except ModelError as error:
            said = f"{error}; got '{self.asked.model}'"
            raise self.file.wrong(("sds", "model"), said) from None
        if getattr(self.asked, found.by) is None:
            other = "image" if found.by == "prompt" else "prompt"
            said = f"{found.denoiser} goes by {found.by}, not by {other}"
            raise self.file.wrong(("sds", other), said)
        return found

    def _frames(self) -> list[int]:
        """Numbers of the frames that are shown."""
        drawn = self.drawn.frames(self.file.scene.time.frames)
        count = self.asked.frames or len(drawn)
        if not 1 <= count <= len(drawn):
            said = f"{len(drawn)} frames of the scene are drawn; got {count}"
            raise self.file.wrong(("sds", "frames"), said)
        wrong = self.kind.wrong_count(count)
        if wrong:
            raise self.file.wrong(("sds", "frames"), wrong)
        return [drawn[k] for k in np.linspace(0, len(drawn) - 1, count).round().astype(int)]

    def _check_size(self) -> None:
        step = self.kind.step()
        wrong = [x for x in self.size if x % step]
        if wrong:
            said = f"{wrong[0]} pixels are no multiple of {step}, which the model needs"
            where = ("sds", "size") if self.asked.size else ("sds", "render")
            raise self.file.wrong(where, f"{said}: give size, or render.toml another")
        if not alike(self.size, self.drawn.size):
            said = f"is of another shape than what is drawn, {_shown(self.drawn.size)} pixels"
            raise self.file.wrong(("sds", "size"), f"{said}; got {_shown(self.size)}")

    def _picture(self) -> np.ndarray:
        """The first picture (height, width, 3) of 0..1, as large as the model sees it."""
        from PIL import Image

        path = self.file.folder / str(self.asked.image)
        try:
            raw = np.atleast_3d(inputs.picture(path))
            if raw.dtype != np.uint8 or raw.shape[2] not in (1, 3, 4):
                raise ValueError("neither a grey nor a colour picture of 8 bits")
            if not alike(raw.shape[1::-1], self.size):
                said = f"is of another shape, {_shown(raw.shape[1::-1])} pixels"
                raise ValueError(f"{said}, than the {_shown(self.size)} of the rest")
        except ValueError as error:
            said = f"{error}; got '{self.asked.image}'"
            raise self.file.wrong(("sds", "image"), said) from None
        colours = np.repeat(raw, 3, 2) if raw.shape[2] == 1 else raw[..., :3]
        small = Image.fromarray(colours).resize(self.size, Image.Resampling.BICUBIC)
        return np.asarray(small, np.float32) / 255

    def _room(self) -> str:
        """What the model will take. Raises FitFileError where there is less."""
        needed = self.kind.needs(len(self.numbers), *self.size)
        what = f"{self.kind.denoiser} in {self.asked.precision} takes about"
        try:
            if _device(self.asked) == "cpu":
                room.check(needed, what)
            else:
                _check_card(needed, what)
        except room.TooLarge as error:
            raise self.file.wrong(("sds", "model"), str(error)) from None
        shown = f"{len(self.numbers)} frames of {_shown(self.size)} pixels"
        return f"{what} {room.gib(needed)} of memory on {_device(self.asked)}, for {shown}"

    @functools.cached_property
    def key(self) -> str:
        """What numbers that are kept depend on, besides their run."""
        stamp: dict[str, Any] = {"sds": self.asked.model_dump(), "frames": self.numbers}
        stamp["render"] = (self.file.folder / self.asked.render).read_text()
        if not self.given:
            stamp["model"], stamp["device"] = self.kind.folder.stamp(), _device(self.asked)
            stamp["by"] = [importlib.metadata.version(name) for name in PACKAGES]
        if self.picture is not None:
            stamp["image"] = hashlib.sha256(self.picture.tobytes()).hexdigest()
        return hashlib.sha256(json.dumps(stamp, sort_keys=True).encode()).hexdigest()

    def of(self, folder: Path, stage: int) -> np.ndarray:
        """(draws,)"""
        return self._answer(folder, "loss")

    def pull(self, folder: Path) -> np.ndarray:
        """What pulls at a run's code, of all draws (n,)."""
        return self._answer(folder, "pull")

    def _answer(self, folder: Path, name: str) -> np.ndarray:
        """What the model said of a run; it is asked where that is not kept."""
        found = self._kept(folder, name)
        if found is None:
            self._ask(folder)
            found = self._kept(folder, name)
        return np.asarray(found)

    def code(self, folder: Path) -> np.ndarray:
        """A run's code, as the model has it (1, channels, frames, height, width)."""
        found = self._kept(folder, "code")
        if found is None:
            pictures = self.drawn.of(folder, self.numbers)
            with self._asking() as torch, torch.no_grad():
                film = self.film(pictures).to(self.kind.device)
                found = self.kind.encode(film).float().cpu().numpy()
            self._keep(folder, "code", found)
        return found

    def _ask(self, folder: Path) -> None:
        """The model's guess of every draw; what comes of it is kept. One after the other, which
        takes the least memory."""
        code = self.code(folder)
        losses, pulled = [], np.zeros(code.shape, np.float32)
        with self._asking() as torch, torch.no_grad():
            z = torch.from_numpy(code).to(self.kind.device)
            for one in self._draws(z.shape):
                if self.pulls:
                    by, loss = distilled.pull(self.kind, z, one, self.guidance)
                    pulled += by.float().cpu().numpy() / np.float32(self.asked.draws)
                else:
                    loss = distilled.off(self.kind, z, one)
                losses.append(loss**0.5)
        self._keep(folder, "loss", np.array(losses))
        if self.pulls:
            self._keep(folder, "pull", pulled.ravel())

    @property
    def guidance(self) -> float:
        return self.kind.usual if self.asked.guidance is None else self.asked.guidance

    def _draws(self, shape: tuple[int, ...]) -> Iterator[distilled.Draw]:
        """The same ones for every run."""
        for k, share in enumerate(distilled.shares(self.asked.times, self.asked.draws)):
            level = self.kind.level(share)
            yield distilled.draw(level, tuple(shape), self.asked.seed, k, self.kind.device)

    def film(self, pictures: np.ndarray) -> Any:
        """Pictures (frames, height, width, 3) of 0..1 as models take them: (1, 3, frames, height,
        width) of -1..1, in the size that is asked for."""
        import torch

        film = torch.from_numpy(pictures.astype(np.float32)).permute(3, 0, 1, 2)
        width, height = self.size
        if tuple(film.shape[2:]) != (height, width):
            way = {"mode": "bilinear", "align_corners": False, "antialias": True}
            film = torch.nn.functional.interpolate(film, (height, width), **way)
        return film[None] * 2 - 1

    @contextlib.contextmanager
    def _asking(self) -> Iterator[Any]:
        """The model, loaded; gives torch. What goes wrong with it is told in one line."""
        import torch

        try:
            if not self.loaded:
                self._load()
            yield torch
        except (OSError, ValueError, RuntimeError, KeyError, TypeError, ImportError) as error:
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            said = (lines or [type(error).__name__])[0][:200]
            raise self.file.wrong(("sds", "model"), f"cannot be asked: {said}") from None

    def _load(self) -> None:
        import diffusers
        import transformers

        for package in (diffusers.utils.logging, transformers.logging):
            package.set_verbosity_error()
            package.disable_progress_bar()
        image = None if self.picture is None else self.film(self.picture[None])[:, :, 0]
        self.kind.load(_device(self.asked), image)
        self.loaded = True

    def _place(self, folder: Path, name: str) -> Path:
        return folder / f"sds_{name}.npz"

    def _mark(self, folder: Path) -> str:
        """The key, and the run's record: a run that was made anew is asked about anew."""
        record = (folder / RECORD).read_bytes() if (folder / RECORD).exists() else b""
        return hashlib.sha256(self.key.encode() + record).hexdigest()

    def _kept(self, folder: Path, name: str) -> np.ndarray | None:
        try:
            with np.load(self._place(folder, name), allow_pickle=False) as found:
                return found["numbers"] if str(found["key"]) == self._mark(folder) else None
        except Exception:  # not there, or half there: zip, zlib and numpy raise all kinds
            return None

    def _keep(self, folder: Path, name: str, numbers: np.ndarray) -> None:
        """There whole, or not at all; processes that share a fit write the same, each its own."""
        content = io.BytesIO()
        np.savez(content, numbers=numbers, key=self._mark(folder))
        replaced(self._place(folder, name), content.getvalue())


def _shown(size: tuple[int, ...]) -> str:
    return f"{size[0]} x {size[1]}"


def _packages() -> None:
    gone = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if gone:
        said = f"[sds] needs {', '.join(gone)}"
        raise StudyError(f"{said}: pip install 'vgmpi[sds]'")


@functools.cache
def _card() -> bool:
    import torch

    return torch.cuda.is_available()


def _device(asked: Sds) -> str:
    return asked.device if asked.device != "auto" else "cuda" if _card() else "cpu"


def _check_card(needed: float, what: str) -> None:
    """Raises TooLarge."""
    import torch

    have = torch.cuda.mem_get_info()[0] if _card() else 0
    if needed > have:
        raise room.TooLarge(f"{what} {room.gib(needed)}; {room.gib(have)} are free on the card")
