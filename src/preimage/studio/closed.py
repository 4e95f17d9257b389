"""Who may speak with the studio, and how much they may say: a wall around the application (ASGI).

A page of another site can reach a server on this machine in two ways. It can send requests to it, which its `Origin` gives away. Or its
own name can be made to lead to this machine (DNS rebinding), which `Host` gives away. Both are checked. On the loopback interface nobody
else gets in, as through a tunnel of ssh, which may have another port; on any other address a token is asked for, in the header
`Authorization` and never in a cookie, so that no browser sends it by itself.
"""

import hmac
from http import HTTPStatus
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from preimage.studio.problems import MEDIA_TYPE, body_of

LOOPBACK = ("localhost", "127.0.0.1", "::1")
MOST_UPLOADED = 32 * 2**20
"""Bytes of a picture: more than any camera's, and little beside what it takes when it is unpacked."""
MOST_ASKED = 64 * 2**10
"""Bytes of any other request."""
API, UPLOADS = "/api/", "/api/goals/picture"
CONTENT_SECURITY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; media-src 'self' blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": CONTENT_SECURITY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=()",
    "cache-control": "no-store",
}


class Closed:
    """The application behind the wall.

    Args:
        app: what is behind it.
        token: what a request has to know; None on the loopback interface.
    """

    def __init__(self, app: ASGIApp, *, token: str | None = None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        refused = self._refused(scope["path"], headers)
        body, too_much = b"", None
        if refused is None and scope["method"] not in ("GET", "HEAD"):
            body, too_much = await read_body(receive, headers, MOST_UPLOADED if scope["path"] == UPLOADS else MOST_ASKED)
        if problem := refused or too_much:
            await tell(send, *problem)
            return
        await self._app(scope, replayed(body, receive) if scope["method"] not in ("GET", "HEAD") else receive, with_headers(send))

    def _refused(self, path: str, headers: dict[str, str]) -> tuple[HTTPStatus, str] | None:
        """Why a request is not listened to."""
        host = headers.get("host", "")
        if self._token is None and name_of(host) not in LOOPBACK:
            return HTTPStatus.MISDIRECTED_REQUEST, f"this studio is not {host[:80] or 'without a name'}: open it as localhost or 127.0.0.1"
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return HTTPStatus.FORBIDDEN, "a page of another site asked for this: only the studio's own page may"
        if headers.get("sec-fetch-site") in ("cross-site", "same-site"):
            return HTTPStatus.FORBIDDEN, "a page of another site asked for this: only the studio's own page may"
        if self._token is not None and path.startswith(API):
            given = headers.get("authorization", "").removeprefix("Bearer ")
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                return HTTPStatus.UNAUTHORIZED, "the token is missing or another: open the address that `preimage studio` printed"
        return None


def name_of(host: str) -> str:
    """The name in a Host header, without its port.

    >>> name_of("localhost:8230"), name_of("[::1]:8230"), name_of("evil.example"), name_of("localhost@evil.example")
    ('localhost', '::1', 'evil.example', '')
    """
    try:
        parts = urlsplit(f"//{host}")
        return "" if parts.username is not None or parts.path else parts.hostname or ""
    except ValueError:
        return ""


async def read_body(receive: Receive, headers: dict[str, str], most: int) -> tuple[bytes, tuple[HTTPStatus, str] | None]:
    """The body of a request, or why it is not read on."""
    too_much = HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"that is more than {most / 2**20:g} MB: send less, as a smaller picture"
    if headers.get("content-length", "0").isdigit() and int(headers.get("content-length", "0")) > most:
        return b"", too_much
    body = bytearray()
    while True:
        message = await receive()
        body += message.get("body", b"")
        if len(body) > most:
            return b"", too_much
        if message["type"] == "http.disconnect" or not message.get("more_body"):
            return bytes(body), None


def replayed(body: bytes, receive: Receive) -> Receive:
    """What was read already, and then whatever else comes."""
    waiting = [body]

    async def again() -> Message:
        return {"type": "http.request", "body": waiting.pop(), "more_body": False} if waiting else await receive()

    return again


def with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            there = {name.lower() for name, _ in message["headers"]}
            more = [(name.encode(), value.encode()) for name, value in HEADERS.items() if name.encode() not in there]
            message = {**message, "headers": [*message["headers"], *more]}
        await send(message)

    return sending


async def tell(send: Send, status: HTTPStatus, sentence: str) -> None:
    """Answer with a problem."""
    headers = [(b"content-type", MEDIA_TYPE.encode())]
    if status is HTTPStatus.UNAUTHORIZED:
        headers.append((b"www-authenticate", b"Bearer"))
    sending = with_headers(send)
    await sending({"type": "http.response.start", "status": int(status), "headers": headers})
    await sending({"type": "http.response.body", "body": body_of(status, sentence)})
