"""Messages of viewers: what a browser may send to the live page, and what is left out.

viser sets any property of a control to whatever a message holds. Each message therefore passes
`MessageFilter` before viser sees it: a camera of finite numbers, or a value that its control has.
"""

import logging
import math
from collections.abc import Awaitable, Callable
from typing import Any

log = logging.getLogger("vgmpi")

MAX_MESSAGE = 1 << 16  # [bytes] of one message of a viewer; those of a browser have less than 1 kB
MAX_NUMBER = 1e9  # of a camera, whose unit of length is a grid cell
CAMERA_VECTORS = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3}
CAMERA_NUMBERS = ("fov", "near", "far")
CAMERA_SIZES = ("image_height", "image_width")  # [pixels]
MAX_WINDOW = 1 << 16  # [pixels] edge of a viewer's window


class MessageFilter:
    """Filter of the messages of all viewers of a page."""

    def __init__(self) -> None:
        """Make a filter of a page without controls."""
        self._gui: Any = None
        self._told: set[str] = set()  # reasons that the log has

    def watch_controls(self, gui: Any) -> None:
        """Let values of the controls of viser's gui pass."""
        self._gui = gui

    def before(self, handler: Callable[..., Awaitable]) -> Callable[..., Awaitable]:
        """Return a handler of connections to which only the messages come that pass."""

        async def handle_filtered(connection: Any) -> None:
            """Handle a connection."""
            await handler(FilteredConnection(connection, self))

        return handle_filtered

    def passes(self, raw: object) -> bool:
        """Return whether a message is one for viser; log once why others are left out."""
        try:
            reason = self._refusal(raw)
        except Exception as error:  # whatever a decoder raises for bytes from outside
            reason = f"it cannot be read ({type(error).__name__})"
        if reason and reason not in self._told:
            self._told.add(reason)
            log.warning("a message of a viewer is ignored: %s", reason)
        return not reason

    def _refusal(self, raw: object) -> str:
        """Return why a message is ignored, "" if it is not."""
        import msgspec

        if not isinstance(raw, bytes):
            return "it is text"
        message = msgspec.msgpack.decode(raw)
        if not isinstance(message, dict):
            return "it has no type"
        kind = message.pop("type", None)
        if kind == "ViewerCameraMessage":
            return "" if is_camera(message) else "its camera has other than finite numbers"
        if kind == "GuiUpdateMessage":
            return self._refusal_of_update(message)
        return "its type is none of those of this page"

    def _refusal_of_update(self, message: dict) -> str:
        """Return why a change of a control is ignored, "" if it is not."""
        uuid, updates = message.get("uuid"), message.get("updates")
        if len(message) != 2 or not isinstance(uuid, str) or not isinstance(updates, dict):
            return "it has other keys than a change of a control"
        control = None if self._gui is None else self._gui._gui_input_handle_from_uuid.get(uuid)
        if control is None:
            return ""  # of a control that has gone, which viser ignores
        if list(updates) != ["value"]:
            return f"it changes more than the value of {control.label!r}"
        if not allows(control, updates["value"]):
            return f"{control.label!r} has no such value"
        return ""


def is_camera(message: dict) -> bool:
    """Return whether the keys of a message are those of a camera, with finite numbers."""
    names = {*CAMERA_VECTORS, *CAMERA_NUMBERS, *CAMERA_SIZES}
    if message.keys() != names:
        return False
    for name, count in CAMERA_VECTORS.items():
        vector = message[name]
        if not isinstance(vector, list) or len(vector) != count or not all(map(_is_finite, vector)):
            return False
    sizes = [message[name] for name in CAMERA_SIZES]
    return all(_is_finite(message[name]) for name in CAMERA_NUMBERS) and all(
        isinstance(size, int) and 0 < size <= MAX_WINDOW for size in sizes
    )


def allows(control: Any, value: object) -> bool:
    """Return whether a control of viser can have a value, by its choices, its type and its range.

    Args:
        control: Button, dropdown, checkbox, slider or number of viser.
        value: The value.
    """
    if control._impl.is_button:
        return value is True
    if hasattr(control, "options"):
        return isinstance(value, str) and value in control.options
    if isinstance(control.value, bool):
        return isinstance(value, bool)
    if isinstance(control.value, (int, float)) and _is_finite(value):
        is_integer = isinstance(value, int) or float(value).is_integer()  # type: ignore[arg-type]
        return control.min <= value <= control.max and (  # type: ignore[operator]
            is_integer or isinstance(control.value, float)
        )
    return False


def _is_finite(value: object) -> bool:
    """Return whether a value is a number of bounded magnitude."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and abs(value) <= MAX_NUMBER  # type: ignore[arg-type,operator]


class FilteredConnection:
    """Web socket of a viewer from which the messages of a filter come, and no others."""

    def __init__(self, connection: Any, messages: MessageFilter):
        """Filter what comes from a connection of websockets."""
        self._connection, self._messages = connection, messages

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the connection."""
        return getattr(self._connection, name)

    async def recv(self, *arguments: Any, **keywords: Any) -> bytes:
        """Return the next message that passes."""
        while True:
            raw = await self._connection.recv(*arguments, **keywords)
            if self._messages.passes(raw):
                return raw
