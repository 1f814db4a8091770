"""A run's folder in a notebook (`vgmpi.open_run("out")`): its frames as arrays and pyvista data."""

import base64
import functools
import html
import io
import re
import subprocess
import threading
import weakref
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.io import csv_log, file_layout
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import draw_preview
from vgmpi.postprocess.frames.render_config import find_settings
from vgmpi.runtime.live_process import launch_page

ARRAYS_OF_OBJECTS = ("poses",)  # arrays of a frame without a row per particle
PICTURE_SIZE, THUMBNAIL_SIZE = 640, 240  # [pixels] longer sides


class Frame:
    """One frame of a run; its arrays are read when they are first used, and checked.

    Attributes:
        number: Number of the frame.
    """

    def __init__(self, reader: RunReader, number: int):
        """Name a frame.

        Args:
            reader: Files of the run.
            number: Number of the frame.
        """
        self._reader, self.number = reader, number

    def __repr__(self) -> str:
        return f"<frame {self.number} at {self.time:.4g} s>"

    @functools.cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by their names in the file, in SI units. Raises RunError."""
        return self._reader.frame(self.number)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return an array by its name in the file, such as "J". Raises RunError."""
        if name not in self.arrays:
            message = f"frame {self.number} has no array '{name}'; it has {', '.join(self.names)}"
            raise RunError(f"{self._reader.folder}: {message}")
        return self.arrays[name]

    @property
    def names(self) -> list[str]:
        """Names of the arrays."""
        return list(self.arrays)

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self._reader.times[self.number])

    @functools.cached_property
    def positions(self) -> np.ndarray:
        """Positions of the particles, shape (n, 3) [m]; alone, they are read fastest."""
        if "arrays" in self.__dict__:
            return self.arrays["positions"]
        return self._reader.positions(self.number)

    @property
    def ids(self) -> np.ndarray:
        """Numbers of the particles, shape (n,): the same particle has the same in each frame."""
        return self["id"]

    @property
    def velocities(self) -> np.ndarray:
        """Velocities of the particles, shape (n, 3) [m/s]."""
        return self["velocity"]

    def to_pyvista(self):
        """Return a `pyvista.PolyData` of the particles with all arrays that have a row for each."""
        import pyvista

        cloud = pyvista.PolyData(np.asarray(self["positions"], np.float64))
        for name, array in self.arrays.items():
            if name != "positions" and name not in ARRAYS_OF_OBJECTS:
                cloud.point_data[name] = array.reshape(len(array), -1).squeeze()
        return cloud


class Frames(Sequence[Frame]):
    """The frames of a run by their numbers; negative numbers count from the end."""

    def __init__(self, reader: RunReader):
        """Name the frames of a run.

        Args:
            reader: Files of the run.
        """
        self._reader = reader

    def __len__(self) -> int:
        """Return the number of frames, including missing ones."""
        return len(self._reader)

    def __getitem__(self, number):
        """Return a frame, or a list of the present ones of a slice. Raises RunError."""
        count = len(self)
        if isinstance(number, slice):
            return [self[k] for k in range(count)[number] if k in self._reader.frames]
        if not -count <= number < count:
            raise IndexError(f"{self._reader.folder}: no frame {number}, there are {count}")
        number %= count
        if number not in self._reader.frames:
            raise RunError(f"{self._reader.folder}: frame {number} is missing")
        return Frame(self._reader, number)

    def __iter__(self) -> Iterator[Frame]:
        """Return an iterator over the present frames."""
        return (Frame(self._reader, number) for number in sorted(self._reader.frames))


def open_run(folder: str | Path) -> "OpenedRun":
    """Open a run's folder, also while the run goes on.

    Args:
        folder: Output folder of a run.

    Returns:
        The run, with `frames`, `probes`, `ledger`, `picture()`, `show()` and
        `show_live()`.

    Raises:
        RunError: If there is no run.

    Example:
        ```python
        run = vgmpi.open_run("out")
        print(run.frames[-1].positions.mean(0))
        run.probes["ball"].plot(x="time", y="force_x")  # with pandas
        ```
    """
    return OpenedRun(folder)


