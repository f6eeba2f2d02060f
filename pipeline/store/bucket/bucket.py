"""A bucket of an S3-compatible object store, reached through fsspec's s3fs: named bytes, and little else.

Credentials and endpoint come from where AWS's own tools look for them (`AWS_PROFILE`, `AWS_ACCESS_KEY_ID`,
`AWS_ENDPOINT_URL`, the files in `~/.aws`) and are never revealed: messages give the address and the server's error
code, never its text. Objects are put without an access list, which makes them private to their owner unless the bucket
itself is public.

s3fs is imported only when it is needed: that takes half a second, and only users with results in a bucket install it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from pipeline.errors import CommandError, PipelineError, RemoteError, Unreachable

ADDRESS = re.compile(r"s3://(?P<bucket>[a-z0-9][a-z0-9.-]{1,61}[a-z0-9])(?P<prefix>(/[\w!'().*-]+)*)/?")
TOGETHER = 8  # files transferred at the same time
PAGE = 1000  # objects in one response or request, at most
DENIED = ("AccessDenied", "InvalidAccessKeyId", "SignatureDoesNotMatch", "ExpiredToken", "InvalidToken", "403")
MISSING = ("NoSuchKey", "404")
TAKEN = ("PreconditionFailed", "412")
CREDENTIALS = "standard AWS credentials: AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or ~/.aws"


@dataclass(frozen=True)
class Entry:
    """An object in a listing: its size in bytes, and its age in seconds by the server's clock."""

    size: int
    age: float


class Bucket:
    """The objects under an address `s3://BUCKET/PREFIX`; names are relative to it.

    Opening a bucket sends no request; it raises CommandError for an address that is malformed or holds credentials.
    Every method raises CommandError if s3fs is missing or configured to make objects public, RemoteError if the bucket
    does not exist or the credentials are missing or insufficient, and Unreachable if several attempts at a request
    failed.
    """

    def __init__(self, address: str) -> None:
        if "@" in address:
            raise CommandError("an address must not contain credentials", where="--store", expected=CREDENTIALS)
        match = ADDRESS.fullmatch(address)
        if not match:
            raise CommandError("not the address of a store", where=address, expected="a folder or s3://BUCKET/PREFIX")
        self._bucket = match["bucket"]
        self._prefix = f"{match['prefix'].strip('/')}/".lstrip("/")
        self.address = f"s3://{self._bucket}{match['prefix']}"
        self.odd: set[str] = set()  # names in listings that were skipped

    def get(self, name: str) -> bytes | None:
        """The bytes of an object; None if it does not exist."""
        with self._reported():
            try:
                data: bytes = self._files.cat_file(
                    self._path(name), max_concurrency=1
                )  # one request, without a HEAD first
            except FileNotFoundError as error:
                if _code(error) not in MISSING:
                    raise
                return None
            return data

    def put(self, name: str, data: bytes) -> None:
        """Writes an object, replacing any other of that name."""
        with self._reported():
            self._call("put_object", Key=self._key(name), Body=data)

    def create(self, name: str, data: bytes) -> bool:
        """Writes an object unless the name is taken, and returns whether it did.

        The server guarantees that exactly one of several concurrent writers succeeds.
        """
        with self._reported():
            try:
                self._call("put_object", Key=self._key(name), Body=data, IfNoneMatch="*")
            except OSError as error:
                if _code(error) not in TAKEN:
                    raise
                return False
            return True

    def names(self, folder: str) -> dict[str, int]:
        """The names of all objects under a folder, and their sizes in bytes."""
        return {name: entry.size for name, entry in self.listing(folder).items()}

    def listing(self, folder: str) -> dict[str, Entry]:
        """All objects under a folder, by name; sends one request per thousand objects.

        Names become paths of files on this machine, so those that could lead out of a folder are skipped: see `odd`.
        """
        found: dict[str, Entry] = {}
        page: dict[str, Any] = {"NextContinuationToken": None}
        with self._reported():
            while "NextContinuationToken" in page:
                token = page["NextContinuationToken"]
                more = {"ContinuationToken": token} if token else {}
                page = self._call("list_objects_v2", Prefix=self._key(f"{folder}/"), MaxKeys=PAGE, **more)
                now = _server_time(page)
                for entry in page.get("Contents", ()):
                    age = (now - entry["LastModified"]).total_seconds()
                    name = entry["Key"].removeprefix(self._prefix)
                    if is_plain(name):
                        found[name] = Entry(entry["Size"], age)
                    else:
                        self.odd.add(name)
        return found

    def upload(self, files: Mapping[str, Path]) -> None:
        """Uploads files, several at a time, each under its name."""
        with self._reported():
            self._files.put(
                [str(path) for path in files.values()], [self._path(name) for name in files], batch_size=TOGETHER
            )

    def download(self, files: Mapping[str, Path]) -> None:
        """Writes objects to files, several at a time; their folders must exist.

        Raises FileNotFoundError if an object is missing.
        """
        with self._reported():
            try:
                self._files.get(
                    [self._path(name) for name in files], [str(path) for path in files.values()], batch_size=TOGETHER
                )
            except FileNotFoundError as error:
                if _code(error) not in MISSING:
                    raise
                raise _Missing from error

    def delete(self, names: Iterable[str]) -> None:
        """Deletes objects; those that do not exist are skipped."""
        keys = [{"Key": self._key(name)} for name in names]
        with self._reported():
            for start in range(0, len(keys), PAGE):
                some = keys[start : start + PAGE]
                answer = self._call("delete_objects", Delete={"Objects": some, "Quiet": True})
                if answer.get("Errors"):
                    raise _denied(self.address, answer["Errors"][0].get("Code"))

    @cached_property
    def _files(self) -> Any:
        try:
            import fsspec
            import s3fs  # noqa: F401 — fsspec finds it by itself; its absence is for us to report
        except ImportError as error:
            raise CommandError(
                "stores in a bucket need s3fs", where=self.address, remedy='Install it: pip install "gs-hider[s3]"'
            ) from error
        files = fsspec.filesystem("s3", use_listings_cache=False)  # fsspec keeps the connection for the next call
        shared = str(files.s3_additional_kwargs.get("ACL", "private"))
        if "public" in shared or "authenticated" in shared:
            raise CommandError(
                "would make private results public", where="fsspec's configuration of s3", found=f"ACL {shared!r}"
            )
        return files

    def _call(self, method: str, **arguments: object) -> Any:
        return self._files.call_s3(method, Bucket=self._bucket, **arguments)

    def _key(self, name: str) -> str:
        return f"{self._prefix}{name}"

    def _path(self, name: str) -> str:
        return f"{self._bucket}/{self._key(name)}"

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except _Missing:
            raise FileNotFoundError(self.address) from None
        except PipelineError:
            raise
        except Exception as error:
            told = _told(error, self.address)
            if told is None:
                raise
            raise told from None  # the original error may quote the signed request


