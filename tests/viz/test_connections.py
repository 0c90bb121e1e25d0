"""Sockets: this machine alone is served, with few connections at a time, and without a word on
those that break.
"""

from __future__ import annotations

import re
import socket
import struct
import time
from contextlib import ExitStack, suppress
from http.client import HTTPConnection
from pathlib import Path
from threading import active_count
from urllib.parse import urlsplit

import pytest

import uvms_ocp
from uvms_ocp.viz.scene import page_server
from uvms_ocp.viz.scene.page import ScenePage

PAGE = ScenePage(html="<p>" + "x" * 2_000_000, height=100)
OPENS_SOCKETS = {
    "viz/scene/page_server.py",
    "campaign/cluster.py",
    "campaign/dispatch.py",
}  # the last on the client of the second
NETWORKS = re.compile(
    r"^ *(from|import) (asyncio|distributed|ftplib|http|socket|socketserver|tornado|xmlrpc|zmq)\b",
    re.M,
)


def _connected(address: str) -> socket.socket:
    place = urlsplit(address)
    return socket.create_connection((place.hostname, place.port), timeout=10)


def test_a_browser_that_goes_in_the_middle_of_a_page_prints_nothing(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with page_server.served(PAGE) as address:
        for _ in range(5):
            with _connected(address) as gone:
                gone.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
                gone.recv(1)
                gone.setsockopt(
                    socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
                )  # reset, not closed
        time.sleep(0.2)
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_who_connects_and_asks_nothing_keeps_nobody_out_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(page_server, "_PATIENCE", 0.3)
    before = active_count()
    with page_server.served(PAGE) as address, ExitStack() as idle:
        for _ in range(80):
            idle.enter_context(_connected(address))
        assert active_count() - before <= page_server._MOST_CONNECTIONS + 1
        time.sleep(1.0)
        connection = HTTPConnection(urlsplit(address).netloc, timeout=10)
        connection.request("GET", "/")
        assert connection.getresponse().status == 200
        connection.close()
    assert active_count() <= before + 1


def test_few_modules_open_sockets() -> None:
    package = Path(uvms_ocp.__file__).parent
    ports = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if NETWORKS.search(path.read_text("utf-8"))
    }
    assert ports <= OPENS_SOCKETS
    assert "viz/scene/page_server.py" in ports


@pytest.mark.slow
def test_the_processes_of_a_campaign_and_of_a_page_listen_to_this_machine_alone() -> None:
    pytest.importorskip("distributed")
    psutil = pytest.importorskip("psutil")
    from uvms_ocp.campaign.cluster import connected

    with page_server.served(PAGE), socket.socket() as client, suppress(OSError):
        client.bind(("127.0.0.1", 8787))  # Dask's port, as of another campaign
    with page_server.served(PAGE), connected(None, 1):
        tree = (psutil.Process(), *psutil.Process().children(recursive=True))
        sockets = [connection for process in tree for connection in process.net_connections("inet")]
        listening = [
            connection.laddr.ip for connection in sockets if connection.status == psutil.CONN_LISTEN
        ]
    assert len(tree) > 1
    assert len(listening) > 1
    assert set(listening) == {"127.0.0.1"}
