"""One port has one owner, whatever it is called: the second is refused before it sends a byte."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
import yaml

from drivers.errors import TransportError
from hil.bench import build_bench, lock
from hil.bench.lock import bench_lock, port_lock, port_names
from hil.config import Bench, load_bench, load_sweep, parse_bench
from hil.errors import InputError
from hil.night import start_night


@pytest.fixture(autouse=True)
def _locks_of_our_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "locks").mkdir()
    monkeypatch.setattr(lock, "_RUNTIME", tmp_path / "locks")


def on(chamber: str) -> Bench:
    """Return a bench whose chamber is at this port, its unit in this process."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["chamber"] |= {"driver": "simserv", "model": "", "port": chamber}
    document["clock"] = "system"
    return parse_bench(yaml.safe_dump(document), "bench.yaml")


@pytest.mark.slow
def test_a_second_controller_under_another_name_sends_nothing(tmp_path: Path) -> None:
    """The first one's chamber is not even connected to: neither by a night nor by a command."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        server.settimeout(0.0)
        number = server.getsockname()[1]
        second = on(f"socket://localhost:{number}")
        owned = f"another controller owns the bench.*process {os.getpid()}.*first"
        with bench_lock(on(f"socket://127.0.0.1:{number}"), tmp_path / "first"), pytest.raises(InputError, match=owned):
            start_night(tmp_path / "second", load_sweep("quick"), second)
        release = port_lock(f"rfc2217://[::1]:{number}")
        with pytest.raises(TransportError, match=rf"somebody else has the port open \(process {os.getpid()}"):
            build_bench(second)
        release()
        with pytest.raises(BlockingIOError):
            server.accept()
        build_bench(second).close()
        server.settimeout(5.0)
        server.accept()[0].close()
    assert not (tmp_path / "second").exists()


@pytest.mark.parametrize("other", ["LocalHost", "localhost.", "127.0.0.1", "[::1]", "[::ffff:127.0.0.1]", "127.1"])
def test_this_machine_is_one_whatever_it_is_called(other: str) -> None:
    """Also through another kind of server on the same port."""
    assert port_names("socket://localhost:1080") & port_names(f"rfc2217://{other}:1080")


def test_names_that_resolve_to_one_machine_are_one_and_others_are_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name is what it resolves to, and itself where nobody knows it now; another port is another device."""
    known = {"chamber-3": ["192.0.2.50"], "vt4002.lab": ["192.0.2.50", "2001:db8::5"], "other": ["192.0.2.51"]}

    def told(host: str, number: int, **_more: object) -> list[tuple[int, int, int, str, tuple[str, int]]]:
        if host not in known:
            raise socket.gaierror("nobody knows it")
        return [(0, 0, 0, "", (address, number)) for address in known[host]]

    monkeypatch.setattr(socket, "getaddrinfo", told)
    ours = port_names("socket://Chamber-3:1080")
    assert ours & port_names("rfc2217://vt4002.lab:1080?logging=debug")
    for other in ("socket://other:1080", "socket://chamber-3:2049", "socket://unknown:1080", "socket://[:1080"):
        assert not ours & port_names(other)
    known.clear()
    assert ours & port_names("socket://chamber-3.:1080")


@pytest.mark.slow
def test_two_names_of_one_line_are_one_port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link, and another device node with the same number, which no lock of the file itself would show."""
    primary, secondary = os.openpty()
    path = os.ttyname(secondary)
    (tmp_path / "by-id").symlink_to(path)
    monkeypatch.setattr(
        os.path, "realpath", lambda name, real=os.path.realpath: str(name) if "node" in str(name) else real(name)
    )
    monkeypatch.setattr(
        os, "stat", lambda name, real=os.stat, **more: real(path if "node" in str(name) else name, **more)
    )
    for other in (str(tmp_path / "by-id"), "/dev/another-node"):
        release = port_lock(path)
        with pytest.raises(TransportError, match="somebody else"):
            port_lock(other)
        release()
        port_lock(other)()
    assert not port_names(path) & port_names("/dev/null")
    os.close(primary)
    os.close(secondary)


@pytest.mark.slow
def test_a_dead_owner_is_not_in_the_way(tmp_path: Path) -> None:
    """The system frees the locks of a program that was killed."""
    port = "socket://127.0.0.1:10001"
    code = (
        "import sys; from pathlib import Path; from hil.bench import lock\n"
        f"lock._RUNTIME = Path({str(tmp_path / 'locks')!r})\n"
        f"held = lock.port_lock({port!r}); print('held', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(TransportError, match=f"process {other.pid}"):
            port_lock("socket://localhost:10001")
        other.send_signal(signal.SIGKILL)
        other.wait(10.0)
        port_lock(port)()
