"""Who may read the page, and who may ask something of a controller.

Reading is free on the loopback address, where only this machine's people can come from; as soon as the page listens
elsewhere it takes the token. Asking takes the token always. It travels in a header, which no other site's page can
make a browser send, and never in an address, which ends in logs and histories.
"""

import ipaddress
import re
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivers.given_file import read_text
from hil.errors import InputError, worded

LEAST_TOKEN = 12
_ALPHABET = "abcdefghjkmnpqrstuvwxyz23456789"  # nothing that is mistaken for something else when it is typed
_SCHEME = "Bearer "
_HOST = re.compile(r"(?P<name>\[[0-9A-Fa-f:.]+\]|[^:\[\]]+)(:\d*)?")

_HEADERS: Mapping[str, str] = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "manifest-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


def new_token() -> str:
    """Return a token of 79 bits that can be typed on a phone: four groups of four."""
    return "-".join("".join(secrets.choice(_ALPHABET) for _ in range(4)) for _ in range(4))


def token_from(path: Path) -> str:
    """Return a file's token, where none is a new one for its owner only; `InputError` where unread or too short."""
    with worded(InputError, f"{path}: the token cannot be kept (", OSError, ")"):
        if not path.exists():
            path.touch(mode=0o600, exist_ok=False)
            path.write_text(new_token() + "\n", encoding="utf-8")
        token = read_text(path).strip()
    if len(token) < LEAST_TOKEN or not token.isascii():
        raise InputError(f"{path}: a token has at least {LEAST_TOKEN} characters, all of them ASCII; delete the file")
    return token


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def is_loopback(host: str) -> bool:
    """Tell whether only this machine can reach a server that listens at `host`."""
    return address.is_loopback if (address := _address(host)) else host == "localhost"


def url(host: str, port: int) -> str:
    """Return where a browser finds a server that listens at `host`: by this machine's name if that is everywhere."""
    address = _address(host)
    everywhere = address is not None and address.is_unspecified
    name = socket.gethostname() if everywhere else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/"


@dataclass(frozen=True)
class Access:
    """The rules of one server: its token, and the host that it listens at."""

    token: str
    host: str

    def may_ask(self, headers: Headers) -> bool:
        """Tell whether a request brings the token; takes as long whatever it brings."""
        given = headers.get("authorization", "")
        return secrets.compare_digest(given.encode(), (_SCHEME + self.token).encode())

    def may_read(self, headers: Headers) -> bool:
        """Tell whether a request may see the nights."""
        return is_loopback(self.host) or self.may_ask(headers)

    def is_addressed(self, host_header: str) -> bool:
        """Tell whether the Host header names this server or is an IP address: DNS rebinding sends neither."""
        parts = _HOST.fullmatch(host_header)
        if parts is None:
            return False
        name = parts["name"].strip("[]")
        ours = {"localhost"} if is_loopback(self.host) else {"localhost", self.host, socket.gethostname()}
        return _address(name) is not None or name.lower() in {each.lower() for each in ours}


class Guard:
    """Refuses what is not addressed to this server, and sends the headers that keep a browser from doing more."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on; what is no HTTP (a web socket) is refused by closing it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        if not self._access.is_addressed(Headers(scope=scope).get("host", "")):
            refusal = PlainTextResponse("This server is not known by that name.", status_code=421)
            await refusal(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    given.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_guarded)