def is_plain(name: str) -> bool:
    """Whether a name, used as a path, leads exactly where it says.

    >>> [is_plain(name) for name in ("logs/a/b.log", "logs/../x", "logs//x", "/etc/x", "logs/")]
    [True, False, False, False, False]
    """
    return "\0" not in name and not {"", ".", ".."} & set(name.split("/"))


class _Missing(Exception):
    """An object to be downloaded does not exist."""


def _server_time(answer: Mapping[str, Any]) -> datetime:
    """When the server sent an answer; if it does not say, the time of our own clock, which may be wrong."""
    told = answer.get("ResponseMetadata", {}).get("HTTPHeaders", {}).get("date")
    return parsedate_to_datetime(told) if told else datetime.now(UTC)


def _code(error: BaseException) -> str:
    """The server's error code; "" if the error does not come from the server."""
    for known in (error, error.__cause__):
        answer = getattr(known, "response", None)
        if isinstance(answer, Mapping):
            return str(answer.get("Error", {}).get("Code", ""))
    return ""


def _told(error: Exception, address: str) -> Exception | None:
    """The error to show to a person; None for one that has nothing to do with the server."""
    from aiohttp import ClientError as BrokenConnection
    from botocore.exceptions import BotoCoreError, ClientError, HTTPClientError
    from botocore.exceptions import ConnectionError as NoConnection

    code = _code(error)
    if code == "NoSuchBucket":
        return RemoteError("there is no such bucket", where=address, remedy="Create it, or correct --store.")
    if code in DENIED or (code and isinstance(error, PermissionError)):
        return _denied(address, code)
    kind = type(error).__name__
    if kind in ("NoCredentialsError", "PartialCredentialsError", "CredentialRetrievalError", "ProfileNotFound"):
        return RemoteError("no credentials for the bucket", where=address, found=kind, expected=CREDENTIALS)
    if code or isinstance(error, ClientError):
        return Unreachable("the server refused a request", where=address, found=code, remedy="Try again later.")
    broken: tuple[type[Exception], ...] = (BrokenConnection, HTTPClientError, NoConnection, ConnectionError)
    if isinstance(error, (*broken, TimeoutError)):
        remedy = "Check the network and AWS_ENDPOINT_URL, and try again; completed work is kept."
        return Unreachable("the server cannot be reached", where=address, found=kind, remedy=remedy)
    if isinstance(error, BotoCoreError):
        return RemoteError("cannot use the bucket", where=address, found=kind, expected=CREDENTIALS)
    return None


def _denied(address: str, code: object) -> RemoteError:
    remedy = "Check which credentials are used (AWS_PROFILE) and what the bucket allows them to do."
    return RemoteError("access denied", where=address, found=code or None, remedy=remedy)
