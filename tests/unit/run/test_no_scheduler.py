"""What answers at a scheduler's address may be none, or say nothing."""

from __future__ import annotations

import contextlib
import socket
import threading

import pytest

from arfx.errors import ConfigError
from arfx.run.cluster import pool, start
from arfx.run.cluster.spec import ClusterSpec


@pytest.mark.parametrize("says", [b"HTTP/1.0 200 OK\r\n\r\n", b""])
def test_what_is_no_scheduler_or_silent_is_told_soon(
    says: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    assert (
        start.CONNECT_S + start.CLOSE_S <= 10 and pool.SILENT_S + start.CLOSE_S <= 10
    )
    monkeypatch.setattr(start, "CONNECT_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            held = []
            with contextlib.suppress(OSError):
                while True:
                    held.append(server.accept()[0])
                    held[-1].sendall(says)

        threading.Thread(target=answer, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ConfigError, match=f"no scheduler answers at {address}"):
            start.open_cluster(ClusterSpec.parse(address), (), print).__enter__()
        server.shutdown(socket.SHUT_RDWR)
