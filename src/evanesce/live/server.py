"""Server of the live page: socket, allowed hosts, limits on uploads, and delivery of pictures."""

from __future__ import annotations

import ipaddress
import socket
from collections import OrderedDict

from fastapi import FastAPI
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from evanesce.core.errors import InputError

FORM_BYTES = 100_000
"""Overhead of a form around its file [bytes]."""

KEEP_PICTURES = 64


def open_socket(host: str, port: int) -> socket.socket:
    """Return a listening socket; port 0 takes a free one.

    Raises
    ------
    InputError
        If the port is out of range, taken or not allowed, or the host is not one of this machine's.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"{port}", key="--port", allowed="1 to 65535, or 0 for a free one")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (OSError, UnicodeError):
        raise InputError(
            f"{host!r} is not an address", key="--host", allowed="127.0.0.1, or an address of this machine"
        ) from None
    listening = socket.socket(family, kind, protocol)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
        listening.listen(128)
    except OSError as error:
        listening.close()
        raise InputError(
            f"cannot listen on {host} port {port}: {error.strerror}",
            key="--port",
            allowed="a free port of an address of this machine",
        ) from None
    return listening


def is_loopback(host: str) -> bool:
    """Return whether an address is reached by this machine only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def guard(app: FastAPI, host: str, max_bytes: int) -> None:
    """Refuse large bodies and, on the loopback address, requests with a foreign host name.

    A page elsewhere could otherwise have its own name resolve to 127.0.0.1 and read this one (DNS rebinding).
    """
    app.add_middleware(LimitBody, max_bytes=max_bytes + FORM_BYTES)
    if is_loopback(host):
        app.add_middleware(TrustedHostMiddleware, allowed_hosts=["localhost", "127.0.0.1", "[::1]", host])


class LimitBody:
    """Answer 413 to a request whose body is larger than allowed, by its stated or its actual length.

    The browser's own limit on uploads can be bypassed; this one cannot.

    Parameters
    ----------
    app : ASGIApp
    max_bytes : int
    """

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self.app, self.max_bytes = app, max_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on while counting its bytes."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        stated = dict(scope["headers"]).get(b"content-length", b"0")
        if not stated.isdigit() or int(stated) > self.max_bytes:
            await Response("too large", status_code=413)(scope, receive, send)
            return
        taken, begun = 0, False

        async def counted() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > self.max_bytes:
                raise _TooLargeError
            return message

        async def answer(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self.app(scope, counted, answer)
        except _TooLargeError:
            if not begun:
                await Response("too large", status_code=413)(scope, receive, send)


class _TooLargeError(Exception):
    pass


class PictureStore:
    """The latest pictures, each by an unguessable name."""

    def __init__(self) -> None:
        self._pictures: OrderedDict[str, bytes] = OrderedDict()

    def put(self, name: str, data: bytes) -> str:
        """Store a picture; return its address."""
        self._pictures[name] = data
        while len(self._pictures) > KEEP_PICTURES:
            self._pictures.popitem(last=False)
        return f"/picture/{name}"

    def serve(self, app: FastAPI) -> None:
        """Add the route of the pictures to an application."""

        @app.get("/picture/{name}")
        async def picture(name: str) -> Response:  # no thread of its own: there is nothing to wait for
            # A name is looked up, nothing else: it never becomes a path.
            data = self._pictures.get(name)
            if data is None:
                return Response(status_code=404)
            return Response(data, media_type="image/jpeg", headers={"Cache-Control": "no-store"})