class OpenedRun:
    """Files of a run: frames, tables and pictures.

    In Jupyter its value is shown as a thumbnail with a few numbers.

    Attributes:
        folder: Folder of the run.
        reader: Files of the run, see `vgmpi.read`.
        frames: Frames by their numbers.
        probes: Tables of the probes by their names.
    """

    def __init__(self, folder: str | Path):
        """Find the files of a run. Raises RunError."""
        self.reader = RunReader(folder)
        self.folder = self.reader.folder
        self.frames = Frames(self.reader)
        self.probes = ProbeTables(self.reader)

    def __repr__(self) -> str:
        return f"<run {str(self.folder)!r}: {len(self.frames)} frames, {self._particles()}>"

    @property
    def times(self) -> np.ndarray:
        """Simulated times of the frames, shape (frames,) [s]; NaN for missing frames."""
        return self.reader.times

    @property
    def scene(self) -> dict:
        """Scene with all defaults filled in, in SI units."""
        return self.reader.scene

    @property
    def ledger(self) -> Any:
        """Conservation log: a row for each frame and phase. Raises RunError.

        It is a `pandas.DataFrame` if pandas is installed, else a dict of arrays by column.
        """
        return table_of(csv_log.read_rows(self.folder / file_layout.LEDGER))

    def picture(
        self, frame: int = -1, size: int = PICTURE_SIZE, settings: str | Path | None = None
    ) -> np.ndarray:
        """Draw a frame.

        Args:
            frame: Number of the frame; negative numbers count from the end.
            size: Longer side [pixels].
            settings: A render.toml, by default one in the folder of the run or beside it.

        Returns:
            The picture, uint8, shape (height, width, 3).

        Raises:
            RunError: If the frame cannot be drawn.
            vgmpi.postprocess.frames.render_config.SettingsError: If the settings are wrong.
        """
        number = self.frames[frame].number
        path = Path(settings) if settings is not None else find_settings(self.folder)
        chosen = render_config.load(path)
        base = render_config.base_folder(path)
        return draw_preview(self.reader, chosen, base, number, size)

    def show(
        self, frame: int = -1, size: int = PICTURE_SIZE, settings: str | Path | None = None
    ) -> Any:
        """Show a frame in the cell of a notebook.

        Args:
            frame: Number of the frame; negative numbers count from the end.
            size: Longer side [pixels].
            settings: A render.toml, by default one in the folder of the run or beside it.

        Returns:
            An `IPython.display.Image`, which Jupyter draws; elsewhere a `PIL.Image.Image`.

        Raises:
            RunError: If the frame cannot be drawn.
        """
        picture = self.picture(frame, size, settings)
        try:
            from IPython.display import Image
        except ImportError:
            import PIL.Image

            return PIL.Image.fromarray(picture)
        return Image(data=_png(picture), format="png")

    def show_live(self, particles: int = 100_000, height: int = 700) -> "LiveCell":
        """Show the run as a live page in the cell of a notebook, also while it goes on.

        The page is served on the machine of the kernel: a browser elsewhere needs ssh, as for
        `vgmpi live`, and `show` draws a picture everywhere.

        Args:
            particles: Largest number of Gaussians, up to 300,000.
            height: Height of the cell [pixels].

        Returns:
            The page, with `address` and `close()`; it ends with the kernel.

        Raises:
            RunError: If no page can be served.
        """
        return LiveCell(self.folder, particles, height)

    def _particles(self) -> str:
        """Return how many particles it has, as text."""
        return f"{self.reader.particle_count(max(self.reader.frames)):,} particles"

    def _repr_html_(self) -> str:
        """Return a thumbnail and a few numbers, for Jupyter."""
        rows = {
            "folder": str(self.folder),
            "frames": f"{len(self.reader.frames)}, to {np.nanmax(self.times):.4g} s",
            "particles": self._particles().split()[0],
            "objects": ", ".join(obj["name"] for obj in self.reader.objects),
            "cell": f"{self.scene['domain']['cell']:.4g} m",
            "probes": ", ".join(self.probes) or "none",
        }
        cells = "".join(
            f"<tr><th style='text-align:left'>{name}</th>"
            f"<td style='text-align:left'>{html.escape(value)}</td></tr>"
            for name, value in rows.items()
        )
        try:
            data = base64.b64encode(_png(self.picture(max(self.reader.frames), THUMBNAIL_SIZE)))
            picture = f"<img src='data:image/png;base64,{data.decode()}' alt='the last frame'>"
        except (RunError, render_config.SettingsError) as error:
            picture = f"<i>no picture: {html.escape(str(error).splitlines()[0])}</i>"
        layout = "display:flex;gap:1em;align-items:flex-start"
        return f"<div style='{layout}'>{picture}<table>{cells}</table></div>"


