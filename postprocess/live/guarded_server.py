"""viser's server behind checks of every request: its address, its origin, a token, its messages.

viser has no options for them. `start_server` therefore replaces the function that opens viser's
port while the server starts: the port is the one that is asked for and no other, and each request,
also that of a web socket, passes `AccessRules` first, and each message a `MessageFilter`. If viser
opened a port in another way, the server is stopped.

viser sets any property of a control to whatever a message holds. Each message therefore passes
`MessageFilter` before viser sees it: a camera of finite numbers, or a value that its control has.
"""

import contextlib
import hmac
import http
import http.cookies
import io
import logging
import math
import socket
import urllib.parse
from collections.abc import Awaitable, Callable, Iterator
from typing import Any, NamedTuple

from vgmpi.io.run_reader import RunError

log = logging.getLogger("vgmpi")

MAX_MESSAGE = 1 << 16  # [bytes] of one message of a viewer; those of a browser have less than 1 kB
MAX_NUMBER = 1e9  # of a camera, whose unit of length is a grid cell
CAMERA_VECTORS = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3}
CAMERA_NUMBERS = ("fov", "near", "far")
CAMERA_SIZES = ("image_height", "image_width")  # [pixels]
MAX_WINDOW = 1 << 16  # [pixels] edge of a viewer's window
LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")  # names of this machine in an address
SCHEMES = ("http", "https")  # https: behind a proxy that encrypts
MISSING_VISER = 'the live page needs the package viser: pip install "vgmpi[live]"'


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


class AccessRules(NamedTuple):
    """Rules by which a request is answered or refused."""

    token: str | None  # required of every request; None: requests by a name of this machine only
    port: int  # of the server; browsers do not tell cookies of different ports apart

    @property
    def cookie(self) -> str:
        """Name of the cookie with the token."""
        return f"vgmpi_live_{self.port}"

    def refusal(self, headers: Any) -> str:
        """Return why the Host and Origin headers of a request are refused, "" if they are not.

        A page of another site may open a web socket to this machine, but cannot hide its origin;
        and it may give its own name the address of this machine, but then Host is that name.
        """
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) > 1:
            return "a request has one Host and at most one Origin"
        try:
            name = urllib.parse.urlsplit(f"//{hosts[0]}").hostname or ""
        except ValueError:  # a bracket without its other one
            return "the Host of a request is a name or an address"
        if self.token is None and name not in LOCAL_NAMES:
            return f"without a token the page answers to {', '.join(LOCAL_NAMES)} only"
        if origins and origins[0].lower() not in (f"{s}://{hosts[0].lower()}" for s in SCHEMES):
            return "the request comes from a page of another origin"
        return ""

    def token_of_path(self, path: str) -> str | None:
        """Return the token in the query of an address, None without one."""
        try:
            query = urllib.parse.urlsplit(path).query
            return urllib.parse.parse_qs(query).get("token", [None])[0]
        except ValueError:  # no address, or of too many fields
            return None

    def has_cookie(self, headers: Any) -> bool:
        """Return whether a request has the cookie with the token."""
        cookies: http.cookies.SimpleCookie = http.cookies.SimpleCookie()
        for text in headers.get_all("Cookie"):
            with contextlib.suppress(http.cookies.CookieError):
                cookies.load(text)
        return self.cookie in cookies and self.is_token(cookies[self.cookie].value)

    def is_token(self, word: str) -> bool:
        """Return whether a word is the token; the time it takes tells nothing about it."""
        sent = word.encode(errors="replace")
        return self.token is not None and hmac.compare_digest(sent, self.token.encode())


def start_server(host: str, rules: AccessRules, sock: socket.socket, title: str) -> Any:
    """Return a running viser.ViserServer that answers on a socket by the rules.

    Args:
        host: Name of the interface.
        rules: Rules of access.
        sock: Bound socket.
        title: Title of the page's panel.

    Raises:
        RunError: viser is missing, or does not let its port be guarded.
    """
    try:
        import viser
        import websockets.asyncio.server as websocket_server
    except ImportError:
        raise RunError(MISSING_VISER) from None
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    original, opened, messages = websocket_server.serve, [], MessageFilter()

    def serve(handler, *_address, process_request, **options):
        """Open the socket in the place of viser's address, and check requests."""

        def check_request(connection, request):
            """Return the answer to a request; None lets a web socket open."""
            if reason := rules.refusal(request.headers):
                return _answer(http.HTTPStatus.FORBIDDEN, reason)
            if rules.token is not None and not rules.has_cookie(request.headers):
                word = rules.token_of_path(request.path)
                if word is None or not rules.is_token(word):
                    reason = "wrong or missing token: open the address that vgmpi live has printed"
                    return _answer(http.HTTPStatus.FORBIDDEN, reason)
                cookie = f"{rules.cookie}={word}; HttpOnly; SameSite=Strict; Path=/"
                return _answer(http.HTTPStatus.SEE_OTHER, "", Location="/", Set_Cookie=cookie)
            return process_request(connection, request)

        opened.append(True)
        options["max_size"] = MAX_MESSAGE
        handler = messages.before(handler)
        return original(handler, sock=sock, process_request=check_request, **options)

    websocket_server.serve = serve  # type: ignore[assignment,misc]
    try:
        with silent_output():
            server = viser.ViserServer(host, rules.port, label=title, verbose=False)
    finally:
        websocket_server.serve = original  # type: ignore[misc]
    if not opened:
        stop_server(server)
        raise RunError(f"viser {viser.__version__} opens its port unguarded: install viser 1.1")
    messages.watch_controls(server.gui)
    # viser can publish a page through a server of its makers; no browser may ask for that
    server.request_share_url = lambda *_, **__: None  # type: ignore[method-assign,assignment]
    return server


def _answer(status: http.HTTPStatus, text: str, **headers: str) -> Any:
    """Return a short answer of the package websockets."""
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    body = f"{text}\n".encode()
    fields = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))}
    fields |= {name.replace("_", "-"): value for name, value in headers.items()}
    return Response(status, status.phrase, Headers(**fields), body)


def stop_server(server: Any) -> None:
    """Stop a server; viser prints a line about it, which is discarded."""
    with silent_output():
        server.stop()


@contextlib.contextmanager
def silent_output() -> Iterator[None]:
    """Discard what is printed."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def open_socket(host: str, port: int) -> socket.socket:
    """Return a socket bound to an address; port 0 is any free one.

    Raises:
        RunError: The address is not of this machine, or the port is taken; one line.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        sock = socket.socket(family, kind, protocol)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.bind(address)
            sock.listen()
        except OSError:
            sock.close()
            raise
    except OSError as error:
        remedy = "--port takes another, --port 0 any free one"
        raise RunError(f"--port {port} on {host}: {error.strerror}: {remedy}") from None
    return sock
