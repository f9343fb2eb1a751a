"""Access to the live page: only for the page's own origin on a loopback name, or with a token.

A browser sends requests of any page that it shows, also to this server. A foreign page must neither
read the stream (Origin and Sec-Fetch-Site are checked) nor use another host name (Host is checked).
Every user of this machine reaches a loopback address, so a page that may command needs a token.
"""

import hmac
import pwd
import secrets
from ipaddress import ip_address
from pathlib import Path

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from ground.errors import UsageError

COOKIE = "inertia_token"
MIN_TOKEN_CHARACTERS = 16
RANDOM_TOKEN_BYTES = 24
SOCKETS = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))  # Linux' lists of connections
LOCAL_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
OWN_SITES = frozenset({"same-origin", "none"})  # Sec-Fetch-Site: this page, or typed by the user
# Open MCT compiles its templates ('unsafe-eval'), sets styles, and runs its workers from blobs.
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'unsafe-eval'",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "font-src 'self' data:",
        "connect-src 'self'",
        "worker-src 'self' blob:",
        "manifest-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


def is_loopback(host: str) -> bool:
    """Return whether a listening address can be reached from this machine only."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def read_token(path: Path) -> str:
    """Return the token in a file. Raises UsageError if it is unreadable, not private or invalid."""
    try:
        mode, text = path.stat().st_mode, path.read_text().strip()
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: token cannot be read: {error}") from error
    if mode & 0o077:
        raise UsageError(f"{path}: mode {mode & 0o777:04o}; a token must be closed to others, 0600")
    if len(text) < MIN_TOKEN_CHARACTERS or not text.isascii() or not text.isprintable():
        raise UsageError(f"{path}: must hold at least {MIN_TOKEN_CHARACTERS} printable characters")
    return text


def random_token() -> str:
    """Return a token that nobody can guess."""
    return secrets.token_urlsafe(RANDOM_TOKEN_BYTES)


def sender(request: web.Request) -> str:
    """Return who sent a request: the address, and the user if it came from this machine."""
    transport = request.transport
    peer = None if transport is None else transport.get_extra_info("peername")
    if transport is None or peer is None:
        return "unknown address"
    user = _local_user(int(peer[1]), int(transport.get_extra_info("sockname")[1]))
    return f"{peer[0]} ({user})" if user and is_loopback(peer[0]) else str(peer[0])


def _local_user(port: int, server_port: int) -> str:
    """Return the user whose connection on this machine goes from `port` to the server's port."""
    wanted = f":{port:04X}", f":{server_port:04X}"
    for path in SOCKETS:
        try:
            lines = path.read_text().splitlines()[1:]
        except OSError:  # another system
            continue
        for columns in map(str.split, lines):
            if all(columns[k].endswith(end) for k, end in zip((1, 2), wanted, strict=True)):
                uid = int(columns[7])
                try:
                    return pwd.getpwuid(uid).pw_name
                except KeyError:
                    return f"uid {uid}"
    return ""


class Guard:
    """Refuses requests of foreign pages, and requests without the token if there is one.

    Parameters
    ----------
    host : address on which the server listens
    token : None: no token is required, which is allowed on a loopback address only

    Raises
    ------
    UsageError when the address is not a loopback address and there is no token.
    """

    def __init__(self, host: str, token: str | None = None) -> None:
        if token is None and not is_loopback(host):
            raise UsageError(f"--http-host {host}: not a loopback address; it needs --http-token")
        self._names = LOCAL_NAMES | {host}
        self._token = token

    @property
    def needs_token(self) -> bool:
        """Return whether every request must show the token."""
        return self._token is not None

    async def add_headers(self, _request: web.Request, response: web.StreamResponse) -> None:
        """Add the security headers to a response; called for every response."""
        response.headers.update(HEADERS)

    def middleware(self) -> Middleware:
        """Return the check that runs before every handler."""

        @web.middleware
        async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
            self._refuse_foreign(request)
            if self._token is not None and not self._has_token(request):
                return self._log_in(request)
            return await handler(request)

        return check

    def _refuse_foreign(self, request: web.Request) -> None:
        """Raise HTTPForbidden for a request from a page of another site."""
        host = request.headers.get("Host", "")
        # with a token any name is allowed: a browser sends the cookie only to the name that set it
        if self._token is None and _name(host) not in self._names:
            raise web.HTTPForbidden(text="Host: not a name of this server")
        origin = request.headers.get("Origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            raise web.HTTPForbidden(text="Origin: another site")
        navigates = request.headers.get("Sec-Fetch-Mode") == "navigate"
        site = request.headers.get("Sec-Fetch-Site", "none")
        if site not in OWN_SITES and not navigates:
            raise web.HTTPForbidden(text="Sec-Fetch-Site: another site")

    def _has_token(self, request: web.Request) -> bool:
        kind, _, bearer = request.headers.get("Authorization", "").partition(" ")
        given = bearer if kind == "Bearer" else request.cookies.get(COOKIE, "")
        return self._is_token(given)

    def _log_in(self, request: web.Request) -> web.StreamResponse:
        """Set the cookie for `/?token=...` by raising HTTPSeeOther; else raise HTTPUnauthorized."""
        given = request.query.get("token", "")
        if request.path != "/" or not self._is_token(given):
            raise web.HTTPUnauthorized(text="a token is needed: open /?token=...")
        answer = web.HTTPSeeOther("/")
        answer.set_cookie(COOKIE, given, httponly=True, samesite="Strict")
        raise answer

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="replace"), (self._token or "").encode())


def _name(host: str) -> str:
    """Return the name in a Host header, without its port and brackets."""
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0].lower()
