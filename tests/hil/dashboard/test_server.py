"""Who may read the live page and who may ask: hosts, tokens, methods, headers; and how the server is told to go."""

from __future__ import annotations

import json
import socket
import stat
from collections.abc import Iterator
from contextlib import ExitStack, closing
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from drivers.clock import VirtualClock
from hil.cli.app import run
from hil.dashboard import server as server_module
from hil.dashboard.access import Access, is_loopback, new_token, token_from, url
from hil.dashboard.server import listen
from hil.errors import InputError
from hil.records import SqliteJournal, open_readonly
from hil.records.rows import Night
from procedures.plan import make_plan
from procedures.settings import SweepProcedure
from tests.hil.dashboard.live_page import TOKEN, Dashboard, served


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with one night whose controller lives in this process and hears nobody."""
    folder = tmp_path_factory.mktemp("nights")
    (folder / "night").mkdir()
    plan = make_plan(SweepProcedure(title="<b>A title</b>", temperatures_degC=(20.0,)))
    clock = VirtualClock()
    SqliteJournal.create(folder / "night", plan, Night(plan.title, "rk", clock.utc(), True, "bench: {name: b}"))
    with SqliteJournal.open(folder / "night", clock=clock, who="rk"):
        yield folder


@pytest.fixture(scope="module", params=["127.0.0.1", "192.0.2.7"], ids=["loopback", "beyond"])
def server(nights: Path, request: pytest.FixtureRequest) -> Iterator[tuple[int, Access]]:
    """A server in this process; with the rules of one that listens beyond this machine, too."""
    access = Access(TOKEN, request.param)
    with served(nights, access) as port:
        yield port, access


@pytest.fixture
def ask(server: tuple[int, Access]) -> Iterator[Any]:
    """Send one request and return the answer, with its body unless that is a stream."""
    connections = []

    def send(method: str, path: str, body: object = None, **headers: str) -> tuple[HTTPResponse, bytes]:
        connection = HTTPConnection("127.0.0.1", server[0], timeout=10.0)
        connections.append(connection)
        data = body if isinstance(body, bytes) else None if body is None else json.dumps(body).encode()
        connection.request(method, path, data, {name.replace("_", "-"): value for name, value in headers.items()})
        answer = connection.getresponse()
        streams = answer.getheader("content-type", "").startswith("text/event-stream")
        return answer, b"" if streams else answer.read()

    yield send
    for connection in connections:
        connection.close()


BEARER = f"Bearer {TOKEN}"


def test_reading_takes_the_token_as_soon_as_others_than_this_machine_can_read(
    ask: Any, server: tuple[int, Access]
) -> None:
    """The page itself holds nothing of a night, so it may come before the token."""
    beyond = not is_loopback(server[1].host)
    assert ask("GET", "/")[0].status == 200
    assert ask("GET", "/api/stream")[0].status == (401 if beyond else 200)
    assert ask("GET", "/api/stream", authorization="Bearer nonsense")[0].status == (401 if beyond else 200)
    answer, _ = ask("GET", "/api/stream", authorization=BEARER)
    assert answer.status == 200
    first = json.loads(answer.readline()[6:])
    assert first["nights"]["night"]["head"]["title"] == "<b>A title</b>"


@pytest.mark.parametrize("given", ["", "Bearer ", "Bearer x", f"Basic {TOKEN}", TOKEN, f"bearer{TOKEN}", f"{BEARER}x"])
def test_nobody_asks_without_the_token(ask: Any, nights: Path, given: str) -> None:
    """Neither is a token taken from the address. Nothing reaches the journal."""
    asked = {"night": "night", "kind": "abort", "who": "eve"}
    answer, _ = ask("POST", f"/api/ask?token={TOKEN}", asked, authorization=given)
    assert answer.status == 401
    with open_readonly(nights / "night") as journal:
        assert "eve (live page)" not in [row.who for row in journal.requests()]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"kind": "explode"}, "kind: one of abort"),
        ({"kind": ["abort"]}, "kind: one of abort"),
        ({"kind": {"abort": 1}}, "kind: one of abort"),
        ({"who": "  "}, "a name is needed"),
        ({"who": "x" * 61}, "at most 60"),
        ({"who": "a\nb"}, "one line"),
        ({"why": 7}, "why"),
        ({"kind": "confirm"}, "number of the question"),
        ({"kind": "confirm", "prompt": True}, "number of the question"),
        ({"kind": "refuse", "prompt": 10**30}, "number of the question"),
        ({"night": ["night"]}, "no such night"),
        ({"night": "../../etc"}, "no such night"),
    ],
)
def test_what_is_no_request_is_refused_in_a_sentence(ask: Any, changes: dict[str, Any], complaint: str) -> None:
    """Bad input changes nothing."""
    sent = {"night": "night", "kind": "pause", "who": "mallory"} | changes
    answer, body = ask("POST", "/api/ask", sent, authorization=BEARER)
    assert answer.status == (409 if complaint == "no such night" else 400)
    assert complaint in json.loads(body)["error"]


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b"\xff", b"[" * 8000, b"x" * 20_000])
def test_what_is_no_document_is_refused(ask: Any, body: bytes) -> None:
    """Neither does a long one fill the memory."""
    answer, said = ask("POST", "/api/ask", body, authorization=BEARER)
    assert answer.status == 400
    assert "what was sent is" in json.loads(said)["error"]


def test_a_request_stands_in_the_journal_with_its_name_even_where_no_answer_comes(
    ask: Any, nights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The controller of this test hears nobody: the page is told that it has not answered."""
    monkeypatch.setattr("hil.dashboard.server._ANSWER_S", 0.0)
    sent = {"night": "night", "kind": "pause", "who": "ann", "why": "tea"}
    answer, body = ask("POST", "/api/ask", sent, authorization=BEARER)
    assert (answer.status, json.loads(body)["accepted"]) == (200, None)
    with open_readonly(nights / "night") as journal:
        assert ("pause", "ann (live page)", "tea") in [(row.kind, row.who, row.why) for row in journal.requests()]


