"""Controls of the live page: what a viewer sees and presses, without what it does."""

import html
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from .run_tables import Plot

AS_DRAWN = "as drawn"  # choice of colors: those of the run
NO_PLOT = "none"
PLOT_HEIGHT = 220  # [pixels]
CURVE_COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b")
BLANK = np.full((9, 16, 3), 255, np.uint8)  # picture before one is drawn


class PagePanel:
    """Controls of the page, shared by all viewers.

    Attributes:
        frame: Slider of the frame's number.
        playing, following: Checkboxes: play the frames; go to the newest frame.
        rate: Frames per second while playing.
        color: Choice of the colors.
        plot: Choice of the plot.
        stop, save, draw: Buttons.
    """

    def __init__(self, server: Any, title: str, follows: bool):
        """Make the controls.

        Args:
            server: Server of viser.
            title: Text above the controls.
            follows: Whether the page follows the newest frame at first.
        """
        gui = self.gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.main_panel.dock_right()
        self._status = gui.add_html(paragraphs([title]))
        self._message = gui.add_html("")
        with gui.add_folder("Frames"):
            self.frame = gui.add_slider("frame", min=0, max=1, step=1, initial_value=0)
            self.following = gui.add_checkbox("follow newest", initial_value=follows)
            self.playing = gui.add_checkbox("play", initial_value=False)
            self.rate = gui.add_number("frames/s", initial_value=10.0, min=0.1, max=60.0, step=0.1)
        with gui.add_folder("Colors"):
            self.color = gui.add_dropdown("color by", (AS_DRAWN,), initial_value=AS_DRAWN)
            self._bar = gui.add_html("", visible=False)
        self._curves = gui.add_folder("Curves", expand_by_default=False)
        with self._curves:
            self.plot = gui.add_dropdown("curve", (NO_PLOT,), initial_value=NO_PLOT)
        self._chart: Any = None
        with gui.add_folder("Run and picture"):
            self.stop = gui.add_button("Stop the run (with a checkpoint)")
            self.save = gui.add_button("Save this camera in render.toml")
            self.draw = gui.add_button("Draw this view")
            self._picture = gui.add_image(BLANK, label="drawn view", visible=False)

    def show_status(self, lines: Iterable[str]) -> None:
        """Show the state of the run."""
        self._status.content = paragraphs(lines)

    def show_message(self, text: str) -> None:
        """Show one line about the last action; "" removes it."""
        style = "padding:0.3em 0.6em;margin:0.3em 0.6em;background:#fff3bf;color:#333"
        line = f'<div id="vgmpi-message" style="{style}">{html.escape(text)}</div>'
        self._message.content = line if text else ""

    def confirm_stop(self, action: Callable[[], None]) -> None:
        """Ask whether the run shall stop, and call `action` if so."""
        with self.gui.add_modal("Stop the run?") as question:
            self.gui.add_markdown("It writes a checkpoint and ends; `--resume` continues it.")
            confirm = self.gui.add_button("Write a checkpoint and stop", color="red")
            cancel = self.gui.add_button("Let the run go on")

        @confirm.on_click
        def _(_: Any) -> None:
            question.close()
            action()

        cancel.on_click(lambda _: question.close())

    def show_numbers(self, last: int, number: int | None) -> None:
        """Set the end of the slider to the number of the last frame, and the slider to a frame.

        Args:
            last: Number of the last frame.
            number: Number of the frame; None leaves the slider to the viewer who moves it.
        """
        self.frame.max = max(last, 1)
        if number is not None:
            self.frame.value = min(number, max(last, 1))

    def offer_fields(self, fields: list[str]) -> None:
        """Offer fields to color by."""
        _offer(self.color, (AS_DRAWN, *fields))

    def offer_plots(self, names: list[str]) -> None:
        """Offer plots."""
        _offer(self.plot, (NO_PLOT, *names))

    def show_bar(self, content: str) -> None:
        """Show a color bar (field_values.color_bar), "" for none."""
        self._bar.content = content
        self._bar.visible = bool(content)

    def show_plot(self, plot: Plot | None) -> None:
        """Show a plot, None for none."""
        if plot is None or not plot.curves or not len(plot.time):
            if self._chart is not None:
                self._chart.remove()
                self._chart = None
            return
        data = (plot.time, *plot.curves.values())
        series = ({"label": "time [s]"}, *(
            {"label": label, "stroke": CURVE_COLORS[k % len(CURVE_COLORS)], "width": 1.5}
            for k, label in enumerate(plot.curves)
        ))  # fmt: skip
        if self._chart is not None:
            if (self._chart.title, len(self._chart.series)) == (plot.title, len(series)):
                self._chart.data = data
                return
            self._chart.remove()
        with self._curves:
            self._chart = self.gui.add_uplot(
                data, series, title=plot.title, scales={"x": {"time": False}}, height=PLOT_HEIGHT
            )

    def show_picture(self, picture: np.ndarray, label: str) -> None:
        """Show a picture, uint8 (height, width, 3)."""
        self._picture.image = picture
        self._picture.label = label
        self._picture.visible = True


def paragraphs(lines: Iterable[str]) -> str:
    """Return lines as HTML."""
    inner = "".join(f"<div>{html.escape(line)}</div>" for line in lines)
    return f'<div id="vgmpi-status" style="font-size:0.85em;padding:0.4em 0.8em">{inner}</div>'


def _offer(dropdown: Any, options: tuple[str, ...]) -> None:
    """Set the options of a dropdown; a choice that is no longer one becomes the first."""
    if tuple(dropdown.options) != options:
        choice = dropdown.value
        dropdown.options = options
        dropdown.value = choice if choice in options else options[0]
