"""As much of S3 as listing and reading need, on a port of this machine, by the protocol that clients speak."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape

BUCKET = "plant"


class _Handler(BaseHTTPRequestHandler):
    root: Path
    key: str

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""

    def do_HEAD(self) -> None:
        """What an object is."""
        self._answer(with_body=False)

    def do_GET(self) -> None:
        """A list of objects, or one object, or a part of it."""
        self._answer(with_body=True)

    def _answer(self, *, with_body: bool) -> None:
        address = urlsplit(self.path)
        if f"Credential={self.key}/" not in self.headers.get("Authorization", ""):
            words = f"<Error><Code>InvalidAccessKeyId</Code><Message>no such key {self.headers}</Message></Error>"
            self._send(403, words.encode() if with_body else b"")
            return
        name = unquote(address.path).removeprefix(f"/{BUCKET}").strip("/")
        if not name:
            self._send(200, self._listing(parse_qs(address.query).get("prefix", [""])[0]))
            return
        path = self.root / name
        if not path.is_file():
            self._send(404, b"")
            return
        content, status = path.read_bytes(), 200
        wanted = self.headers.get("Range", "").removeprefix("bytes=").partition("-")
        if wanted[1]:
            content, status = content[int(wanted[0]) : int(wanted[2] or len(content)) + 1], 206
        self._send(
            status, content, {"ETag": _etag(path), "Last-Modified": formatdate(0, usegmt=True)}, with_body=with_body
        )

    def _listing(self, prefix: str) -> bytes:
        found = [path for path in sorted(self.root.rglob("*")) if path.is_file()]
        names = {path.relative_to(self.root).as_posix(): path for path in found}
        entries = "".join(
            f"<Contents><Key>{escape(name)}</Key><Size>{path.stat().st_size}</Size><ETag>{_etag(path)}</ETag>"
            "<LastModified>2026-01-01T00:00:00.000Z</LastModified><StorageClass>STANDARD</StorageClass></Contents>"
            for name, path in names.items()
            if name.startswith(prefix)
        )
        about = f"<Name>{BUCKET}</Name><IsTruncated>false</IsTruncated>"
        return f"<ListBucketResult>{about}{entries}</ListBucketResult>".encode()

    def _send(self, status: int, body: bytes, headers: dict[str, str] | None = None, *, with_body: bool = True) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **(headers or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        if with_body:
            self.wfile.write(body)


def _etag(path: Path) -> str:
    return hashlib.md5(path.read_bytes()).hexdigest()


@contextmanager
def object_storage(root: Path, key: str) -> Iterator[str]:
    """Serve the files of a folder as a bucket to whoever has this key; gives the server's address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), {"root": root, "key": key}))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