def test_a_night_is_there_before_anybody_has_looked_at_it(nights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page that was open before the server began again asks at once, and on a busy machine before the first look."""
    monkeypatch.setattr("hil.dashboard.server._ANSWER_S", 0.0)
    monkeypatch.setattr("hil.dashboard.watcher.Watcher.look", lambda _watcher: {})
    with served(nights, Access(TOKEN, "127.0.0.1")) as port, closing(HTTPConnection("127.0.0.1", port)) as connection:
        sent = json.dumps({"night": "night", "kind": "pause", "who": "bob"})
        connection.request("POST", "/api/ask", sent, {"authorization": BEARER})
        assert connection.getresponse().status == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8765", "127.0.0.1.evil.example", "", "[::1].evil.example"]
)
def test_another_name_is_refused_so_that_no_page_elsewhere_can_point_its_name_here(ask: Any, host: str) -> None:
    """DNS rebinding: the browser sends the name of the other site's page as the host."""
    for path in ("/", "/api/stream", "/page/main.js"):
        assert ask("GET", path, host=host, authorization=BEARER)[0].status == 421


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost", "localhost:1", "[::1]:8765", "192.0.2.7:80"])
def test_an_address_is_no_name_that_somebody_could_point_here(ask: Any, host: str) -> None:
    """Addresses and the names of this machine are served."""
    assert ask("GET", "/", host=host)[0].status == 200


def test_every_answer_tells_the_browser_to_do_nothing_more(ask: Any) -> None:
    """Scripts and connections of this server alone, no frames, no guessing, no other origin."""
    for method, path in (("GET", "/"), ("GET", "/page/main.js"), ("GET", "/nothing"), ("POST", "/api/ask")):
        answer, _ = ask(method, path)
        policy = answer.getheader("content-security-policy")
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert answer.getheader("x-content-type-options") == "nosniff"
        assert answer.getheader("access-control-allow-origin") is None
        assert answer.getheader("server") is None


@pytest.mark.parametrize(
    ("method", "path"),
    [("POST", "/"), ("PUT", "/api/ask"), ("GET", "/api/ask"), ("DELETE", "/api/stream"), ("OPTIONS", "/api/ask")],
)
def test_there_is_no_other_method(ask: Any, method: str, path: str) -> None:
    """A preflight of another origin gets no leave."""
    assert ask(method, path)[0].status == 405


@pytest.mark.parametrize("path", ["/page/../access.py", "/page/%2e%2e/access.py", "/page/..%2faccess.py", "/page/"])
def test_only_the_pages_own_files_are_served(ask: Any, path: str) -> None:
    """No way leads out of their folder, and it is not listed."""
    assert ask("GET", path)[0].status == 404


def test_the_page_asks_nobody_else_for_anything() -> None:
    """No address of another server stands in any of its files, the plotting library's own name aside."""
    for path in (Path(__file__).parents[3] / "hil/dashboard/static").rglob("*"):
        if path.is_file() and "vendor" not in path.parts:
            text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
            assert "http://" not in text, path
            assert "https://" not in text, path
            assert "innerHTML" not in text, path  # what a night says is text, whatever it looks like


def test_a_token_file_is_made_for_its_owner_only_and_kept(tmp_path: Path) -> None:
    """A server that begins anew takes the same token, so that open pages go on."""
    path = tmp_path / "token"
    token = token_from(path)
    assert token_from(path) == token
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert len({new_token() for _ in range(100)}) == 100
    path.write_text("short")
    with pytest.raises(InputError, match="at least 12 characters"):
        token_from(path)
    with pytest.raises(InputError, match="cannot be kept"):
        token_from(tmp_path / "none" / "token")


def test_the_address_that_is_printed_is_one_that_a_browser_can_open_and_the_server_answers_to() -> None:
    """Of a server that listens everywhere it is this machine's name: 0.0.0.0 is nobody's address."""
    assert url("127.0.0.1", 8765) == "http://127.0.0.1:8765/"
    assert url("::1", 1) == "http://[::1]:1/"
    for everywhere in ("0.0.0.0", "::"):  # noqa: S104 - only named
        name = urlsplit(url(everywhere, 8765)).netloc
        assert name == f"{socket.gethostname()}:8765"
        assert Access(TOKEN, everywhere).is_addressed(name)


def test_a_token_that_others_can_read_is_told_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody made the file by hand, or copied it."""
    monkeypatch.setattr("uvicorn.Server.run", lambda *_, **__: None)
    for mode, told in ((0o600, False), (0o644, True)):
        (tmp_path / "token").write_text(TOKEN)
        (tmp_path / "token").chmod(mode)
        assert run(["dashboard", str(tmp_path), "--port", "0", "--token-file", str(tmp_path / "token")]) == 0
        assert ("others of this machine may read" in capsys.readouterr().err) is told


def test_bad_input_of_the_command_is_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder that is not there, an address that is not ours, a port that is taken."""
    assert run(["dashboard", str(tmp_path / "none")]) == 2
    assert "there is no such folder" in capsys.readouterr().err
    assert run(["dashboard", str(tmp_path), "--host", "192.0.2.1"]) == 2
    assert "cannot be listened at: this machine has no such address" in capsys.readouterr().err
    with listen("127.0.0.1", 0) as listener:
        assert run(["dashboard", str(tmp_path), "--port", str(listener.getsockname()[1])]) == 2
    assert "another program does already, perhaps an earlier hil dashboard; choose another --port" in (
        capsys.readouterr().err
    )


def _half_sent(port: int) -> socket.socket:
    """Connect, and send the beginning of a request."""
    made = socket.create_connection(("127.0.0.1", port), timeout=10.0)
    made.sendall(b"GET / HTTP/1.1\r\nhost: 127.0.0.1\r\nx-never-en")
    return made


def _answer(port: int) -> int:
    connection = HTTPConnection("127.0.0.1", port, timeout=10.0)
    connection.request("GET", "/")
    status = connection.getresponse().status
    connection.close()
    return status


def test_half_sent_requests_make_room_for_whole_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many there are, a page that asks is answered; the oldest of them are closed."""
    monkeypatch.setattr(server_module, "_WAITING", 20)
    with served(tmp_path, Access(TOKEN, "127.0.0.1")) as port, ExitStack() as held:
        halves = [held.enter_context(_half_sent(port)) for _ in range(60)]
        assert _answer(port) == 200
        closed = [half for half in halves if _is_closed(half)]
    assert closed == halves[: len(closed)]
    assert 38 <= len(closed) <= 42


def _is_closed(half: socket.socket) -> bool:
    half.setblocking(False)
    try:
        return half.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


def test_a_request_that_does_not_come_to_its_end_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its head, its body, or the next one on the same connection; a stream that was asked for goes on."""
    monkeypatch.setattr(server_module, "_PATIENCE_S", 0.05)
    head = f"POST /api/ask HTTP/1.1\r\nhost: 127.0.0.1\r\nauthorization: {BEARER}\r\ncontent-length: 9\r\n\r\n"
    whole = b"GET / HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n"
    stream = b"GET /api/stream HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n"
    with served(tmp_path, Access(TOKEN, "127.0.0.1")) as port, ExitStack() as held:
        half, body, second, streaming = (held.enter_context(_half_sent(port)) for _ in range(4))
        for each, rest in ((body, head.encode() + b"{"), (second, whole + whole[:9]), (streaming, stream)):
            each.sendall(b"ds: 1\r\n\r\n" + rest)
        assert half.recv(1) == b""
        assert b" 408 " in _all(body)
        assert _all(second).count(b"HTTP/1.1 200") == 2
        streaming.setblocking(False)
        assert streaming.recv(100_000)
        assert not _is_closed(streaming)


def _all(connection: socket.socket) -> bytes:
    """What comes until the server closes."""
    return b"".join(iter(lambda: connection.recv(65536), b""))


def test_more_connections_than_are_served_are_told_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Streams are held for good; the rest is left with files to open."""
    monkeypatch.setattr(server_module, "_CONNECTIONS", 3)
    with served(tmp_path, Access(TOKEN, "127.0.0.1")) as port, ExitStack() as held:
        for _ in range(3):
            stream = HTTPConnection("127.0.0.1", port, timeout=10.0)
            held.callback(stream.close)
            stream.request("GET", "/api/stream")
            assert stream.getresponse().status == (200 if _ < 2 else 503)


def test_a_folder_without_a_night_is_told_before_the_page_is_served(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is served: whoever begins a night opens the page before it. With a night, nothing is said."""

    class Ended:
        def run(self, **_: object) -> None:
            raise KeyboardInterrupt

    monkeypatch.setattr("hil.dashboard.server.server", lambda _: Ended())
    for journal in (False, True):
        if journal:
            (tmp_path / "night").mkdir()
            (tmp_path / "night" / "journal.sqlite").touch()
        assert run(["dashboard", str(tmp_path), "--port", "0"]) == 0
        assert ("there is no night in" in capsys.readouterr().err) != journal


def test_ctrl_c_ends_a_dashboard_as_it_should_as_soon_as_it_has_said_where_it_is(tmp_path: Path) -> None:
    """It is no failure that nobody had looked at it yet."""
    (tmp_path / "token").write_text(TOKEN)
    dashboard = Dashboard(tmp_path, tmp_path / "token")
    dashboard.begin()
    assert dashboard.end() == 0
    dashboard.begin()
    assert dashboard.end(again_s=0.03) >= 0, "pressed again while it ends it takes no exit status away"
