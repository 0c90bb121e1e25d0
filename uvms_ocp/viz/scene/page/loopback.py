"""One page for the browsers of this machine, and what a live one is told: served on the loopback address alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

from uvms_ocp.exceptions import OutputError
from uvms_ocp.viz.scene.page.viewer import ScenePage

_HOST = "127.0.0.1"
FRAMES = "/frames"
"""The path at which a live page hears of frames, as server-sent events."""


@contextmanager
def served(page: ScenePage, port: int = 0, frames: Callable[[], Iterator[str]] | None = None) -> Iterator[str]:
    """Serve the page while the context lasts; gives its address. port [-]: 0 for any that is free.

    frames: makes the lines that a live page is told, for each browser in a thread of its own. Raises `OutputError` where the
    port is taken.
    """
    try:
        server = ThreadingHTTPServer((_HOST, port), _handler_of(page, frames))
    except (OSError, OverflowError) as error:
        raise OutputError(f"port {port} of {_HOST} cannot be served ({error}); give another, or 0 for any") from error
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://{_HOST}:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def _handler_of(page: ScenePage, frames: Callable[[], Iterator[str]] | None) -> type[BaseHTTPRequestHandler]:
    body = page.html.encode()

    class Handler(BaseHTTPRequestHandler):
        """Knows one page, and no one but those who ask for this machine by its loopback address."""

        def do_GET(self) -> None:
            # A name that another site has led here is no loopback address.
            known = self.headers.get("Host", "").partition(":")[0] in (_HOST, "localhost")
            if known and self.path == FRAMES and frames is not None:
                self._tell(frames())
                return
            found = known and self.path == "/"
            self.send_response(200 if found else 404 if known else 403)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body) if found else 0))
            self.end_headers()
            if found:
                self.wfile.write(body)

        def _tell(self, lines: Iterator[str]) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            with suppress(ConnectionError):  # nobody looks any longer
                for line in lines:
                    self.wfile.write(f"data: {line}\n\n".encode())
                self.wfile.write(b"event: end\ndata: end\n\n")

        def log_message(self, format: str, *args: Any) -> None:
            """Nobody reads it."""

    return Handler
