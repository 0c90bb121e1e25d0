"""One page for the browsers of this machine: served on the loopback address alone, until it is told to stop."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

from uvms_ocp.exceptions import OutputError
from uvms_ocp.viz.scene.page.viewer import ScenePage

_HOST = "127.0.0.1"


@contextmanager
def served(page: ScenePage, port: int = 0) -> Iterator[str]:
    """Serve the page while the context lasts; gives its address. port [-]: 0 for any that is free.

    Raises `OutputError` where the port is taken.
    """
    try:
        server = ThreadingHTTPServer((_HOST, port), _handler_of(page))
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


def _handler_of(page: ScenePage) -> type[BaseHTTPRequestHandler]:
    body = page.html.encode()

    class Handler(BaseHTTPRequestHandler):
        """Knows one page, and no one but those who ask for this machine by its loopback address."""

        def do_GET(self) -> None:
            # A name that another site has led here is no loopback address.
            known = self.headers.get("Host", "").partition(":")[0] in (_HOST, "localhost")
            found = known and self.path == "/"
            self.send_response(200 if found else 404 if known else 403)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body) if found else 0))
            self.end_headers()
            if found:
                self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            """Nobody reads it."""

    return Handler
