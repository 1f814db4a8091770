"""Who may see the live page: its address, foreign pages, tokens, paths, many viewers, its end."""

import http.client
import os
import re
import signal
import socket
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.support import drawn_runs
from tests.support.launch import run, until
from tests.support.live_pages import ROW_BYTES, LivePageProcess, Viewer
from vgmpi.commands import cli
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import live

viser = pytest.importorskip("viser", reason='needs viser: pip install "vgmpi[live]"')
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

PROTOCOL = [f"viser-v{viser.__version__}"]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=3)


@pytest.fixture(scope="module")
def page(out):
    with LivePageProcess(out, "--port", 0) as process:
        yield process


@pytest.fixture(scope="module")
def guarded(out, tmp_path_factory):
    word = tmp_path_factory.mktemp("token") / "token.txt"
    word.write_text("secret-word\n")
    word.chmod(0o600)
    with LivePageProcess(out, "--port", 0, "--host", "0.0.0.0", "--token-file", word) as process:
        yield process


def ask(page, path="/", headers=None):
    """Status and headers of the answer to a request."""
    port = urlsplit(page.address).port
    link = http.client.HTTPConnection("127.0.0.1", port)
    link.putrequest("GET", path, skip_host="Host" in (headers or {}))
    for name, value in (headers or {}).items():
        link.putheader(name, value)
    link.endheaders()
    answer = link.getresponse()
    body = answer.read()
    link.close()
    return answer.status, dict(answer.getheaders()), body


def greeted(page, **options):
    """Open a web socket as a browser does; return whether viser speaks on it."""
    port = urlsplit(page.address).port
    with connect(
        f"ws://127.0.0.1:{port}/", subprotocols=PROTOCOL, max_size=None, **options
    ) as link:
        return len(link.recv(timeout=60)) > 0


def test_the_page_is_served_to_this_machine(page):
    status, _, body = ask(page)
    assert status == 200 and b"<html" in body
    port = urlsplit(page.address).port
    assert greeted(page) and greeted(page, origin=f"http://127.0.0.1:{port}")


@pytest.mark.parametrize("origin", ["https://example.org", "null", "http://127.0.0.1:1"])
def test_pages_of_other_origins_are_refused(page, origin):
    with pytest.raises(InvalidStatus) as refused:
        greeted(page, origin=origin)
    assert refused.value.response.status_code == 403
    assert ask(page, headers={"Origin": origin})[0] == 403


@pytest.mark.parametrize(
    "host", ["example.org", "example.org:80", "127.0.0.1.example.org", "", "["]
)
def test_a_name_that_another_site_gives_to_this_machine_is_refused(page, host):
    assert ask(page, headers={"Host": host})[0] == 403
    with pytest.raises(InvalidStatus):
        greeted(page, additional_headers={"Host": host}, origin=f"http://{host}")


@pytest.mark.parametrize(
    "path",
    ["/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%5c..%5cetc", "//etc/passwd"],
)
def test_no_path_leads_outside(page, path):
    assert ask(page, path)[0] == 404


def test_a_token_opens_the_page(guarded):
    assert guarded.address.endswith("/?token=secret-word") and "0.0.0.0" not in guarded.address
    for path in ("/", "/?token=", "/?token=wrong-word", "/?token=secret-wor%C3%A9", "/assets/x.js"):
        status, _, body = ask(guarded, path)
        assert status == 403 and b"token" in body
    status, headers, _ = ask(guarded, "/?token=secret-word")
    cookie = headers["Set-Cookie"].split(";")[0]
    assert (
        status == 303 and headers["Location"] == "/" and "SameSite=Strict" in headers["Set-Cookie"]
    )
    assert ask(guarded, headers={"Cookie": cookie})[0] == 200
    assert ask(guarded, headers={"Cookie": cookie.replace("secret", "wrong")})[0] == 403
    assert greeted(guarded, additional_headers={"Cookie": cookie})
    for headers in ({}, {"Cookie": "a=b"}):
        with pytest.raises(InvalidStatus):
            greeted(guarded, additional_headers=headers)
    with pytest.raises(InvalidStatus):
        greeted(guarded, additional_headers={"Cookie": cookie}, origin="https://example.org")


def test_a_host_that_is_not_local_has_a_random_token(out):
    words = [str(out), "--host", "0.0.0.0"]
    tokens = {live.choose_token(live.parser().parse_args(words)) for _ in range(3)}
    assert len(tokens) == 3 and all(len(token) > 20 for token in tokens)
    assert live.choose_token(live.parser().parse_args([str(out)])) is None
    assert live.choose_token(live.parser().parse_args([str(out), "--token"])) is not None


def test_the_word_of_a_token_is_on_no_command_line(guarded):
    """Every user of a machine can read the command lines of its processes."""
    words = Path(f"/proc/{guarded.process.pid}/cmdline").read_bytes()
    assert b"--token-file" in words and b"secret-word" not in words
    with pytest.raises(SystemExit):
        live.parser().parse_args(["out", "--token=secret-word"])


def test_a_file_that_others_may_read_is_no_token(out, tmp_path, capfd):
    word = tmp_path / "token.txt"
    word.write_text("secret-word\n")
    word.chmod(0o644)
    assert live.main([str(out), "--port", "0", "--token-file", str(word)]) == 2
    message = capfd.readouterr().err.strip()
    assert "chmod 600" in message and "\n" not in message