class ProbeTables(Mapping[str, Any]):
    """Tables of a run's probes by their names.

    A table is a `pandas.DataFrame` if pandas is installed, else a dict of arrays by column.
    """

    def __init__(self, reader: RunReader):
        """Name the probes of a run.

        Args:
            reader: Files of the run.
        """
        self._reader = reader

    def _probes(self) -> dict[str, dict]:
        """Return the entries of the scene by the probes' names."""
        return {entry["name"]: entry for entry in self._reader.scene.get("probe", ())}

    def __getitem__(self, name: str) -> Any:
        """Return the table of a probe. Raises RunError if its file is damaged or missing."""
        probes = self._probes()
        if name not in probes:
            some = ", ".join(probes) or "none"
            raise KeyError(f"{self._reader.folder}: no probe '{name}'; there are {some}")
        path = self._reader.folder / file_layout.PROBE_NAME.format(name)
        return table_of(csv_log.read_probe(path))

    def __iter__(self) -> Iterator[str]:
        """Return an iterator over the names."""
        return iter(self._probes())

    def __len__(self) -> int:
        """Return the number of probes."""
        return len(self._probes())


def table_of(rows: list[dict]) -> Any:
    """Return rows as a `pandas.DataFrame` if pandas is installed, else a dict of arrays.

    Args:
        rows: Rows with the same keys.
    """
    columns = {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else ())}
    try:
        import pandas
    except ImportError:
        return columns
    return pandas.DataFrame(columns)


def _png(picture: np.ndarray) -> bytes:
    """Return a picture as a PNG file."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "png")
    return data.getvalue()


class LiveCell:
    """Live page of a run in a cell: `address` and `close()`; it ends with the kernel."""

    def __init__(self, folder: Path, particles: int, height: int):
        """Start the page.

        Args:
            folder: Output folder of the run.
            particles: Largest number of Gaussians.
            height: Height of the cell [pixels].

        Raises:
            RunError: If no page can be served, with its one line.
        """
        process = launch_page(
            folder, "--port", 0, "--particles", particles,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        assert process.stdout is not None
        line = process.stdout.readline().strip()
        match = re.search(r"http://\S+", line)
        if match is None:
            process.kill()
            raise RunError(line or "the live page has not started")
        self.address, self.height = match[0], height
        # later lines of the page are read, so that it never waits
        threading.Thread(target=process.stdout.read, daemon=True).start()
        self._finalizer = weakref.finalize(self, process.terminate)

    def close(self) -> None:
        """End the page."""
        self._finalizer()

    def _repr_html_(self) -> str:
        """Return the page as a frame, for Jupyter."""
        style = f"width: 100%; height: {self.height}px; border: 0"
        return f'<iframe src="{self.address}" style="{style}"></iframe>'

    def _repr_mimebundle_(self, **_: Any) -> dict[str, str]:
        """Return what the cell shows, and a line for places without HTML."""
        return {"text/html": self._repr_html_(), "text/plain": f"live page: {self.address}"}
