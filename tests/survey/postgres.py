"""A PostgreSQL server of Debian's packages, for tests: in a temporary folder, on the loopback.

As root it runs as the user `postgres`, or as nobody: it refuses to run as root.
"""

from __future__ import annotations

import contextlib
import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

USER, PASSWORD = "surveyor", "s3cret/of the@reef"
QUOTED = "s3cret%2Fof%20the%40reef"
"""The password as a URL writes it."""


def missing() -> str:
    """What there is not: the server or PostGIS; empty where both are."""
    bins = _bins()
    if bins is None:
        return "needs PostgreSQL: apt-get install postgresql"
    share = subprocess.run([bins / "pg_config", "--sharedir"], capture_output=True, text=True, check=False)
    folders = [Path(share.stdout.strip()), *Path("/usr/share/postgresql").glob("*")]
    if not any((folder / "extension" / "postgis.control").is_file() for folder in folders):
        return "needs PostGIS: apt-get install postgresql-15-postgis-3"
    return ""


class Server:
    """A server that can be stopped, started again, and made to hang."""

    def __init__(self, folder: Path, prefix: list[str]) -> None:
        self._folder, self._prefix = folder, prefix
        self._process: subprocess.Popen[bytes] | None = None
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]

    def url(self, database: str, *, user: str = USER, password: str = QUOTED) -> str:
        return f"postgresql://{user}:{password}@127.0.0.1:{self.port}/{database}"

    def emptied(self) -> str:
        """URL of a database that has PostGIS and nothing else: the same one each time."""
        import psycopg

        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute("CREATE EXTENSION IF NOT EXISTS postgis")
            connection.execute("DROP SCHEMA IF EXISTS dream CASCADE")
        return self.url("postgres")

    def start(self) -> None:
        import psycopg

        bins = _bins()
        assert bins is not None
        settings = ("fsync=off", "listen_addresses=127.0.0.1", f"unix_socket_directories={self._folder}")
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [
                    *self._prefix,
                    *map(str, (bins / "postgres", "-D", self._folder / "data", "-p", self.port)),
                    *(word for setting in settings for word in ("-c", setting)),
                ],
                stdout=subprocess.DEVNULL,
                stderr=log,
                cwd="/",
            )
        until = time.monotonic() + 30.0
        while True:
            with contextlib.suppress(psycopg.OperationalError):
                psycopg.connect(self.url("postgres")).close()
                return
            if time.monotonic() > until or self._process.poll() is not None:
                raise RuntimeError((self._folder / "log").read_text())
            time.sleep(0.05)

    def stop(self) -> None:
        """At once: connections are cut, as by a machine that goes down."""
        if self._process is None:
            return
        os.kill(self._number(), signal.SIGQUIT)
        self._process.wait(30.0)
        self._process = None

    @contextlib.contextmanager
    def frozen(self) -> Iterator[None]:
        """All its programs stand still; the system still acknowledges what they are sent."""
        assert self._process is not None
        number = self._number()
        children = Path(f"/proc/{number}/task/{number}/children").read_text().split()
        # The program that started it stops with it, and does not go on by itself.
        numbers = [self._process.pid, number, *map(int, children)]
        for one in numbers[1:]:
            os.kill(one, signal.SIGSTOP)
        try:
            yield
        finally:
            for one in numbers:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(one, signal.SIGCONT)

    def _number(self) -> int:
        return int((self._folder / "data" / "postmaster.pid").read_text().split()[0])


@contextlib.contextmanager
def serving() -> Iterator[Server]:
    bins = _bins()
    assert bins is not None
    folder = Path(tempfile.mkdtemp(prefix="dream-pg-"))
    prefix: list[str] = []
    if os.geteuid() == 0:
        user = next(name for name in ("postgres", "nobody") if _there(name))
        shutil.chown(folder, user)
        prefix = ["runuser", "-u", user, "--"]
    (folder / "password").write_text(PASSWORD)
    (folder / "password").chmod(0o644)
    server = Server(folder, prefix)
    try:
        subprocess.run(
            [
                *prefix,
                *map(str, (bins / "initdb", "-D", folder / "data", "-U", USER, "--auth=scram-sha-256")),
                *(f"--pwfile={folder / 'password'}", "--no-sync", "--encoding=UTF8", "--locale=C"),
            ],
            check=True,
            capture_output=True,
            cwd="/",
        )
        server.start()
        yield server
    finally:
        with contextlib.suppress(OSError):
            server.stop()
        shutil.rmtree(folder, ignore_errors=True)


def _bins() -> Path | None:
    """Where the server's programs are; the newest where there are several."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    if found:
        return found[-1].parent
    initdb = shutil.which("initdb")
    return None if initdb is None else Path(initdb).resolve().parent


def _there(user: str) -> bool:
    try:
        pwd.getpwnam(user)
    except KeyError:
        return False
    return True
