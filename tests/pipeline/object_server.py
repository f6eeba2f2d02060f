"""A server of objects as a process of its own, on loopback: moto's S3, made as atomic as the real one, with faults.

    python -m tests.pipeline.object_server FOLDER

writes its port to FOLDER/port. A request goes through when FOLDER holds no file that says otherwise: `deny` refuses all
requests, `break` holds how many more requests that put something are to break off half way.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

REFUSED = b'<?xml version="1.0"?><Error><Code>AccessDenied</Code><Message>secret-text</Message></Error>'


class Server:
    def __init__(self, folder: Path, application: Any) -> None:
        self.folder = folder
        self.application = application
        self.lock = threading.Lock()

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        body = environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        with self.lock:  # moto looks whether an object exists and writes it in two steps
            if (self.folder / "deny").exists():
                start_response("403 Forbidden", [("Content-Type", "application/xml")])
                return [REFUSED]
            if environ["REQUEST_METHOD"] == "PUT" and self.breaks():
                environ["werkzeug.socket"].close()
                raise ConnectionAbortedError
            with (self.folder / "requests").open("a") as file:
                file.write(f"{environ['REQUEST_METHOD']} {environ['PATH_INFO']} {environ['QUERY_STRING']}\n")
            import io

            environ["wsgi.input"] = io.BytesIO(body)
            return list(self.application(environ, start_response))

    def breaks(self) -> bool:
        file = self.folder / "break"
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
    aside = folder / "port.aside"
    aside.write_text(str(server.port))
    aside.rename(folder / "port")
    parent = os.getppid()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdin.read()  # until whoever started it closes the pipe, or is gone
    del parent


if __name__ == "__main__":
    main()
