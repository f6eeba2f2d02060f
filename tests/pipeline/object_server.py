"""A server of objects as a process of its own, on loopback: moto's S3, made as atomic as the real one, with faults.

    python -m tests.pipeline.object_server FOLDER

writes its port to FOLDER/port and every request to FOLDER/requests, and ends with its standard input. Files that a test
puts into FOLDER make it fail: `deny` refuses all requests; `break` holds how many more of an artifact's files are to
break off half way; `hold` how many puts go through before one is kept waiting, whereupon FOLDER/held appears. What was
kept waiting is never done.
"""

from __future__ import annotations

import io
import socket
import sys
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

REFUSED = b'<?xml version="1.0"?><Error><Code>AccessDenied</Code><Message>signed with topsecret</Message></Error>'


class Server:
    def __init__(self, folder: Path, application: Any) -> None:
        self.folder = folder
        self.application = application
        self.lock = threading.Lock()

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        body = environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        environ["wsgi.input"] = io.BytesIO(body)
        method, path = environ["REQUEST_METHOD"], environ["PATH_INFO"]
        with self.lock:
            if (self.folder / "deny").exists():
                start_response("403 Forbidden", [("Content-Type", "application/xml")])
                return [REFUSED]
            with (self.folder / "requests").open("a") as file:
                file.write(f"{method} {path}\n")
            broken = method == "PUT" and "/files/" in path and self.counted_down("break")
            held = method == "PUT" and (self.folder / "hold").exists() and not self.counted_down("hold")
            if not broken and not held:  # under the lock: moto looks whether an object exists, and then writes it
                return list(self.application(environ, start_response))
        if held:
            (self.folder / "held").touch()
            while (self.folder / "held").exists():
                time.sleep(0.01)
        environ["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
        raise ConnectionAbortedError

    def counted_down(self, name: str) -> bool:
        """Whether the number in a file was more than 0; it is one less now."""
        file = self.folder / name
        left = int(file.read_text()) if file.exists() else 0
        if left:
            file.write_text(str(left - 1))
        return left > 0


def main() -> None:
    from moto.server import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import WSGIRequestHandler, make_server

    class Quiet(WSGIRequestHandler):
        def log(self, *arguments: Any) -> None:
            pass

    folder = Path(sys.argv[1])
    application = Server(folder, DomainDispatcherApplication(create_backend_app))
    server = make_server("127.0.0.1", 0, application, threaded=True, request_handler=Quiet)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    aside = folder / "port.aside"
    aside.write_text(str(server.port))
    aside.rename(folder / "port")
    sys.stdin.read()


if __name__ == "__main__":
    main()
