"""The live page: one loop that reads the run's files and answers to the viewers' controls."""

import contextlib
import functools
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians.camera import Camera
from vgmpi.io.run_lock import find_writer
from vgmpi.io.run_progress import read_progress, request_stop
from vgmpi.io.run_reader import RunError

from ..frames.camera_paths import CameraPath
from ..frames.field_values import color_bar
from ..frames.render_config import Settings, SettingsError, base_folder
from .drawn_view import ViewRenderer
from .followed_run import FollowedRun, ShownFrame, file_state
from .page_panel import AS_DRAWN, NO_PLOT, PagePanel
from .run_tables import list_plots, plot_file, read_plot
from .saved_camera import View, save_camera, view_of_camera
from .viewer_scene import show_domain, viewer_camera

log = logging.getLogger("vgmpi")

POLL_SECONDS = 0.2  # [s] between looks at the folder
STATUS_SECONDS = 2.0  # [s] between looks at the run's state without a new frame
RETRY_SECONDS = 1.0  # [s] after a look at the folder that failed
PLOT_SHARE = 0.1  # [-] largest share of the time that reading tables may take


class PageOptions(NamedTuple):
    """Options of the page."""

    settings_path: Path | None  # render.toml that is read, None without one
    camera_path: Path  # render.toml into which cameras are saved
    linger: float | None  # [s] after an ended run without viewers when the page ends; None: never


class ViewState(NamedTuple):
    """State of the view that all viewers see."""

    number: int  # number of the frame
    field: str  # choice of the colors
    version: tuple | None  # state of the frame's file


@dataclass
class DueTimes:
    """Times of `time.monotonic` [s] from which something is due again."""

    look: float = 0.0  # at the folder
    status: float = 0.0  # of the run on the panel
    play: float = 0.0  # next frame, while the page plays
    plot: float = 0.0  # look at the table of the plot


