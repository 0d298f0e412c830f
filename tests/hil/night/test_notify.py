"""Telling somebody: over a loopback HTTP receiver, with apprise and without, and never at the cost of a night."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from hil.config import Bench, load_bench, parse_bench, parse_sweep
from hil.config.people import NotifySection, addresses_of
from hil.errors import InputError
from hil.night import start_night
from hil.night.notify import Notifier, send
from hil.records import open_readonly
from tests.hil.short_sweeps import short_sweep

SHORT = parse_sweep(short_sweep(), "short.yaml")


class Receiver:
    """An HTTP server on a free port of this machine that keeps what it is sent."""

    def __init__(self) -> None:
        received: list[dict[str, str]] = []

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                received.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
                self.send_response(200 if "refuse" not in self.path else 500)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self.received = received
        self._server = HTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"127.0.0.1:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02})
        self._thread.start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    """A receiver."""
    opened = Receiver()
    yield opened
    opened.close()


@pytest.fixture
def without_apprise(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine where only the core is installed."""
    monkeypatch.setitem(sys.modules, "apprise", None)


def notifying(address: str, folder: Path) -> Bench:
    """Return the simulated bench with the address in a file that it names."""
    (folder / "address").write_text(f"# who is told\n{address}\n")
    bench = load_bench("simulated")
    return parse_bench(f"{bench.text}\nnotify: {{to: ['file:{folder / 'address'}']}}\n", bench.source)


def test_a_night_tells_that_it_started_and_how_it_finished(
    receiver: Receiver, tmp_path: Path, without_apprise: None
) -> None:
    """With the numbers; the address stands nowhere in the night's folder."""
    bench = notifying(f"http://{receiver.address}/token-of-mine", tmp_path)
    assert start_night(tmp_path / "night", SHORT, bench, who="rk").state == "complete"
    started, finished = receiver.received
    assert started["title"] == "simulated SIMULATED, night: started"
    assert "expected end 1985-10-01" in started["text"]
    assert finished["title"].endswith("finished")
    assert "complete: every step is done; INCONCLUSIVE; 1 of 1 self-calibrations; " in finished["text"]
    for path in (tmp_path / "night").rglob("*"):
        assert not path.is_file() or b"token-of-mine" not in path.read_bytes(), path


def test_a_notification_that_fails_is_on_record_without_its_address_and_harms_nothing(
    receiver: Receiver, tmp_path: Path, without_apprise: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A receiver that refuses, and a variable that is not set."""
    monkeypatch.setattr(threading.Event, "wait", lambda self, *_: self.is_set())
    bench = notifying(f"http://{receiver.address}/refuse/token-of-mine", tmp_path)
    assert start_night(tmp_path / "night", SHORT, bench).state == "complete"
    with open_readonly(tmp_path / "night") as journal:
        failed = [event.message for event in journal.events() if event.kind == "notification-failed"]
    assert len(failed) == 2
    assert "was not sent: HTTPError" in failed[0]
    assert "token-of-mine" not in " ".join(failed)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # apprise's own imports
def test_apprise_sends_what_it_understands(receiver: Receiver) -> None:
    """`json://` is apprise's own POST."""
    pytest.importorskip("apprise")
    send(f"json://{receiver.address}/", "a title", "a text")
    assert (receiver.received[0]["title"], receiver.received[0]["message"]) == ("a title", "a text")
    with pytest.raises(InputError, match="does not understand"):
        send("no-such-service://x", "a title", "a text")


def test_without_apprise_a_webhook_still_works_and_the_rest_says_what_is_missing(
    receiver: Receiver, without_apprise: None
) -> None:
    """The core needs no extra."""
    send(f"http://{receiver.address}/hook", "a title", "a text")
    assert receiver.received == [{"title": "a title", "text": "a text"}]
    with pytest.raises(InputError, match=r"pip install 'hil\[notify\]'"):
        send("mailto://x", "a title", "a text")


def test_an_address_in_the_bench_file_is_refused_and_not_repeated() -> None:
    """The bench file is kept in every night's journal; so an address does not belong there."""
    bench = load_bench("simulated")
    for to in ("https://hooks.example/secret", "secret", "env:", "file://secret"):
        with pytest.raises(InputError, match="env:NAME nor file:PATH") as refused:
            parse_bench(f"{bench.text}\nnotify: {{to: ['{to}']}}\n", "bench.yaml")
        assert "secret" not in str(refused.value)


def test_references_say_what_is_wrong_with_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A variable, a file, several addresses, none."""
    monkeypatch.setenv("HIL_NOTIFY_TEST", "json://a json://b")
    assert addresses_of("env:HIL_NOTIFY_TEST") == ["json://a", "json://b"]
    (tmp_path / "empty").write_text("# nobody\n")
    for reference, words in (
        ("env:HIL_NO_SUCH_VARIABLE", "not set"),
        (f"file:{tmp_path / 'none'}", "no such file"),
        (f"file:{tmp_path / 'empty'}", "holds no address"),
    ):
        with pytest.raises(InputError, match=words):
            addresses_of(reference)


def test_only_what_was_asked_for_is_told_and_another_try_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Topics; a receiver that fails once; a section that is absent."""
    monkeypatch.setenv("HIL_NOTIFY_TEST", "json://a")
    sent: list[str] = []
    tries: list[str] = []

    def sender(_address: str, title: str, _text: str) -> None:
        tries.append(title)
        if len(tries) == 1:
            raise ConnectionError
        sent.append(title)

    failures: list[str] = []
    section = NotifySection(to=("env:HIL_NOTIFY_TEST",), about=("fault",))
    notifier = Notifier(section, "lab", failures.append, sender=sender, wait_s=0.01)
    notifier.tell("started", "x")
    notifier.hear("event", {"kind": "interlock", "message": "the chamber is too hot"})
    notifier.hear("event", {"kind": "retry", "message": "x"})
    notifier.hear("step ends", {"kind": "interlock"})
    notifier.close()
    assert (sent, failures) == (["lab: fault"], [])
    assert len(tries) == 2
    Notifier(None, "lab", failures.append).close()
