"""viser's server behind checks of every request: its address, its origin, a token, its messages.

viser has no options for them. `start_server` therefore replaces the function that opens viser's
port while the server starts: the port is the one that is asked for and no other, and each request,
also that of a web socket, passes `AccessRules` first, and each message a `MessageFilter`. If viser
opened a port in another way, the server is stopped.
"""

import contextlib
import hmac
import http
import http.cookies
import io
import logging
import socket
import urllib.parse
from collections.abc import Iterator
from typing import Any, NamedTuple

from vgmpi.io.run_reader import RunError

from .viewer_messages import MAX_MESSAGE, MessageFilter

LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")  # names of this machine in an address
SCHEMES = ("http", "https")  # https: behind a proxy that encrypts
MISSING_VISER = 'the live page needs the package viser: pip install "vgmpi[live]"'


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