class LivePage:
    """Page of one run. Callbacks of viser only set values; `run` does the work in one thread."""

    def __init__(self, server: Any, followed: FollowedRun, chosen: Settings, options: PageOptions):
        """Set up the page.

        Args:
            server: Server of viser.
            followed: Files of the run.
            chosen: Contents of render.toml.
            options: Options of the page.
        """
        self.server, self.followed, self.options = server, followed, options
        self.chosen = chosen
        self.panel = PagePanel(server, str(followed.folder), follows=True)
        self.renderer = ViewRenderer()
        self._wake, self._ends = threading.Event(), threading.Event()
        self._shown: ViewState | None = None
        self._nodes: dict[str, Any] = {}  # Gaussians of viser by their names
        self._camera: Camera | None = None  # of render.toml
        self._cell: float | None = None  # [m] unit of length of the scene, None before a frame
        self._eye = np.zeros(3)  # [m] from which the colors of the frame are seen
        self._requested_number: int | None = None
        self._requested_views: list[tuple[str, View]] = []
        self._due = DueTimes()
        self._plot_state: tuple | None = None
        self._logged = ""  # the last fault in the log
        self._fault = ""  # why the wanted frame or curve is not shown
        self._last_watched = time.monotonic()
        self._connect_controls()

    def _connect_controls(self) -> None:
        """Let the controls wake the loop."""
        panel = self.panel

        @panel.frame.on_update
        @self._survive_faults
        def _(event: Any) -> None:
            if event.client is not None:  # a viewer moved it, not the page
                panel.following.value = False
                self._requested_number = int(panel.frame.value)
                self._wake.set()

        @panel.following.on_update
        @self._survive_faults
        def _(event: Any) -> None:
            if event.client is not None and panel.following.value:
                panel.playing.value = False
            self._wake.set()

        @panel.playing.on_update
        @self._survive_faults
        def _(event: Any) -> None:
            if event.client is not None and panel.playing.value:
                panel.following.value = False
            self._wake.set()

        for control in (panel.color, panel.plot):
            control.on_update(lambda _: self._wake.set())
        guard = self._survive_faults
        panel.stop.on_click(guard(lambda _: self._stop_run()))
        panel.save.on_click(guard(lambda event: self._request_view("save", event)))
        panel.draw.on_click(guard(lambda event: self._request_view("draw", event)))
        self.server.on_client_connect(guard(self._welcome))

    def _survive_faults(self, action: Callable[..., None]) -> Callable[..., None]:
        """Return an action that logs a fault in one line: it ends the page for nobody."""

        @functools.wraps(action)
        def guarded(*arguments: Any) -> None:
            """Act; log a fault."""
            try:
                action(*arguments)
            except Exception as error:
                self._log_fault(error)

        return guarded

    def _log_fault(self, error: Exception) -> None:
        """Log a fault that nobody foresaw in one line, once while it lasts."""
        line = f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"
        if line != self._logged:
            self._logged = line
            log.warning("the live page goes on after a fault: %s", line)

    def _stop_run(self) -> None:
        """Ask the run to stop once a viewer has confirmed it; say so where no run writes."""
        folder, panel = self.followed.folder, self.panel

        def request() -> None:
            """Ask the run to stop, and show the answer."""
            panel.show_message(request_stop(folder)[1])

        if find_writer(folder) is None:
            request()
        else:
            panel.confirm_stop(self._survive_faults(request))

    def _welcome(self, client: Any) -> None:
        """Show a new viewer the newest state."""
        self._fit_view(client)
        self._due.status = 0.0
        self._wake.set()

    def _request_view(self, action: str, event: Any) -> None:
        """Leave an action on a viewer's view to the loop."""
        if event.client is None:
            return
        if self._cell is None:
            self.panel.show_message("there is no frame yet")
            return
        self._requested_views.append((action, view_of_camera(event.client.camera, self._cell)))
        self._wake.set()

    def run(self) -> None:
        """Follow the run until `end` is called or the page has lingered long enough."""
        try:
            while not self._ends.is_set() and not self._is_deserted():
                try:
                    self._update()
                except Exception as error:  # the page stays for all viewers
                    self._log_fault(error)
                    self._due.look = time.monotonic() + RETRY_SECONDS
                self._wake.wait(self._pause())
                self._wake.clear()
        finally:
            self.renderer.close()

    def end(self) -> None:
        """End `run`."""
        self._ends.set()
        self._wake.set()

    def _pause(self) -> float:
        """Return the time until the next look at the folder [s]."""
        waiting = self._due.play - time.monotonic()
        return min(POLL_SECONDS, max(waiting, 0.0)) if self.panel.playing.value else POLL_SECONDS

    def _is_deserted(self) -> bool:
        """Return whether the run has ended and nobody has watched for `linger`."""
        if self.options.linger is None:
            return False
        now = time.monotonic()
        if self.server.get_clients():
            self._last_watched = now
        elif now - self._last_watched > self.options.linger:
            if find_writer(self.followed.folder) is None:
                return True
            self._last_watched = now
        return False

    def _update(self) -> None:
        """Do everything that is due."""
        self._act_on_views()
        if time.monotonic() < self._due.look:
            return
        try:
            was_absent = self.followed.reader is None
            if self.followed.refresh():
                self._due.status = self._due.plot = 0.0
                if was_absent or self.followed.cell() != self._cell:
                    self._begin_scene()
            if self.server.get_clients():
                self._show_status()
                self._show_frame()
                self._show_plot()
        except (RunError, SettingsError) as error:
            self._due.look = time.monotonic() + RETRY_SECONDS
            self.panel.show_status([str(error).splitlines()[0]])

    def _begin_scene(self) -> None:
        """Show the domain of a run and set the first camera."""
        scene = self.server.scene
        for node in self._nodes.values():
            node.remove()
        self._nodes, self._shown = {}, None
        cell = self._cell = self.followed.cell()
        show_domain(scene, self.followed.domain(), cell)
        box = self.followed.extent()
        base = base_folder(self.options.settings_path)
        settings = self.chosen.views()[0]
        camera = CameraPath(settings, self.chosen.picture, lambda: box, base).camera_at(0.0, 0.0)
        scene.set_up_direction(settings.up)
        self._camera, self._eye = camera, camera.eye
        initial = viewer_camera(camera, box, cell)
        initial.set_as(self.server.initial_camera)
        for client in self.server.get_clients().values():
            initial.set_as(client.camera)
            self._fit_view(client)

    def _fit_view(self, client: Any) -> None:
        """Let a viewer's window show all of the picture of render.toml."""
        if self._camera is not None:
            client.camera.fov = self._camera.vertical_fov(float(client.camera.aspect))

    def _show_status(self) -> None:
        """Show the state of the run, if it is due."""
        now = time.monotonic()
        if now < self._due.status or self.followed.reader is None:
            return
        self._due.status = now + STATUS_SECONDS
        selection = self.followed.selection
        lines = [str(self.followed.folder), *read_progress(self.followed.reader).lines()]
        if selection is not None:
            lines.append(f"{selection.count:,} of {selection.all:,} Gaussians")
        lines += [self._fault] if self._fault else []
        self.panel.show_status(lines)
        self.panel.offer_plots(list_plots(self.followed.folder))

    def _wanted_number(self, numbers: list[int]) -> tuple[int, bool]:
        """Return the number of the frame to show, and whether the slider is set to it.

        It is not set while nothing but a viewer moves it, whose next move may be on its way.
        """
        panel, now = self.panel, time.monotonic()
        current = self._shown.number if self._shown is not None else numbers[0]
        requested, self._requested_number = self._requested_number, None
        interval = 1.0 / float(panel.rate.value)
        if requested is not None:
            self._due.play = now + interval
            number = max((n for n in numbers if n <= requested), default=numbers[0])
            return number, self._requested_number is None
        if panel.following.value:
            return numbers[-1], True
        if panel.playing.value and now >= self._due.play:
            self._due.play = now + interval
            return next((n for n in numbers if n > current), numbers[0]), True
        return max((n for n in numbers if n <= current), default=numbers[0]), False

    def _show_frame(self) -> None:
        """Show the frame and the colors that are wanted now."""
        numbers = self.followed.numbers()
        if not numbers or self.followed.reader is None:
            return
        number, sets_slider = self._wanted_number(numbers)
        field = str(self.panel.color.value)
        version = file_state(self.followed.reader.path(number))
        wanted = ViewState(number, field, version)
        self.panel.show_numbers(numbers[-1], number if sets_slider else None)
        if wanted == self._shown:
            return
        clients = list(self.server.get_clients().values())
        if clients:
            self._eye = self.followed.cell() * np.asarray(clients[-1].camera.position)
        self._shown = wanted  # a broken frame is tried again when its file changes
        try:
            choice = None if field == AS_DRAWN else field
            self._send_frame(self.followed.read_frame(number, self._eye, choice), field)
            self._fault = ""
        except RunError as error:
            self._fault, self._due.status = str(error).splitlines()[0], 0.0

    def _send_frame(self, frame: ShownFrame, field: str) -> None:
        """Send a frame to the viewers."""
        with self.server.atomic():
            for name, arrays in (("/scenery", frame.scenery), ("/particles", frame.particles)):
                node = self._nodes.get(name)
                if not len(arrays["centers"]):
                    if node is not None:
                        self._nodes.pop(name).remove()
                elif node is None:
                    self._nodes[name] = self.server.scene.add_gaussian_splats(name, **arrays)
                else:
                    node.set_gaussians(**arrays)
        self.server.flush()
        self.panel.offer_fields(frame.fields)
        self.panel.show_bar("" if frame.bounds is None else color_bar(field, *frame.bounds))

    def _show_plot(self) -> None:
        """Show the plot that is chosen, if its table has changed."""
        name, now = str(self.panel.plot.value), time.monotonic()
        if name == NO_PLOT:
            self._plot_state = None
            self.panel.show_plot(None)
            return
        state = (name, file_state(plot_file(self.followed.folder, name)))
        is_other = self._plot_state is None or self._plot_state[0] != name
        if state == self._plot_state or (now < self._due.plot and not is_other):
            return
        self._plot_state = state
        try:
            self.panel.show_plot(read_plot(self.followed.folder, name))
        except RunError as error:
            self.panel.show_message(str(error).splitlines()[0])
        duration = time.monotonic() - now
        self._due.plot = now + duration / PLOT_SHARE

    def _act_on_views(self) -> None:
        """Save and draw the views that viewers have asked for."""
        with contextlib.suppress(IndexError):
            while True:
                action, view = self._requested_views.pop(0)
                try:
                    self.panel.show_message(self._act(action, view))
                except (RunError, SettingsError) as error:
                    self.panel.show_message(str(error).splitlines()[0])
        if (result := self.renderer.poll()) is not None:
            picture, reason = result
            if picture is not None:
                self.panel.show_picture(picture, "drawn view")
            self.panel.show_message(reason)

    def _act(self, action: str, view: View) -> str:
        """Save or draw a view; return one line about it."""
        if action == "save":
            return save_camera(self.options.camera_path, view)
        if self._shown is None:
            return "there is no frame yet"
        if self.renderer.is_busy:
            return "a picture is being drawn: wait for it"
        view.settings()
        folder, number = self.followed.folder, self._shown.number
        self.renderer.start(folder, self.options.settings_path, number, view)
        return f"frame {number} is being drawn; the first picture may take a minute"
