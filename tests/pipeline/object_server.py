"""An object server in a process of its own, on loopback: moto's S3, made as atomic as the real one, with faults.

    python -m tests.pipeline.object_server FOLDER

writes its port to FOLDER/port and every request to FOLDER/requests, and ends when its standard input is closed. Files
that a test puts into FOLDER make it fail. `deny`: all requests are refused. `break`: so many of the next uploads of
artifacts' files break off. `hold`: so many uploads go through, then one is held back and FOLDER/held appears; when that
file is deleted, the upload breaks off. Neither kind stores anything.
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
            if not broken and not held:  # under the lock: moto checks whether an object exists, and then writes it
                return list(self.application(environ, start_response))
        if held:
            (self.folder / "held").touch()
            while (self.folder / "held").exists():
                time.sleep(0.01)
        environ["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
        raise ConnectionAbortedError

    def counted_down(self, name: str) -> bool:
        """Takes 1 from the number in a file, unless it is 0 or the file is absent; whether it did."""
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
