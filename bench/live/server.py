"""The page's server, on one address and one port, or not at all."""

import contextlib
import io
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import viser

from scenarios.errors import ScenarioError


class Server(viser.ViserServer):
    """viser's server without its way out: no page may ask it for a public address."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002
        """Give none."""
        return None


def free_port(host: str, port: int) -> int:
    """Return a port that can be listened on: ``port``, or any where that is 0.

    Raises:
        ScenarioError: it cannot.
    """
    if not 0 <= port <= 65535:
        raise ScenarioError(f"--port: {port} is not between 0 and 65535")
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((host, port))
            return int(trial.getsockname()[1])
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScenarioError(
            f"--host {host} --port {port}: cannot listen there ({reason}); "
            "--port 0 takes any that is free"
        ) from None


@contextmanager
def listen(host: str, port: int) -> Iterator[Server]:
    """Serve an empty page; the port is free again at the end.

    Raises:
        ScenarioError: somebody else has taken the port meanwhile.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # a banner
        server = Server(host=host, port=port, verbose=False)
    try:
        if server.get_port() != port:
            raise ScenarioError(f"--port {port}: taken meanwhile; --port 0 takes any that is free")
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
