"""What keeps a database file of a stranger from doing more than to be read.

A file of SQLite is a program too: its views, triggers, virtual tables and generated columns run whenever a
table of that name is asked or written to. An archive of surveys has none of them.

Reference: sqlite.org/security.html, on how to open files that one did not write.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Mapping

from dream.survey import files

LIMITS = {
    # A survey's file in one row, and nothing larger.
    sqlite3.SQLITE_LIMIT_LENGTH: files.MOST_BYTES + (1 << 20),
    sqlite3.SQLITE_LIMIT_SQL_LENGTH: 1 << 20,
    sqlite3.SQLITE_LIMIT_COLUMN: 200,
    sqlite3.SQLITE_LIMIT_EXPR_DEPTH: 100,
    sqlite3.SQLITE_LIMIT_COMPOUND_SELECT: 20,
    sqlite3.SQLITE_LIMIT_VDBE_OP: 1 << 20,
    sqlite3.SQLITE_LIMIT_ATTACHED: 0,
    sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH: 1,
    sqlite3.SQLITE_LIMIT_WORKER_THREADS: 0,
}
"""What SQLite itself is held to."""
MOST_THINGS = 1000
"""Tables, indices and others of a file."""


def confine(connection: sqlite3.Connection) -> None:
    """Let a file call no function that could do harm, and hold it to `LIMITS`."""
    for limit, most in LIMITS.items():
        connection.setlimit(limit, most)
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")
    # What a file of another size than it says would make of memory that is mapped.
    connection.execute("PRAGMA mmap_size = 0")


def check_tables(connection: sqlite3.Connection, columns: Mapping[str, Iterable[str]], where: str) -> None:
    """Raise a ValueError unless a file is made of tables alone, and those that are named have these columns.

    Only the catalogue is asked, in which nothing is run.

    Args:
        connection: To the file.
        columns: By table; a table may have others too. A table that is not there is not looked at.
        where: What errors call the file.
    """
    things = connection.execute(
        "SELECT type, name, rootpage, lower(substr(sql, 1, 40)) FROM sqlite_master LIMIT ?",
        (MOST_THINGS + 1,),
    ).fetchall()
    if len(things) > MOST_THINGS:
        raise ValueError(f"{where}: expected an archive of surveys, got more than {MOST_THINGS} tables")
    for kind, name, page, begins in things:
        what = kind
        if kind == "table" and (not page or str(begins).startswith("create virtual")):
            what = "virtual table"
        if what not in ("table", "index"):
            raise ValueError(
                f"{where}: expected an archive of surveys, which is made of tables alone, got the {what} "
                f"{name}. If it came from a program of yours, take it out: DROP {kind.upper()} {name}"
            )
    tables = {str(name) for kind, name, _, _ in things if kind == "table"}
    for table, wanted in columns.items():
        if table not in tables:
            continue
        found = connection.execute(f"PRAGMA table_xinfo({table})").fetchall()
        made = next((name for _, name, *_, hidden in found if hidden), None)
        if made is not None:
            raise ValueError(
                f"{where}: {table}: expected columns that hold values, got {made}, which is made up"
            )
        lacking = [name for name in wanted if name not in {column[1] for column in found}]
        if lacking:
            raise ValueError(f"{where}: {table}: expected the column {lacking[0]}, got none of that name")
        for (index,) in connection.execute(f"SELECT name FROM pragma_index_list('{table}')").fetchall():
            of = connection.execute("SELECT cid FROM pragma_index_xinfo(?)", (index,)).fetchall()
            if any(column == -2 for (column,) in of):
                raise ValueError(f"{where}: {table}: expected indices over columns, got {index} over a sum")