def test_ten_viewers_get_the_frame(page, out):
    """Each is sent all Gaussians; viewers that go at once leave the page and the others alone."""
    address = f"ws://127.0.0.1:{urlsplit(page.address).port}/"
    count = RunReader(out).particle_count(0)
    viewers = [Viewer(address) for _ in range(10)]
    try:
        for viewer in viewers:
            viewer.wait_for(ROW_BYTES * count, 0.0)
        for viewer in viewers[:5]:
            viewer.link.socket.close()
        late = Viewer(address)
        late.wait_for(ROW_BYTES * count, 0.0)
        late.close()
    finally:
        for viewer in viewers[5:]:
            viewer.close()
    assert page.process.poll() is None and ask(page)[0] == 200


def test_a_port_that_is_taken_is_named(page, out, capfd):
    port = urlsplit(page.address).port
    assert live.main([str(out), "--port", str(port)]) == 2
    message = capfd.readouterr().err.strip()
    assert str(port) in message and "in use" in message and "\n" not in message


def test_ctrl_c_ends_with_one_line(out):
    with LivePageProcess(out, "--port", 0) as process:
        greeted(process)
        code, rest, err = process.stop(signal.SIGINT)
    assert (code, err) == (130, "")
    assert rest == "the live page has ended\n"


def test_a_page_without_viewers_ends_when_it_should(out):
    with LivePageProcess(out, "--port", 0, "--linger", "0.5") as process:
        out, err = process.process.communicate(timeout=120)
    assert process.process.returncode == 0 and err == ""


@pytest.mark.parametrize(
    "words, says",
    [
        (["{none}"], "no such folder"),
        (["{out}", "--port", "70000"], "--port"),
        (["{out}", "--particles", "0"], "--particles"),
        (["{out}", "--particles", "300001"], "300000"),
        (["{out}", "--linger", "nan"], "--linger"),
        (["{out}", "--token-file", "{none}"], "--token-file"),
        (["{out}", "--token-file", "{short}"], "--token-file"),
        (["{out}", "--token-file", "{words}"], "--token-file"),
        (["{out}", "--host", "no.such.host.invalid"], "no.such.host.invalid"),
        (["{out}", "{none}.toml"], "none.toml"),
    ],
)
def test_mistakes_end_with_code_2_and_one_line(out, tmp_path, words, says, capfd):
    names = {"none": tmp_path / "none", "out": out}
    for name, text in (("short", "short"), ("words", "a b; c=12345")):
        names[name] = tmp_path / name
        names[name].write_text(text)
        names[name].chmod(0o600)
    assert live.main([word.format(**names) for word in words]) == 2
    message = capfd.readouterr().err.strip()
    assert says in message and "\n" not in message


def test_without_viser_one_line_says_what_to_install(out, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert live.main([str(out), "--port", "0"]) == 2
    message = capfd.readouterr().err.strip()
    assert 'pip install "vgmpi[live]"' in message and "\n" not in message


def test_a_viser_that_cannot_be_guarded_is_not_used(monkeypatch):
    """Where viser opened its port by other means, nobody would check the requests."""
    from vgmpi.io.run_reader import RunError
    from vgmpi.postprocess.live import guarded_server

    stopped = []

    class Server:
        def __init__(self, *_, **__):
            pass

        def stop(self):
            stopped.append(True)

    monkeypatch.setattr(viser, "ViserServer", Server)
    with socket.socket() as sock, pytest.raises(RunError, match="unguarded"):
        guarded_server.start_server("127.0.0.1", guarded_server.AccessRules(None, 1), sock, "")
    assert stopped


def test_no_browser_publishes_the_page():
    """viser's share button asks a server of its makers for a public address."""
    from vgmpi.postprocess.live import guarded_server

    sock = guarded_server.open_socket("127.0.0.1", 0)
    rules = guarded_server.AccessRules(None, sock.getsockname()[1])
    server = guarded_server.start_server("127.0.0.1", rules, sock, "")
    try:
        assert server.request_share_url() is None and server._share_tunnel is None
    finally:
        guarded_server.stop_server(server)


def test_a_run_starts_its_page(tmp_path):
    """The page survives the run and its output does not hold up the launcher."""
    from tests.support.live_pages import SCENE

    (tmp_path / "scene.toml").write_text(SCENE.replace("4 s", "0.01 s").replace("401", "3"))
    command = [sys.executable, "-m", "vgmpi", tmp_path / "scene.toml", "-o", tmp_path / "out"]
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port = sock.getsockname()[1]
    done = run([*command, "--live", port])
    assert done.returncode == 0, done.stderr
    assert f"http://localhost:{port}/" in done.stdout
    link = http.client.HTTPConnection("127.0.0.1", port)
    link.request("GET", "/")
    assert link.getresponse().status == 200
    link.close()
    until(lambda: (tmp_path / "out/live.log").exists(), "its log")
    os.kill(int(re.search(r"process (\d+)", done.stdout)[1]), signal.SIGTERM)
    until(lambda: "has ended" in (tmp_path / "out/live.log").read_text(), "its end")


@pytest.mark.parametrize(
    "words, says",
    [
        (["--check", "--live"], "--live is for a run"),
        (["--plan", "--live", "8081"], "--live is for a run"),
        (["--live", "70000"], "0 to 65535"),
    ],
)
def test_flags_of_a_page_that_no_run_starts_are_refused(words, says, capsys):
    with pytest.raises(SystemExit) as end:
        cli.parse_arguments(["scene.toml", *words])
    assert end.value.code == 2 and says in capsys.readouterr().err
