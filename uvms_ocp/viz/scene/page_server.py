"""Serve a page to the browsers of this machine, on the loopback address alone, and tell a live one of
frames.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import BoundedSemaphore, Thread
from typing import Any

from uvms_ocp.errors import OutputError
from uvms_ocp.viz.scene.page import ScenePage

_HOST = "127.0.0.1"
_MOST_CONNECTIONS = 32
_PATIENCE = 10.0  # [s] for which a browser may neither ask nor take an answer
FRAMES = "/frames"
"""The path at which a live page hears of frames, as server-sent events."""


@contextmanager
def served(
    page: ScenePage, port: int = 0, frames: Callable[[], Iterator[str]] | None = None
) -> Iterator[str]:
    """Serve the page while the context lasts; gives its address. port: 0 for any that is free.

    frames: makes the lines that a live page is told, for each browser in a thread of its own.
    Raises `OutputError` where the port is taken.
    """
    try:
        server = _PageServer((_HOST, port), _handler_of(page, frames))
    except (OSError, OverflowError) as error:
        raise OutputError(
            f"port {port} of {_HOST} cannot be served ({error}); give another, or 0 for any"
        ) from error
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://{_HOST}:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _PageServer(ThreadingHTTPServer):
    """Server that turns away whoever comes while all connections are taken."""

    request_queue_size = _MOST_CONNECTIONS

    def __init__(self, *arguments: Any) -> None:
        self._free = BoundedSemaphore(_MOST_CONNECTIONS)
        super().__init__(*arguments)

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exc_info()[1], OSError):  # a browser that has gone
            super().handle_error(request, client_address)


def _handler_of(
    page: ScenePage, frames: Callable[[], Iterator[str]] | None
) -> type[BaseHTTPRequestHandler]:
    body = page.html.encode()

    class Handler(BaseHTTPRequestHandler):
        """Knows one page, and no one but those who ask for this machine by its loopback address."""

        timeout = _PATIENCE

        def do_GET(self) -> None:
            # A name that another site has led here is no loopback address.
            is_local = self.headers.get("Host", "").partition(":")[0] in (_HOST, "localhost")
            if is_local and self.path == FRAMES and frames is not None:
                self._send(frames())
                return
            is_page = is_local and self.path == "/"
            if is_page:
                status = 200
            elif is_local:
                status = 404
            else:
                status = 403
            self.send_response(status)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body) if is_page else 0))
            self.end_headers()
            if is_page:
                self.wfile.write(body)

        def _send(self, lines: Iterator[str]) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            for line in lines:
                self.wfile.write(f"data: {line}\n\n".encode())
            self.wfile.write(b"event: end\ndata: end\n\n")

        def log_message(self, format: str, *args: Any) -> None:
            """Drop the message, which nobody reads."""

    return Handler
